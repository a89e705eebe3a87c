"""What is connected: a plain registry of the kinds of stage that are looked for on serial ports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from palpate.core import Clock, PalpateError, Position
from palpate.core.optional_imports import require

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
