"""Answers to what a guided setup asks: of a person at a prompt, or from a file for scripts; and TOML text."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from palpate.core import DeviceError, InputError, RangeError
from palpate.core.parsing import parser
from palpate.devices import Tripped
from palpate.devices.file_fields import read_toml

Three = tuple[float, float, float]
Good = TypeVar("Good")


class NobodyError(InputError):
    """Nobody is there to answer, and asking again is of no use."""


class Answers:
    """Answers by name, from a file, as proposed where `yes` says so, or of a person at a prompt.

    Args:
        stated: answers by name.
        yes: take what is proposed, where something is.
        read: asks a person; None where nobody is there. An empty answer takes the proposal, which stands in
            brackets.

    Attributes:
        asked: names in the order in which they were asked for.
        given: answers so far, to go on with; not those that could not be taken.
    """

    def __init__(
        self,
        stated: Mapping[str, Any] | None = None,
        *,
        yes: bool = False,
        read: Callable[[str], str] | None = None,
    ) -> None:
        self._stated, self._yes, self._read = dict(stated or {}), yes, read
        self.asked: list[str] = []
        self.given: dict[str, Any] = {}
        self._before: dict[str, Any] = {}

    @classmethod
    @parser("setup answers", InputError)
    def read(cls, path: Path, *, yes: bool = False, read: Callable[[str], str] | None = None) -> Answers:
        """Read a TOML file, one answer a line."""
        if not path.is_file():
            raise InputError(f"there is no file of answers {str(path)!r}")
        return cls(read_toml(path), yes=yes, read=read)

    def ask(self, name: str, question: str, proposal: Any = None, *, words: bool = False) -> Any:
        """The answer of this name; a person's lists, true and numbers are JSON, unless words
        are asked for.
        """
        self.asked.append(name)
        if name in self._stated:
            self.given[name] = self._stated[name]
            return self._stated[name]
        if self._yes and proposal is not None:
            return proposal
        if self._read is None:
            raise InputError(f"the answers do not say {name} ({question}); add a line {name} = ...")
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
        """Whether answers since then may be given anew: by a person, since a file says the same again."""
        if self._read is None:
            return False
        print(why, file=sys.stderr)
        names = set(self.asked[since:])
        given = {name: self.given.pop(name) for name in names if name in self.given}
        typed = {name: value for name, value in given.items() if self._stated.pop(name, self) is self}
        self._before = kept_answers(typed) if len(names) > 1 else {}  # any of several may be the wrong one
        return not self._yes

    def unused(self) -> list[str]:
        """Names that were answered and never asked for."""
        return sorted(set(self._stated) - set(self.asked))

    def until_good(self, take: Callable[[], Good]) -> Good:
        """Answers that can be taken; a person who gave some that cannot, or of no device, is asked again."""
        while True:
            since = len(self.asked)
            try:
                return take()
            except NobodyError:
                raise
            except (InputError, RangeError, DeviceError, Tripped) as e:
                if not self.again(str(e), since):
                    raise

    def confirm(self, name: str, question: str, proposal: bool | None = None) -> bool:
        """An answer that is yes or no."""

        def take() -> bool:
            answer = self.ask(name, f"{question} (yes/no)", proposal)
            if not isinstance(answer, bool):
                raise InputError(f"{name} is {answer!r}; answer yes or no, in a file true or false")
            return answer

        return self.until_good(take)

    def number(
        self, name: str, question: str, low: float, high: float, proposal: float | None = None
    ) -> float:
        """An answer that is a number from `low` to `high`."""

        def take() -> float:
            answer = self.ask(name, f"{question}, {low:.10g} to {high:.10g}", proposal)
            good = isinstance(answer, int | float) and not isinstance(answer, bool) and math.isfinite(answer)
            if not good or not low <= answer <= high:
                raise InputError(f"{name} is {answer!r}; {low:.10g} to {high:.10g} are allowed ({question})")
            return float(answer)

        return self.until_good(take)

    def three(self, name: str, question: str, proposal: Three | None = None) -> Three:
        """An answer that is three finite numbers [mm]."""
        proposed = None if proposal is None else list(proposal)
        asked = f"{question}, as [x, y, z] in mm"
        return self.until_good(lambda: three_of(name, question, self.ask(name, asked, proposed)))

    def text(self, name: str, question: str, proposal: str | None = None) -> str:
        """An answer in words."""
        answer = self.ask(name, question, proposal, words=True)
        return answer if isinstance(answer, str) else json.dumps(answer)


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


def toml_text(fields: Mapping[str, Any]) -> str:
    """Fields of texts, numbers, lists of these, and one depth of tables.

    Example:
        >>> print(toml_text({"name": "a", "stage": {"home": True, "axes": ["+X"]}}), end="")
        name = "a"
        <BLANKLINE>
        [stage]
        home = true
        axes = ["+X"]
    """
    plain = [
        f"{name} = {_toml_value(value)}" for name, value in fields.items() if not isinstance(value, Mapping)
    ]
    for name, table in fields.items():
        if isinstance(table, Mapping):
            plain += ["", f"[{name}]", *(f"{key} = {_toml_value(value)}" for key, value in table.items())]
    return "\n".join(plain) + "\n"


def _toml_value(value: Any) -> str:
    """A value; JSON's texts, numbers, lists and truths are TOML's, but for the character DEL."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(str(k))} = {_toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml_value(one) for one in value)}]"
    return json.dumps(value, allow_nan=False).replace("\x7f", "\\u007f")
