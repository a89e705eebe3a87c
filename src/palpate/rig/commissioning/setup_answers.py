"""Answers to what a guided setup asks: of a person at a prompt, or from a file for scripts."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from palpate.core import DeviceError, InputError
from palpate.rig.plans.plan_files import read_toml

Three = tuple[float, float, float]


@runtime_checkable
class Answers(Protocol):
    """Source of answers, each with a name, by which a file gives it."""

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any: ...
    def again(self, why: str) -> bool: ...  # whether a wrong answer may be given anew
    def unused(self) -> list[str]: ...  # names that were answered and never asked for


class FileAnswers:
    """Answers by name; what is missing is taken as proposed, where `yes` says so and something is."""

    def __init__(self, answers: Mapping[str, Any], *, yes: bool = False) -> None:
        self._answers, self._yes, self._asked = dict(answers), yes, set[str]()

    @classmethod
    def read(cls, path: Path, *, yes: bool = False) -> FileAnswers:
        """Read a TOML file, one answer a line.

        Raises:
            InputError: there is none, or it is not TOML.
        """
        if not path.is_file():
            raise InputError(f"there is no file of answers {str(path)!r}")
        return cls(read_toml(path), yes=yes)

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any:
        """The answer of this name.

        Raises:
            InputError: there is none.
        """
        self._asked.add(name)
        if name in self._answers:
            return self._answers[name]
        if self._yes and proposal is not None:
            return proposal
        raise InputError(f"the answers do not say {name} ({question}); add a line {name} = ...")

    def again(self, why: str) -> bool:
        """Never: a file says the same again."""
        return False

    def unused(self) -> list[str]:
        """Names that were answered and never asked for."""
        return sorted(set(self._answers) - self._asked)


class PromptAnswers:
    """Answers of a person; an empty one takes the proposal, which stands in brackets."""

    def __init__(self, *, yes: bool = False, read: Callable[[str], str] = input) -> None:
        self._yes, self._read = yes, read

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any:
        """Ask until something is answered; lists, true and numbers are read as JSON, unless words are asked
        for.
        """
        if self._yes and proposal is not None:
            return proposal
        shown = "" if proposal is None else f" [{json.dumps(proposal)}]"
        while True:
            try:
                text = self._read(f"{question}{shown}: ").strip()
            except EOFError as e:
                raise InputError(f"nobody answered: {question}; give a file with --answers") from e
            if text:
                return text if words else _value(text)
            if proposal is not None:
                return proposal

    def again(self, why: str) -> bool:
        """Say what is wrong, and let the person answer anew; not where all is taken as proposed."""
        print(why, file=sys.stderr)
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


Good = TypeVar("Good")


def until_good(answers: Answers, take: Callable[[], Good]) -> Good:
    """An answer that can be taken; a person who gave one that cannot, or of no device, is asked again."""
    while True:
        try:
            return take()
        except (InputError, DeviceError) as e:
            if not answers.again(str(e)):
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
        answer = answers.ask(name, f"{question}, {low:g} to {high:g}", proposal)
        good = isinstance(answer, int | float) and not isinstance(answer, bool) and math.isfinite(answer)
        if not good or not low <= answer <= high:
            raise InputError(f"{name} is {answer!r}; {low:g} to {high:g} are allowed ({question})")
        return float(answer)

    return until_good(answers, take)


def three(answers: Answers, name: str, question: str, proposal: Three | None = None) -> Three:
    """An answer that is three finite numbers."""

    def take() -> Three:
        answer = answers.ask(name, f"{question}, as [x, y, z]", None if proposal is None else list(proposal))
        if not isinstance(answer, list | tuple) or len(answer) != len("xyz"):
            raise InputError(f"{name} is {answer!r}; give three numbers, as in [0, 0, 0] ({question})")
        if not all(isinstance(one, int | float) and math.isfinite(one) for one in answer):
            raise InputError(f"{name} is {answer!r}; all three must be finite numbers ({question})")
        x, y, z = (float(one) for one in answer)
        return x, y, z

    return until_good(answers, take)


def text(answers: Answers, name: str, question: str, proposal: str | None = None) -> str:
    """An answer in words."""
    answer = answers.ask(name, question, proposal, words=True)
    return answer if isinstance(answer, str) else json.dumps(answer)
