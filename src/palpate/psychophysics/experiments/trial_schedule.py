"""Which trial comes next for a participant: a pure function of design, seed, number and the answers so far.

What is drawn is drawn by sorting: items come in the order of the SHA-256 of seed, participant's number, place
and item. That is a random order which no version of a library changes, and which anybody can check.

Participants are counted in the order in which they come. Of groups one place each is filled in a drawn order,
round by round. Within a group the orders of conditions follow the rows of a Williams design, in which each
condition stands in each place, and after each other condition, equally often (E. J. Williams, Aust. J. Sci.
Res. A 2 (1949) 149, doi:10.1071/CH9490149); groups begin at different rows, so that three groups of five
leave out a whole Latin square.

In a block every comparison meets the standard once, in a drawn order, with the standard first in half of
them, and first in the next block where it was second in this one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Generator, Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import chain, count
from typing import TypeVar

from palpate.core import InputError, LabelError
from palpate.psychophysics.experiments.adaptive_placement import (
    Placement,
    StaircaseRule,
    StaircaseState,
    begin_staircase,
    step_staircase,
)
from palpate.psychophysics.experiments.experiment_file import (
    BayesianPart,
    ConstantPart,
    ExperimentDesign,
    ExperimentFile,
    GroupPart,
    RankPart,
    StaircasePart,
    StimuliPart,
    task_of,
)
from palpate.psychophysics.judgements import Condition, Judgement, Presentation, Task

Item = TypeVar("Item", bound=Hashable)


def drawn_order(items: Sequence[Item], *place: object) -> list[Item]:
    """A random order of items, the same for the same words that say what for."""
    words = "\0".join(map(str, place))
    return sorted(items, key=lambda one: hashlib.sha256(f"{words}\0{one}".encode()).digest())


def draw_of(seed: int, number: int, simulated: bool) -> tuple[object, ...]:
    """The first words of what is drawn for a participant; a rehearsal's are others than a person's."""
    return (seed, number, "simulated") if simulated else (seed, number)


def williams_rows(count: int) -> list[tuple[int, ...]]:
    """Return orders of `count` conditions, balanced for first-order carryover; 2 x count rows if odd."""
    zigzag = [(k + 1) // 2 if k % 2 else -(k // 2) for k in range(count)]
    square = [tuple((one + row) % count for one in zigzag) for row in range(count)]
    if count % 2 == 0 or count == 1:
        return square
    return [row for one in square for row in (one, one[::-1])]


def allocation(file: ExperimentFile, number: int) -> tuple[int, int]:
    """Return group and position within the group, from 0, of participant `number`, from 1."""
    sizes = [group.participants for group in file.group]
    turns = [
        group
        for turn in range(max(sizes))
        for group in drawn_order([g for g, size in enumerate(sizes) if size > turn], file.seed, "group", turn)
    ]
    rounds, index = divmod(number - 1, len(turns))
    group = turns[index]
    return group, rounds * sizes[group] + turns[:index].count(group)


def order_of_conditions(file: ExperimentFile, number: int) -> Iterator[tuple[Presentation, Condition]]:
    """Presentations and conditions in the order in which a participant meets them."""
    group, place = allocation(file, number)
    named = drawn_order(file.conditions, file.seed, "conditions")
    rows = williams_rows(len(named))
    presentations: Sequence[Presentation] = file.group[group].presentations
    if (place // min(2, len(rows))) % 2:  # by twos, so that each row comes with either presentation first
        presentations = presentations[::-1]
    for k, presentation in enumerate(presentations):
        for one in rows[(place + 2 * group + k) % len(rows)]:
            yield presentation, named[one]


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """The next trial, with the stimuli in order of presentation."""

    presentation: Presentation
    condition: Condition
    task: Task
    block: int
    trial: int
    presented: tuple[str, ...]

    def fits(self, judgement: Judgement) -> bool:
        """Whether a judgement is one of this trial."""
        return self == PlannedTrial(
            judgement.presentation, judgement.condition, judgement.task, judgement.block, judgement.trial,
            judgement.presented,
        )  # fmt: skip


Trials = Generator[tuple[str, ...], str, None]
"""Yields the stimuli presented, and is sent the answer to them."""


@dataclass(frozen=True, slots=True)
class BlockPlace:
    """Place of a block in a participant's schedule; blocks of a task count from 1 in each condition."""

    presentation: Presentation
    condition: Condition
    task: Task
    block: int

    @property
    def place(self) -> tuple[Presentation, Condition, Task, int]:
        return (self.presentation, self.condition, self.task, self.block)


@dataclass(frozen=True, slots=True)
class FixedBlock(BlockPlace):
    """A block whose trials are known beforehand: of constant stimuli, or one ranking."""

    trials: tuple[tuple[str, ...], ...]

    @property
    def max_trials(self) -> int:
        return len(self.trials)

    def ask(self) -> Trials:
        for presented in self.trials:  # noqa: UP028 - a tuple takes no answers
            yield presented


@dataclass(frozen=True, slots=True)
class PairBlock(BlockPlace):
    """A block of pairs that follow from the answers."""

    standard: str
    standard_first: tuple[bool, ...]

    @property
    def max_trials(self) -> int:
        return len(self.standard_first)


@dataclass(frozen=True, slots=True)
class StaircaseBlock(PairBlock):
    """Interleaved staircases.

    Attributes:
        sides: comparisons of each track, nearest to the standard first.
        turns: order of tracks in each round.
    """

    sides: tuple[tuple[str, ...], ...]
    softer: tuple[bool, ...]
    rule: StaircaseRule
    turns: tuple[tuple[int, ...], ...]

    def ask(self, states: list[StaircaseState] | None = None) -> Trials:
        """Ask, and keep how each track stands in `states`."""
        states = self._begun() if states is None else states
        firsts = iter(self.standard_first)
        for track in chain.from_iterable(self.turns):
            if not states[track].ended:
                side = self.sides[track]
                comparison = side[states[track].place]
                answer = yield _pair(self.standard, comparison, next(firsts))
                right = (answer == comparison) == self.softer[track]
                states[track] = step_staircase(self.rule, len(side), states[track], right)

    def tracks(self, answers: Iterable[str]) -> tuple[StaircaseState, ...]:
        """How each track stands after some answers."""
        states = self._begun()
        trials = self.ask(states)
        next(trials)
        with suppress(StopIteration):  # at the end
            for one in answers:
                trials.send(one)
        return tuple(states)

    def _begun(self) -> list[StaircaseState]:
        return [begin_staircase(len(side)) for side in self.sides]


@dataclass(frozen=True, slots=True)
class BayesianBlock(PairBlock):
    """A block whose comparisons are placed by what the answers so far leave open."""

    comparisons: tuple[str, ...]
    x: tuple[float, ...]

    def ask(self) -> Trials:
        placement = Placement.of_differences(self.x)
        for first in self.standard_first:
            chosen = placement.next
            answer = yield _pair(self.standard, self.comparisons[chosen], first)
            placement = placement.after(chosen, answer == self.comparisons[chosen])


PlannedBlock = FixedBlock | StaircaseBlock | BayesianBlock
"""Each has `max_trials` and `ask`."""


def _pair(standard: str, comparison: str, standard_first: bool) -> tuple[str, str]:
    return (standard, comparison) if standard_first else (comparison, standard)


@dataclass(frozen=True, slots=True)
class Schedule:
    """All blocks of a participant, in order."""

    number: int
    group: GroupPart
    blocks: tuple[PlannedBlock, ...]

    @property
    def digest(self) -> str:
        """SHA-256 of the whole schedule, as 64 hexadecimal digits."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def text(self) -> str:
        """The schedule as JSON, a line a block: what is known before the first answer."""
        head = json.dumps({"number": self.number, "group": self.group.name})
        return "\n".join([head, *(json.dumps(asdict(block)) for block in self.blocks)]) + "\n"

    @property
    def max_trials(self) -> int:
        """How many judgements there will be, or at most where staircases end by reversals."""
        return sum(block.max_trials for block in self.blocks)

    @property
    def is_fixed(self) -> bool:
        """Whether there will be so many, since no staircase may end by its reversals."""
        return not any(isinstance(block, StaircaseBlock) for block in self.blocks)

    def ask(self) -> Generator[PlannedTrial, Judgement, None]:
        """Yield each trial, and be sent the judgement of it."""
        for block in self.blocks:
            trials = block.ask()
            with suppress(StopIteration):
                presented = next(trials)
                for number in count(1):
                    judgement = yield PlannedTrial(*block.place, number, presented)
                    presented = trials.send(" ".join(judgement.answer))

    def follow(self, judgements: Iterable[Judgement]) -> Course:
        """Return where judgements have led; reject those not on the schedule."""
        course = Course(self)
        for one in judgements:
            course.take(one)
        return course

    def next(self, judgements: Iterable[Judgement]) -> PlannedTrial | None:
        """Return the trial after the given judgments, None at the end."""
        return self.follow(judgements).next


class Course:
    """A participant's way through a schedule; `next` is the next trial, None at the end."""

    def __init__(self, schedule: Schedule) -> None:
        self._trials, self._done = schedule.ask(), 0
        self.next: PlannedTrial | None = next(self._trials, None)

    def take(self, judgement: Judgement) -> None:
        """Go on by a judgement; reject one that is not of the next trial."""
        planned = self.next
        if planned is None:
            raise LabelError(
                f"{self._done + 1} judgements, and the schedule asks for {self._done}; leave none twice",
                code="schedule",
            )
        if not planned.fits(judgement):
            raise LabelError(
                f"judgement {self._done + 1} of {judgement.participant} is not the one that the schedule "
                f"asks for there, block {planned.block}, trial {planned.trial} of "
                f"{planned.presentation.value} {planned.condition.value} {planned.task.value}: a row "
                "is missing, stands twice or was changed; put the table back as it was written",
                code="schedule",
            )
        self._done += 1
        try:
            self.next = self._trials.send(judgement)
        except StopIteration:
            self.next = None


def make_schedule(design: ExperimentDesign, number: int, simulated: bool = False) -> Schedule:
    """Return the schedule of participant `number`, from 1; rehearsals have trials of their own."""
    if number < 1:
        raise InputError(f"participant number {number}; they count from 1")
    blocks: list[PlannedBlock] = []
    for presentation, condition in order_of_conditions(design.file, number):
        stimuli = design.file.set_of(presentation, condition)
        count = {Task.PAIR: 0, Task.RANK: 0}
        for k, part in enumerate(design.file.task):
            begin = count[task_of(part)] + 1
            place = (*draw_of(design.file.seed, number, simulated), presentation.value, condition.value, k)
            made = list(_blocks(design, stimuli, part, begin, place))
            count[task_of(part)] += len(made)
            blocks += made
    return Schedule(number, design.file.group[allocation(design.file, number)[0]], tuple(blocks))


def _blocks(
    design: ExperimentDesign,
    stimuli: StimuliPart,
    part: ConstantPart | StaircasePart | BayesianPart | RankPart,
    begin: int,
    place: tuple[object, ...],
) -> Iterator[PlannedBlock]:
    where = (stimuli.presentation, stimuli.condition, task_of(part))
    comparisons = tuple(name for name in stimuli.names if name != stimuli.standard)
    match part:
        case ConstantPart():
            for k in range(part.repeats):
                trials = _balanced_pairs(stimuli.standard, comparisons, k, place)
                yield FixedBlock(*where, begin + k, trials)
        case RankPart():
            for k in range(part.repeats):
                yield FixedBlock(*where, begin + k, (tuple(drawn_order(stimuli.names, *place, "rank", k)),))
        case BayesianPart():
            x = tuple(design.softness(one) - design.softness(stimuli.standard) for one in comparisons)
            firsts = _firsts(part.trials, place)
            yield BayesianBlock(*where, begin, stimuli.standard, firsts, comparisons, x)
        case StaircasePart():
            yield _staircases(design, stimuli, part, begin, place)


def _balanced_pairs(
    standard: str, comparisons: tuple[str, ...], block: int, place: tuple[object, ...]
) -> tuple[tuple[str, ...], ...]:
    """The pairs of a block; two blocks that follow each other have each pair in either order."""
    two, second = divmod(block, 2)
    half = drawn_order(comparisons, *place, "half", two)[: len(comparisons) // 2]
    return tuple(
        _pair(standard, one, (one in half) != bool(second))
        for one in drawn_order(comparisons, *place, "pairs", block)
    )


def _firsts(trials: int, place: tuple[object, ...]) -> tuple[bool, ...]:
    """Whether the standard comes first, in each two trials once."""
    return tuple(
        first
        for two in range((trials + 1) // 2)
        for first in drawn_order((True, False), *place, "first", two)
    )[:trials]


def _staircases(
    design: ExperimentDesign, stimuli: StimuliPart, part: StaircasePart, begin: int, place: tuple[object, ...]
) -> StaircaseBlock:
    base = design.softness(stimuli.standard)
    sides = []
    for side in part.sides:
        sign = 1 if side == "softer" else -1
        beside = [one for one in stimuli.names if sign * (design.softness(one) - base) > 0]
        if not beside:
            raise InputError(
                f"a staircase on the {side} side of {stimuli.presentation.value} {stimuli.condition.value}, "
                "which has no stimulus there; leave that side out or add one"
            )
        sides.append(tuple(sorted(beside, key=lambda one: abs(design.softness(one) - base))))
    rule = StaircaseRule(
        part.right, part.wrong, part.steps, part.up_ratio, part.reversals, part.max_trials
    )  # fmt: skip
    turns = tuple(tuple(drawn_order(range(len(sides)), *place, "turn", k)) for k in range(part.max_trials))
    return StaircaseBlock(
        stimuli.presentation, stimuli.condition, Task.PAIR, begin, stimuli.standard,
        _firsts(part.max_trials * len(sides), place), tuple(sides),
        tuple(side == "softer" for side in part.sides), rule, turns,
    )  # fmt: skip


def tracks_of(
    schedule: Schedule, judgements: Sequence[Judgement]
) -> Iterator[tuple[StaircaseBlock, tuple[StaircaseState, ...]]]:
    """How the staircases of a participant stand, block by block; those not begun are left out."""
    for block in schedule.blocks:
        if isinstance(block, StaircaseBlock):
            answers = [
                " ".join(one.answer)
                for one in judgements
                if (one.presentation, one.condition, one.task, one.block) == block.place
            ]
            if answers:
                yield block, block.tracks(answers)
