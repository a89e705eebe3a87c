"""Answers to what a guided setup asks: of a person at a prompt, or from a file for scripts; and TOML text.

What is connected: a plain registry of the kinds of stage that are looked for on serial ports.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from palpate.core import Clock, DeviceError, InputError, PalpateError, Position, RangeError
from palpate.core.optional_imports import require
from palpate.core.parsing import parser
from palpate.devices import Tripped
from palpate.devices.device_plugins import read_toml

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
        if name in MOMENTS:
            _drop_typed()
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


def _drop_typed() -> None:
    """Drop what was typed at a terminal before a question after which the stage may move."""
    with suppress(ImportError, OSError, ValueError):  # no terminal
        import termios

        if os.isatty(fd := sys.stdin.fileno()):
            termios.tcflush(fd, termios.TCIFLUSH)


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


VIDEO = Path("/dev")
BAUD = 115_200
"""Rate that most boards of both firmwares talk at; many printers at 250,000."""


@dataclass(frozen=True, slots=True)
class FoundStage:
    """A stage that answered.

    Attributes:
        kind: of the part in a rig's file.
        says: its firmware, in its own words.
        homing: whether it homes on switches.
        travel_m: its travel, in the sensor's frame, for the axes that it was asked for; None where its
            firmware does not know.
        fields: of the part in a rig's file, besides its kind.
        tells_jerk: whether its firmware says from which speed it can stop dead, or brakes by itself.
    """

    kind: str
    says: str
    homing: bool
    travel_m: tuple[Position, Position] | None
    fields: dict[str, object]
    tells_jerk: bool = True


StageSearch = Callable[[str, tuple[str, str, str], float, int, Clock], FoundStage]


def find_grbl(port: str, axes: tuple[str, str, str], boot_s: float, baud: int, clock: Clock) -> FoundStage:
    """Ask a port as GRBL is asked; with DTR low, and where nothing answers, with DTR high.

    Raises:
        DeviceError: no GRBL controller answers.
    """
    from palpate.rig.real.gcode_spec import Mount
    from palpate.rig.real.grbl.grbl_stage import GrblStage
    from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

    first: PalpateError | None = None
    for dtr in (False, True):
        # Limits that fit any machine: it is only asked, and not moved.
        spec = GrblSpec(
            port, baud=baud, axes=axes, boot_s=boot_s, dtr=dtr, least_m=(0.0,) * 3, greatest_m=(1e-3,) * 3
        )
        try:
            stage = GrblStage.open(spec, clock)
        except PalpateError as e:
            first = first or e
            continue
        try:
            machine, says = stage.machine, stage.ask_firmware() or "GRBL, of a version that it did not say"
        finally:
            stage.close()
        box = Mount(axes).box_m(machine.least_mm)
        fields: dict[str, object] = {"port": port, "baud": spec.baud, "dtr": dtr, "boot_s": boot_s}
        fields |= {"steps_per_mm": list(stage.steps_per_mm), "direction_mask": stage.direction_mask}
        return FoundStage("grbl", says, machine.homing, box, fields)
    assert first is not None
    raise first


def find_marlin(port: str, axes: tuple[str, str, str], boot_s: float, baud: int, clock: Clock) -> FoundStage:
    """Ask a port as Marlin is asked. It counts as without switches: homing a printer drives it to its bed.

    Raises:
        DeviceError: no Marlin controller answers.
    """
    from palpate.rig.real.marlin import MarlinSpec, MarlinStage

    # Limits and a speed that fit any machine: it is only asked, and not moved.
    spec = MarlinSpec(
        port, baud=baud, axes=axes, boot_s=boot_s, least_m=(0.0,) * 3, greatest_m=(1e-3,) * 3, sudden_m_s=1e-3
    )
    stage = MarlinStage.open(spec, clock)
    try:
        says = "Marlin, which stops " + ("as it is told" if stage.emergency_parser else "in its turn only")
        tells_jerk = stage.tells_jerk
    finally:
        stage.close()
    fields: dict[str, object] = {"port": port, "baud": spec.baud, "dtr": spec.dtr, "boot_s": boot_s}
    fields["steps_per_mm"] = list(stage.steps_per_mm)
    return FoundStage("marlin", says, False, None, fields, tells_jerk)


STAGES: dict[str, StageSearch] = {"grbl": find_grbl, "marlin": find_marlin}
"""How each kind of stage is looked for on a port. A new kind is one more entry."""


def find_stage(
    port: str, axes: tuple[str, str, str], boot_s: float, clock: Clock, baud: int = BAUD
) -> FoundStage | str:
    """The stage at a port, of the first kind that answers; else why none did."""
    reasons = []
    for kind, search in STAGES.items():
        try:
            return search(port, axes, boot_s, baud, clock)
        except PalpateError as e:
            reasons.append(f"not {kind}: {e}")
    return "; ".join(reasons)


def serial_ports() -> list[str]:
    """Paths of the serial ports that the system lists.

    Raises:
        MissingExtraError: pyserial is not installed.
    """
    listed = require("serial.tools.list_ports", "The list of serial ports")
    return sorted(port.device for port in listed.comports())


def video_devices() -> list[str]:
    """Paths of the cameras that Linux lists; elsewhere none, and they are named by number."""
    return sorted(str(path) for path in VIDEO.glob("video*"))
