"""How a sitting goes: what the experimenter is told, what they type, and what happens when something fails.

The experimenter reads letters, the participant hears first, second and so on; neither meets a stimulus's name
or level. Nothing is printed or read here but through the `SittingDesk` that is given.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from palpate.core import NS_PER_S, Clock, InputError, PalpateError, RangeError, StorageError
from palpate.psychophysics.experiments.experiment_file import ExperimentDesign
from palpate.psychophysics.experiments.participant_record import (
    ACTIVITIES,
    MARKS,
    checked_age,
    laterality_quotient,
)
from palpate.psychophysics.experiments.sitting import Enrolment, Sitting
from palpate.psychophysics.experiments.trial_schedule import PlannedTrial
from palpate.psychophysics.judgements import CUES, Condition, Presentation, Task

PAUSE = "q"
ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
AGAIN = f"Enter tries again, {PAUSE} pauses the sitting"

Answerer = Callable[[PlannedTrial], tuple[str, ...]]
"""An observer in a program: the answer to a trial, names of stimuli as of a judgement."""


@runtime_checkable
class SittingDesk(Protocol):
    """Whoever sits before the keys."""

    def tell(self, text: str) -> None:
        """Show a line."""

    def ask(self, prompt: str) -> str:
        """Read a line that is typed."""

    def wait(self, prompt: str) -> str:
        """Wait until something was done by hand; read what is typed, mostly nothing. Errors as of `ask`."""

    def mend(self, prompt: str) -> str:
        """Wait until a fault was mended; as `wait`, but where nobody is, nothing is mended: an EOFError."""


@runtime_checkable
class StimulusPresenter(Protocol):
    """Whatever shows rendered stimuli."""

    @property
    def simulated(self) -> bool:
        """Whether no finger can feel them."""

    def prepare(self, condition: Condition) -> str:
        """What the experimenter has to do before a condition; "" for nothing."""

    def show(self, condition: Condition, name: str, code: str) -> None:
        """Show a stimulus, under a code in place of its name."""

    def check(self) -> None:
        """Tell that what was shown is still shown."""


class UnrenderedStimuli:
    """Shows nothing, where answers come from a program or a file."""

    simulated = True

    def prepare(self, condition: Condition) -> str:
        """What the experimenter has to know."""
        return f"Condition {condition.value}: nothing is rendered, since nobody is there to feel it."

    def show(self, condition: Condition, name: str, code: str) -> None:
        """Show nothing."""

    def check(self) -> None:
        """Tell that nothing has ended."""


@dataclass(frozen=True, slots=True)
class SittingOutcome:
    """Outcome of a session: judgments on disk, and the fault that ended it, if any."""

    complete: bool
    kept: int
    why: str = ""
    fault: PalpateError | None = None


class _PausedError(Exception):
    """The sitting pauses, by wish or by the fault that caused it."""


def ask_enrolment(design: ExperimentDesign, desk: SittingDesk) -> Enrolment:
    """Ask a new participant for consent, and then for what the design wants to know."""
    desk.tell("Before anything else: has the participant agreed, by your institution's form, to take part?")
    if not _yes(desk, "consent, yes or no"):
        return Enrolment(consent=False)
    quotient = math.nan
    if design.file.handedness:
        allowed = ", ".join(one for one in MARKS if one)
        desk.tell(
            f"Handedness, by ten activities: {allowed}. LL or RR: that hand alone; L or R: rather that one; "
            "B: either; Enter: never does it."
        )
        marks = [_until(desk, f"{activity}", _mark) for activity in ACTIVITIES]
        quotient = laterality_quotient(marks)
        hand = (
            ""
            if math.isnan(quotient) or not quotient
            else f", the {'right' if quotient > 0 else 'left'} hand"
        )
        desk.tell(f"The participant touches with the dominant hand{hand}.")
    age = ""
    if design.file.age != "no":
        words = "whole years" if design.file.age == "years" else "a band, such as 20-29"
        age = _until(desk, f"age, {words}; Enter for none", lambda text: checked_age(text, design.file.age))
    return Enrolment(True, quotient, age)


def _yes(desk: SittingDesk, prompt: str) -> bool:
    while (text := desk.ask(prompt).strip().lower()) not in ("yes", "y", "no", "n"):
        desk.tell("yes or no")
    return text[0] == "y"


def _mark(text: str) -> str:
    if text.upper() not in MARKS:
        raise InputError(f"{text!r}; LL, L, B, R, RR or Enter")
    return text.upper()


def _until(desk: SittingDesk, prompt: str, read: Callable[[str], str]) -> str:
    while True:
        try:
            return read(desk.ask(prompt).strip())
        except InputError as e:
            desk.tell(str(e))


class SittingDialogue:
    """Dialogue of a session; an `answerer` replaces the participant, no `presenter` is needed for direct
    stimuli.
    """

    def __init__(
        self,
        sitting: Sitting,
        desk: SittingDesk,
        presenter: StimulusPresenter | None,
        clock: Clock,
        answerer: Answerer | None = None,
    ) -> None:
        self._sitting, self._desk, self._presenter = sitting, desk, presenter
        self._clock, self._answerer = clock, answerer
        self._place: tuple[Presentation, Condition] | None = None
        self._block: tuple[object, ...] = ()
        self._shown: set[int] = set()  # places of the trial whose stimuli were shown, since the last fault

    def run(self) -> SittingOutcome:
        """Ask until all is answered, or until it pauses; Ctrl-C leaves everything that was kept."""
        sitting = self._sitting
        sitting.note("goes on" if sitting.judgements else "begins")
        if any(one.presentation is Presentation.DIRECT for one in sitting.schedule.blocks):
            self._desk.tell(f"Specimens carry the letters of {sitting.key}; whoever labels them looks there.")
        if sitting.torn:
            self._desk.tell("The last answer was not kept whole: its trial is asked again.")
        why = ""
        fault: PalpateError | None = None
        try:
            while sitting.next is not None:
                self._ask(sitting.next)
        except EOFError:
            why = "nothing more can be typed: the input is closed"
            fault = InputError(why)
        except _PausedError as e:
            why, fault = str(e), e.__cause__ if isinstance(e.__cause__, PalpateError) else None
        except BaseException as e:
            sitting.note("pauses", type(e).__name__)
            raise
        sitting.note("ends" if not why else "pauses", why)
        return SittingOutcome(sitting.next is None, len(sitting.judgements), why, fault)

    def _ask(self, trial: PlannedTrial) -> None:
        self._introduce(trial)
        begun_ns = self._mended(lambda: self._present(trial))
        while True:
            answer = self._answerer(trial) if self._answerer else self._typed(trial)
            seconds = (self._clock.now_ns() - begun_ns) / NS_PER_S
            if self._still_shown(trial):
                break
            begun_ns = self._mended(lambda: self._present(trial))  # what was felt is not known: ask again
        while True:
            try:
                self._sitting.take(answer, seconds)
                return
            except StorageError as e:
                self._fault(e, "the answer is not kept yet")

    def _introduce(self, trial: PlannedTrial) -> None:
        """Say what is new: a condition, or a block."""
        sitting, place = self._sitting, (trial.presentation, trial.condition)
        if place != self._place:
            stimuli = sitting.design.file.set_of(*place)
            codes = sorted(sitting.codes[(*place, name)] for name in stimuli.names)
            self._desk.tell(
                f"\nCondition {trial.condition.value} ({CUES[trial.condition]}), {trial.presentation.value}."
            )
            if trial.presentation is Presentation.DIRECT:
                said = f" {stimuli.layout}" if stimuli.layout else ""
                self._desk.tell(f"Have the specimens {' '.join(codes)} at hand.{said}")
            elif self._presenter is not None and (said := self._presenter.prepare(trial.condition)):
                self._desk.tell(said)
                if self._answerer is None:
                    self._command(self._desk.wait("Enter when that is done"))
            self._place = place
        block = (*place, trial.task, trial.block)
        if block != self._block:
            asked = "pairs" if trial.task is Task.PAIR else "ranking"
            words = sitting.design.file.question if trial.task is Task.PAIR else sitting.design.file.request
            self._desk.tell(f"{asked.capitalize()}, block {trial.block}. Say: {words}")
            self._block = block

    def _present(self, trial: PlannedTrial) -> int:
        """Show the first of a trial's stimuli; when that was [ns]."""
        letters = ", ".join(
            f"{_ordinal(k)} {self._code(trial, name)}" for k, name in enumerate(trial.presented)
        )
        done, schedule = len(self._sitting.judgements), self._sitting.schedule
        bound = "" if schedule.is_fixed else "at most "
        self._desk.tell(f"[{done + 1} of {bound}{schedule.max_trials}] {letters}")
        self._shown.clear()
        if trial.presentation is Presentation.RENDERED:
            self._show(trial, 0)
        elif self._answerer is None:
            self._command(self._desk.wait("Enter when they lie there"))
        return self._clock.now_ns()

    def _show(self, trial: PlannedTrial, which: int) -> None:
        if self._presenter is None:
            raise InputError("rendered stimuli, and no display; name its bench by --bench")
        name = trial.presented[which]
        self._presenter.show(trial.condition, name, self._code(trial, name))
        self._shown.add(which)

    def _unshown(self, trial: PlannedTrial) -> list[int]:
        """Places of stimuli that have still to be shown before an answer can be one."""
        if trial.presentation is Presentation.DIRECT or isinstance(self._presenter, UnrenderedStimuli):
            return []
        return [k for k in range(len(trial.presented)) if k not in self._shown]

    def _typed(self, trial: PlannedTrial) -> tuple[str, ...]:
        """The answer, typed until it is one."""
        rendered = trial.presentation is Presentation.RENDERED
        wanted = "softer, 1 or 2" if trial.task is Task.PAIR else "from the hardest to the softest"
        while True:
            said = _of_showing(self._unshown(trial)) if rendered else ""
            text = self._desk.ask(f"{wanted} ({PAUSE} pauses{said})").strip()
            self._command(text)
            try:
                which = _wished(text, len(trial.presented)) if rendered else None
                if which is None:
                    answer = read_answer(text, trial, [self._code(trial, one) for one in trial.presented])
                    self._check_shown(trial)
                    return answer
            except InputError as e:
                self._desk.tell(str(e))
                continue
            self._mended(lambda which=which: self._show(trial, which))  # type: ignore[misc]

    def _check_shown(self, trial: PlannedTrial) -> None:
        """Refuse an answer to what has not been felt."""
        if unshown := self._unshown(trial):
            letters = " ".join(self._code(trial, trial.presented[k]) for k in unshown)
            keys = " ".join(f"s{k + 1}" for k in unshown)
            each = ", one after the other, then the answer" if len(unshown) > 1 else ""
            raise InputError(f"{letters} not shown yet: type {keys}{each}")

    def _still_shown(self, trial: PlannedTrial) -> bool:
        if trial.presentation is Presentation.DIRECT or self._presenter is None:
            return True
        try:
            self._presenter.check()
        except PalpateError as e:
            self._fault(e, "the answer is not taken, since what was felt is not known")
            return False
        return True

    def _mended(self, work: Callable[[], object]) -> int:
        """Do what may fail by a device, again as often as the experimenter likes; when it was done [ns]."""
        while True:
            try:
                work()
                return self._clock.now_ns()
            except PalpateError as e:
                self._shown.clear()
                self._fault(e, "this trial is not asked yet")

    def _fault(self, fault: PalpateError, so: str) -> None:
        """Say what failed, and wait for somebody to mend it."""
        kept = len(self._sitting.judgements)
        self._sitting.note("fault", str(fault))
        self._desk.tell(f"{fault}\nNothing is lost: {kept} judgements are kept, and {so}.")
        try:
            self._command(self._desk.mend(AGAIN))
        except (EOFError, _PausedError) as e:
            raise _PausedError(str(fault)) from (fault if isinstance(e, EOFError) else e)

    def _command(self, text: str) -> None:
        if text.strip().lower() == PAUSE:
            raise _PausedError("the experimenter paused it")

    def _code(self, trial: PlannedTrial, name: str) -> str:
        return self._sitting.codes[(trial.presentation, trial.condition, name)]


def noisy_answers(design: ExperimentDesign, participant: str, noise: float) -> Answerer:
    """Return an observer with Gaussian noise [unit of the level], seeded by the design and
    the participant.
    """
    if not 0 <= noise < math.inf:
        raise RangeError(f"a noise of {noise}; 0 or more, in the unit of the levels, is allowed")

    def answer(trial: PlannedTrial) -> tuple[str, ...]:
        words = (design.file.seed, participant, trial.presentation, trial.condition, trial.task)
        place = "\0".join(map(str, (*words, trial.block, trial.trial)))
        rng = np.random.default_rng(int.from_bytes(hashlib.sha256(place.encode()).digest(), "big"))
        felt = {name: design.softness(name) + noise * rng.standard_normal() for name in trial.presented}
        order = tuple(sorted(trial.presented, key=lambda name: felt[name]))
        return order[-1:] if trial.task is Task.PAIR else order

    return answer


def _ordinal(k: int) -> str:
    return ORDINALS[k] if k < len(ORDINALS) else f"{k + 1}."


def _of_showing(unshown: Sequence[int]) -> str:
    """The keys that show a stimulus, those that were not shown first."""
    if not unshown:
        return ", s1 s2 ... shows one again"
    each = "shows the one" if len(unshown) == 1 else "show those"
    return f", {' '.join(f's{k + 1}' for k in unshown)} {each} still to be felt"


def _wished(text: str, count: int) -> int | None:
    """Which stimulus is wished, of ``s2``; None of another text."""
    if not text.lower().startswith("s") or not text[1:].isdigit():
        return None
    if not 1 <= int(text[1:]) <= count:
        raise InputError(f"{text!r}; s1 to s{count} show one")
    return int(text[1:]) - 1


def read_answer(text: str, trial: PlannedTrial, codes: Sequence[str]) -> tuple[str, ...]:
    """Parse an answer given as positions (1 2 3) or letters into names of stimuli."""
    words = text.upper().replace(",", " ").split()
    wanted = 1 if trial.task is Task.PAIR else len(codes)
    if len(words) == 1 and wanted > 1 and all(len(one) == 1 for one in codes) and len(codes) < 10:
        words = list(words[0])
    by_word = {str(k + 1): name for k, name in enumerate(trial.presented)}
    by_word |= dict(zip(codes, trial.presented, strict=True))
    strange = [word for word in words if word not in by_word]
    if strange or not words:
        said = f"{strange[0]!r} is none of them" if strange else "nothing was typed"
        raise InputError(f"{said}; 1 to {len(codes)} or {' '.join(codes)} are meant")
    answer = tuple(by_word[word] for word in words)
    twice = [word for word, name in zip(words, answer, strict=True) if answer.count(name) > 1]
    if len(answer) != wanted or twice:
        missing = [code for code, name in zip(codes, trial.presented, strict=True) if name not in answer]
        what = f"{twice[0]} stands twice" if twice else f"{len(answer)} where {wanted} is wanted"
        lack = f"; missing: {' '.join(missing)}" if wanted > 1 and missing else ""
        raise InputError(f"{what}{lack}. Please give it again")
    return answer
