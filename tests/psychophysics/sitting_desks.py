"""Desks and presenters for tests of sittings: what was told is kept, what is typed comes from a list."""

from collections.abc import Callable, Iterable
from pathlib import Path

from palpate.core import DeviceError, ManualClock
from palpate.psychophysics import Condition
from palpate.psychophysics.experiments import (
    Enrolment,
    ExperimentDesign,
    Sitting,
    SittingDialogue,
    SittingOutcome,
    enrol,
    make_experiment,
    noisy_answers,
)

NOW = "2026-01-01T10:00:00+00:00"


class Desk:
    """Types what it was given, then nothing more; calls what can be called."""

    def __init__(self, typed: Iterable[str | Callable[[], str]] = ()) -> None:
        self.typed, self.told = list(typed), []
        self.clock = ManualClock()

    def tell(self, text: str) -> None:
        self.told.append(text)

    def ask(self, prompt: str) -> str:
        self.told.append(prompt)
        self.clock.sleep(1.5)
        if not self.typed:
            raise EOFError
        one = self.typed.pop(0)
        return one() if callable(one) else one

    def wait(self, prompt: str) -> str:
        self.told.append(prompt)
        self.clock.sleep(10.0)
        return ""

    mend = ask


class Presenter:
    """A display that keeps what it showed, and fails when it is told to."""

    simulated = False

    def __init__(self) -> None:
        self.shown: list[tuple[str, str, str]] = []
        self.refuses, self.has_ended = 0, 0

    def prepare(self, condition: Condition) -> str:
        return "Put the plate there." if condition is Condition.KINESTHETIC else ""

    def show(self, condition: Condition, name: str, code: str) -> None:
        if self.refuses:
            self.refuses -= 1
            raise DeviceError("the valve does not answer")
        self.shown.append((condition.value, name, code))

    def check(self) -> None:
        if self.has_ended:
            self.has_ended -= 1
            raise DeviceError("the rendering has ended: a wire is off")


def jelly(folder: Path, seed: int = 5) -> ExperimentDesign:
    """An experiment whose one participant is enrolled."""
    design = make_experiment(folder / "jelly", "jelly", seed)
    enrol(design, "P01", Enrolment(True))
    return design


def sit(design: ExperimentDesign, desk: Desk, presenter=None, observed: bool = False) -> SittingOutcome:
    """A sitting of P01 from where it stands."""
    answerer = noisy_answers(design, "P01", 0.0) if observed else None
    with Sitting(design, "P01", lambda: NOW) as sitting:
        return SittingDialogue(sitting, desk, presenter, desk.clock, answerer).run()
