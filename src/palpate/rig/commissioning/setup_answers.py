"""Answers to what a guided setup asks: of a person at a prompt, or from a file for scripts."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from palpate.core import DeviceError, InputError, RangeError
from palpate.core.parsing import parser
from palpate.devices import Tripped
from palpate.devices.file_fields import read_toml

Three = tuple[float, float, float]


@runtime_checkable
class Answers(Protocol):
    """Source of answers, each with a name, by which a file gives it.

    Attributes:
        asked: names in the order in which they were asked for.
    """

    asked: list[str]

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any: ...
    def again(self, why: str, since: int = -1) -> bool: ...  # whether answers since then may be given anew
    def unused(self) -> list[str]: ...  # names that were answered and never asked for


class NobodyError(InputError):
    """Nobody is there to answer, and asking again is of no use."""


class FileAnswers:
    """Answers by name; what is missing is taken as proposed, where `yes` says so, or asked of a person.

    Args:
        answers: by name.
        yes: take what is proposed.
        person: is asked what the answers do not say; None where nobody is there.
    """

    def __init__(
        self, answers: Mapping[str, Any], *, yes: bool = False, person: PromptAnswers | None = None
    ) -> None:
        self._answers, self._yes, self._person = dict(answers), yes, person
        self.asked: list[str] = []

    @classmethod
    @parser("setup answers", InputError)
    def read(cls, path: Path, *, yes: bool = False, person: PromptAnswers | None = None) -> FileAnswers:
        """Read a TOML file, one answer a line.

        Raises:
            InputError: there is none, or it is not TOML.
        """
        if not path.is_file():
            raise InputError(f"there is no file of answers {str(path)!r}")
        return cls(read_toml(path), yes=yes, person=person)

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any:
        """The answer of this name.

        Raises:
            InputError: there is none.
        """
        self.asked.append(name)
        if name in self._answers:
            return self._answers[name]
        if self._yes and proposal is not None:
            return proposal
        if self._person is not None:
            return self._person.ask(name, question, proposal, words=words)
        raise InputError(f"the answers do not say {name} ({question}); add a line {name} = ...")

    def again(self, why: str, since: int = -1) -> bool:
        """Where a person can answer instead: a file says the same again, and is not asked any more."""
        if self._person is None:
            return False
        for name in self.asked[since:]:
            self._answers.pop(name, None)
            self._person.given.pop(name, None)
        return self._person.again(why)

    @property
    def given(self) -> dict[str, Any]:
        """Answers that were asked for, to go on with."""
        known = {name: self._answers[name] for name in self._answers if name in self.asked}
        return known | (self._person.given if self._person is not None else {})

    def unused(self) -> list[str]:
        """Names that were answered and never asked for."""
        return sorted(set(self._answers) - set(self.asked))


class PromptAnswers:
    """Answers of a person; an empty one takes the proposal, which stands in brackets.

    Attributes:
        given: answers so far, by name; not those that could not be taken.
    """

    def __init__(self, *, yes: bool = False, read: Callable[[str], str] = input) -> None:
        self._yes, self._read = yes, read
        self.given: dict[str, Any] = {}
        self.asked: list[str] = []
        self._before: dict[str, Any] = {}

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any:
        """Ask until something is answered; lists, true and numbers are read as JSON, unless words are asked
        for.
        """
        self.asked.append(name)
        if self._yes and proposal is not None:
            return proposal
        proposal = self._before.pop(name, proposal)
        shown = "" if proposal is None else f" [{json.dumps(proposal)}]"
        while True:
            try:
                text = self._read(f"{question}{shown}: ").strip()
            except EOFError as e:
                raise NobodyError(f"nobody answered: {question}; give a file with --answers") from e
            if text or proposal is not None:
                self.given[name] = proposal if not text else text if words else _value(text)
                return self.given[name]

    def again(self, why: str, since: int = -1) -> bool:
        """Say what is wrong, and let the person answer anew; not where all is taken as proposed."""
        print(why, file=sys.stderr)
        names = set(self.asked[since:])
        taken = {name: self.given.pop(name) for name in names if name in self.given}
        self._before = kept_answers(taken) if len(names) > 1 else {}  # any of several may be the wrong one
        return not self._yes

    def unused(self) -> list[str]:
        """None: a person is asked one thing at a time."""
        return []


def _value(text: str) -> Any:
    words = {"y": True, "yes": True, "n": False, "no": False}
    if text.lower() in words:
        return words[text.lower()]
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


MOMENTS = (
    "may_move", "home", "weight_lies", "force_weight_lies", "label_weight_lies", "weight_off", "write_scale",
    "above_mm", "reach_mm", "stands_mm",
)  # fmt: skip
"""Answers that hold at the moment alone, and are asked for again."""


def kept_answers(answers: Mapping[str, Any]) -> dict[str, Any]:
    """Answers that a setup which ended early can go on with."""
    return {name: value for name, value in answers.items() if name not in MOMENTS}


Good = TypeVar("Good")


def until_good(answers: Answers, take: Callable[[], Good]) -> Good:
    """Answers that can be taken; a person who gave some that cannot, or of no device, is asked again."""
    while True:
        since = len(answers.asked)
        try:
            return take()
        except NobodyError:
            raise
        except (InputError, RangeError, DeviceError, Tripped) as e:
            if not answers.again(str(e), since):
                raise


def confirm(answers: Answers, name: str, question: str, proposal: bool | None = None) -> bool:
    """An answer that is yes or no."""

    def take() -> bool:
        answer = answers.ask(name, f"{question} (yes/no)", proposal)
        if not isinstance(answer, bool):
            raise InputError(f"{name} is {answer!r}; answer yes or no, in a file true or false")
        return answer

    return until_good(answers, take)


def number(
    answers: Answers, name: str, question: str, low: float, high: float, proposal: float | None = None
) -> float:
    """An answer that is a number from `low` to `high`."""

    def take() -> float:
        answer = answers.ask(name, f"{question}, {low:.10g} to {high:.10g}", proposal)
        good = isinstance(answer, int | float) and not isinstance(answer, bool) and math.isfinite(answer)
        if not good or not low <= answer <= high:
            raise InputError(f"{name} is {answer!r}; {low:.10g} to {high:.10g} are allowed ({question})")
        return float(answer)

    return until_good(answers, take)


def three(answers: Answers, name: str, question: str, proposal: Three | None = None) -> Three:
    """An answer that is three finite numbers [mm]."""
    proposed = None if proposal is None else list(proposal)
    asked = f"{question}, as [x, y, z] in mm"
    return until_good(answers, lambda: three_of(name, question, answers.ask(name, asked, proposed)))


def three_of(name: str, question: str, answer: Any) -> Three:
    """Three finite numbers of an answer.

    Raises:
        InputError: it is not that.
    """
    if not isinstance(answer, list | tuple) or len(answer) != len("xyz"):
        raise InputError(f"{name} is {answer!r}; give three numbers, as in [0, 0, 0] ({question})")
    if not all(isinstance(one, int | float) and math.isfinite(one) for one in answer):
        raise InputError(f"{name} is {answer!r}; all three must be finite numbers ({question})")
    x, y, z = (float(one) for one in answer)
    return x, y, z


def text(answers: Answers, name: str, question: str, proposal: str | None = None) -> str:
    """An answer in words."""
    answer = answers.ask(name, question, proposal, words=True)
    return answer if isinstance(answer, str) else json.dumps(answer)
