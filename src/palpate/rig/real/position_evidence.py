"""Stored position of a stage, and the one rule by which it is accepted when the stage is opened again.

A controller's counts prove nothing by themselves: motors that are released at rest can be pushed without
being counted, and 0, 0, 0 after a reset equals a stored 0, 0, 0. A stored position is accepted only if

1. the motors keep their current at rest, and did when the position was stored,
2. a volatile marker, set after homing or touch-off and cleared by every reset, is still in the controller,
3. the steps per millimeter, the axes, and the frame are the same, and
4. the counts lie where the stage was left, or on the way of the last move.

Data flow::

    home(), reference() --> mark the controller --> PositionStore.establish --+
    each move, each stand --------------------------> PositionStore.move, .stand
    alarm, reset in motion, jump -------------------> PositionStore.forget    |
                                                                              v
    open --> PositionEvidence (driver) + StoredPosition (file) --> position_fault --> use it, or
                                                                   PositionUnknownError

The file lies in the user's state folder. It is written before a move is sent, so that it is never behind.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from palpate.core import PositionUnknownError
from palpate.rig.real.device_hold import port_named
from palpate.rig.real.gcode_spec import Millimetres, distance_to_segment, shown


class PositionFault(StrEnum):
    """Reason why a stored position is not accepted; `PositionUnknownError.code` is one of them."""

    NO_RECORD = "no-record"
    MOTORS_RELEASED = "motors-released"
    MARKER_LOST = "marker-lost"
    SETTINGS_DIFFER = "settings-differ"
    COUNTS_DIFFER = "counts-differ"
    POSITION_LOST = "position-lost"


WHY = {
    PositionFault.NO_RECORD: "no position was stored after homing, touch-off, or confirmation with "
    "motors that hold",
    PositionFault.MOTORS_RELEASED: "its controller releases the motors at rest, so that it can be pushed "
    "without being counted (set $1=255 on GRBL)",
    PositionFault.MARKER_LOST: "its controller was reset or switched off since the position was stored",
    PositionFault.SETTINGS_DIFFER: "its axes or their directions, steps per millimeter, limits, or reference "
    "have changed",
    PositionFault.COUNTS_DIFFER: "it is not where it was left",
    PositionFault.POSITION_LOST: "it was lost",
}
MAX_APPROACH_M = 0.25e-3  # longest step towards the skin of a stage whose position is not known
REMEDY = "Home the stage, or give --position touch-off or --position reference"


@dataclass(frozen=True, slots=True)
class PositionEvidence:
    """What a controller shows when its port is opened.

    Attributes:
        motors_hold: Whether the motors keep their current at rest.
        marker: Volatile marker found in the controller; 0 for none.
        settings: Axes, steps per millimeter, and frame, by which counts are read; see `counted_by`.
        counts_mm: Position counted by the controller, in machine coordinates [mm].
        tolerance_mm: Tolerance of a position [mm].
    """

    motors_hold: bool
    marker: int
    settings: str
    counts_mm: Millimetres
    tolerance_mm: float


@dataclass(frozen=True, slots=True)
class StoredPosition:
    """Position of a stage as it was stored.

    Attributes:
        marker: Volatile marker that was set in the controller.
        settings: As in `PositionEvidence`.
        origin_mm: Machine coordinates of the zero of the sensor's frame [mm].
        start_mm, end_mm: Ends of the last move; the same where the stage stands [mm].
    """

    marker: int
    settings: str
    origin_mm: Millimetres
    start_mm: Millimetres
    end_mm: Millimetres


def position_fault(stored: StoredPosition | None, found: PositionEvidence) -> PositionFault | None:
    """Return why a stored position must not be used; None if the evidence is complete.

    Example:
        >>> stored = StoredPosition(47001, "XYZ", (0, 0, 0), (0, 0, -5), (0, 0, -5))
        >>> found = PositionEvidence(True, 47001, "XYZ", (0, 0, -5), 0.01)
        >>> position_fault(stored, found) is None
        True
        >>> position_fault(stored, replace(found, marker=0)).value
        'marker-lost'
    """
    if not found.motors_hold:
        return PositionFault.MOTORS_RELEASED
    if stored is None:
        return PositionFault.NO_RECORD
    if stored.marker != found.marker or not found.marker:
        return PositionFault.MARKER_LOST
    if stored.settings != found.settings:
        return PositionFault.SETTINGS_DIFFER
    off_mm = distance_to_segment(found.counts_mm, stored.start_mm, stored.end_mm)
    return PositionFault.COUNTS_DIFFER if not off_mm <= found.tolerance_mm else None


class PositionStore:
    """The stored position of one stage; a position that is not known is not stored.

    Args:
        port: Port of the stage: a path, or the serial number of its adapter.
        folder: Folder of the file; by default the user's state folder.
    """

    def __init__(self, port: str, folder: Path | None = None) -> None:
        device = port_named(port) if os.sep in port else port
        name = hashlib.sha256(device.encode()).hexdigest()[:16]
        self._path = (folder or state_folder()) / f"position-{name}.json"
        self._known: StoredPosition | None = None
        self.lost = PositionFault.NO_RECORD

    def recall(self, found: PositionEvidence) -> StoredPosition:
        """Return the stored position, and keep it up to date from now on."""
        stored = self._read()
        fault = position_fault(stored, found)
        if fault is not None or stored is None:
            self.lost = fault or PositionFault.NO_RECORD
            detail = ""
            if stored is not None and fault is PositionFault.COUNTS_DIFFER:
                detail = f": it was left at {shown(stored.end_mm)} and counts {shown(found.counts_mm)}"
            raise unknown(f"{WHY[self.lost]}{detail}", self.lost)
        self._known = stored
        return stored

    def establish(self, marker: int, settings: str, origin_mm: Millimetres, at_mm: Millimetres) -> None:
        """Store a position that was found by homing, touch-off, or confirmation."""
        self._write(StoredPosition(marker, settings, origin_mm, at_mm, at_mm))

    @property
    def marker(self) -> int:
        """Marker of the position that is stored; 0 while none is known."""
        return 0 if self._known is None else self._known.marker

    def move(self, start_mm: Millimetres, end_mm: Millimetres) -> None:
        """Store a move before it is sent; one from an unknown position makes a stored one invalid."""
        if self._known is None:
            self.forget(self.lost)
        else:
            self._write(replace(self._known, start_mm=start_mm, end_mm=end_mm))

    def stand(self, at_mm: Millimetres) -> None:
        """Store where the stage stands."""
        if self._known is not None and not self._known.start_mm == self._known.end_mm == at_mm:
            self._write(replace(self._known, start_mm=at_mm, end_mm=at_mm))

    def forget(self, fault: PositionFault = PositionFault.POSITION_LOST) -> None:
        """Remove the stored position."""
        self._known, self.lost = None, fault
        with suppress(OSError):
            self._path.unlink(missing_ok=True)

    def _write(self, stored: StoredPosition) -> None:
        """Replace the file; where the disk refuses, nothing is stored, and nothing can be recalled."""
        self._known = stored
        new = self._path.with_suffix(".new")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            new.write_text(json.dumps(asdict(stored)), encoding="utf-8")
            os.replace(new, self._path)
        except OSError:
            self.forget(PositionFault.NO_RECORD)

    def _read(self) -> StoredPosition | None:
        """Read the file; None where there is none, or it is damaged."""
        try:
            fields = json.loads(self._path.read_text(encoding="utf-8"))
            origin, start, end = (_three(fields[name]) for name in ("origin_mm", "start_mm", "end_mm"))
            return StoredPosition(int(fields["marker"]), str(fields["settings"]), origin, start, end)
        except (OSError, ValueError, TypeError, KeyError, RecursionError):
            return None


def unknown(why: str, fault: PositionFault = PositionFault.POSITION_LOST) -> PositionUnknownError:
    """Return the error that refuses to use a position."""
    return PositionUnknownError(f"the stage's position is not known: {why}. {REMEDY}", code=fault.value)


def counted_by(axes: tuple[str, str, str], steps_per_mm: Millimetres, frame: str) -> str:
    """Return what counts are read by: axes, steps per millimeter, and what defines the sensor's frame."""
    return " ".join([*axes, *(f"{steps:g}" for steps in steps_per_mm), frame]).strip()


def new_marker() -> int:
    """Return a random marker of five digits, which a program would not set by chance."""
    return 10_000 + secrets.randbelow(90_000)


def state_folder() -> Path:
    """Return the user's folder for state that outlives a session."""
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state else Path.home() / ".local" / "state") / "palpate"


def _three(values: Any) -> Millimetres:
    x, y, z = (float(value) for value in values)
    if not all(math.isfinite(value) for value in (x, y, z)):
        raise ValueError("a position that is not finite")
    return x, y, z
