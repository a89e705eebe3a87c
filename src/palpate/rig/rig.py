"""A rig: its devices, its limits, where its layer lies, and the clock that they share.

Retries of a press that a transient fault ended: which faults are transient, and how many are allowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from palpate.core import Clock, ForceSensor, FrameSource, Position, RangeError, Sensor, Stage
from palpate.core.plugins import ERROR, plugin_calls
from palpate.core.provenance import Provenance
from palpate.devices import Limits, Mounting, Reason, SupervisorLink
from palpate.devices.force_trust import StiffnessRange

REJECTED = "rejected"
"""Event of an attempt that a transient fault ended; none of its frames counts."""

TRANSIENT = frozenset(
    {
        Reason.FORCE_STALE,
        Reason.FORCE_LATE,
        Reason.FORCE_SLOW,  # a gap leaves fewer samples than are due
        Reason.FORCE_SENSOR,
        Reason.CAMERA,
        Reason.CLIENT_SILENT,
    }
)
"""Reasons that a short silence or delay of a device, a link, or the recorder may have.

Everything else ends the run: a force beyond its limit, saturation, an implausible force, a zero that does not
return, a stage that lost its position, a stop by hand."""


@dataclass(frozen=True, slots=True)
class RetryLimits:
    """Number of times that presses are repeated after a transient fault.

    Attributes:
        per_press: repetitions of one press; 0 for none.
        per_session: repetitions of all presses until the recording ends or is resumed.
        wait_s: wait at the clearance before a repetition; n times as long before the n-th of a press [s].

    Raises:
        RangeError: a negative number, or a wait that is not finite.
    """

    per_press: int = 3
    per_session: int = 20
    wait_s: float = 1.0

    def __post_init__(self) -> None:
        if not (self.per_press >= 0 and self.per_session >= 0 and 0 <= self.wait_s < math.inf):
            raise RangeError(
                f"retries of {self.per_press} per press, {self.per_session} per session, and a wait of "
                f"{self.wait_s:g} s; all must be 0 or more"
            )

    def allow(self, reason: Reason, attempt: int, retries: int) -> bool:
        """Return whether a press is repeated.

        Args:
            reason: code of the fault that ended the attempt.
            attempt: number of the attempt at this press, from 1.
            retries: repetitions of all presses so far in this session.
        """
        return reason in TRANSIENT and attempt <= self.per_press and retries < self.per_session


VIRTUAL = "virtual:"
"""What the name of a virtual rig begins with, before its sensor's."""


class Region(NamedTuple):
    """A part of the picture that matters.

    Attributes:
        name: such as "fringes".
        box_px: (x, y, width, height).
    """

    name: str
    box_px: tuple[int, int, int, int]


def no_truth(time_ns: int) -> dict[str, float]:
    """A real rig knows no truth beyond what it measures."""
    return {}


def unlimited(indenter: str, lateral: bool) -> float:
    """A real skin is as deep as its limits say."""
    return math.inf


def by_hand(indenter: str) -> bool:
    """A person has to change the indenter."""
    return False


@dataclass(frozen=True, slots=True)
class Rig:
    """Devices, limits and clock that the engine drives.

    Attributes:
        name: such as "virtual:palm".
        sensor: what is calibrated, such as its serial number.
        stage, force, camera: the devices.
        limits: of every motion.
        origin_m: in the stage's frame, the layer's centre at its expected surface [m].
        clock: that all devices stamp on.
        mounting: of the force sensor.
        regions: of the picture.
        licence, origin, provenance: of what is recorded.
        seed: of a virtual rig.
        truth: a virtual rig's own labels at a time, each with its unit in the name.
        truths: the names of those labels.
        mount: change the indenter; False where a person has to.
        known_m: how deep an indenter may press, with a lateral load or without: a virtual skin has a law to
            that depth and none beyond [m].
        noise_n: Stated standard deviation of a force sample along each axis, resolution included [N]; None if
            the manufacturer states none.
        label_force: a second force sensor, which labels frames taken at a stand and guards nothing, so that
            it may be slow; None where there is none.
        label_mounting: of the second force sensor.
        supervisor: process that owns stage and force sensor and guards every motion; None where this process
            does.
        retries: of a press that a transient fault ended.
        stiffness: range of stiffness that each indenter meets, by its name; checked from the first press on.
        weighed_on: date on which a known weight was laid on the force sensor, ISO 8601; empty for none.
        design: of the sensor, whose outline and probe plans are laid on; None where only its plan knows.
    """

    name: str
    sensor: str
    stage: Stage
    force: ForceSensor
    camera: FrameSource
    limits: Limits
    origin_m: Position
    clock: Clock
    mounting: Mounting = field(default_factory=Mounting)
    regions: tuple[Region, ...] = ()
    licence: str = ""
    origin: str = ""
    provenance: Provenance = Provenance.MEASURED
    seed: int | None = None
    truth: Callable[[int], dict[str, float]] = no_truth
    truths: tuple[str, ...] = ()
    mount: Callable[[str], bool] = by_hand
    known_m: Callable[[str, bool], float] = unlimited
    design: Sensor | None = None
    noise_n: float | None = None
    label_force: ForceSensor | None = None
    label_mounting: Mounting = field(default_factory=Mounting)
    supervisor: SupervisorLink | None = None
    stiffness: Mapping[str, StiffnessRange] = field(default_factory=dict)
    weighed_on: str = ""
    retries: RetryLimits = field(default_factory=RetryLimits)

    @property
    def is_simulated(self) -> bool:
        """Whether it is virtual, or one of its devices is, so that what it records is not all measured."""
        return self.provenance is Provenance.SIMULATED

    @property
    def scheduling(self) -> dict[str, str]:
        """Scheduling of the process that guards the motion, and how to get better, see `request_priority`."""
        return (
            {"scheduling": "normal", "remedy": ""} if self.supervisor is None else self.supervisor.scheduling
        )

    def from_origin_mm(self, at_m: Position) -> Position:
        """A place of the stage, from the layer's centre at its expected surface [mm]."""
        x, y, z = (1e3 * float(at - origin) for at, origin in zip(at_m, self.origin_m, strict=True))
        return x, y, z

    def close(self) -> None:
        """Let go of every device, the stage first; all are tried."""
        failed: list[Exception] = []
        for device in (self.stage, self.force, self.supervisor, self.camera, self.label_force):
            if device is None:
                continue
            try:
                with plugin_calls(f"a device did not close ({ERROR})", Exception):
                    device.close()
            except Exception as e:
                failed.append(e)
        if failed:
            raise failed[0]
