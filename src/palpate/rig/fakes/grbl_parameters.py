"""Parameters of the faked GRBL machine: its settings, what it is, and the faults that it shows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from palpate.rig.fakes.grbl_motion import NOWHERE, Millimetres

SETTINGS: dict[int, float] = {10: 3, 13: 0, 20: 1, 21: 0, 22: 1, 23: 0, 27: 1} | {
    first + axis: value
    for first, value in ((100, 250.0), (110, 1200.0), (120, 50.0), (130, 100.0))
    for axis in range(3)
}
"""Steps/mm, mm/min, mm/s^2 and mm of each axis, and the switches that matter here."""


@dataclass(frozen=True, slots=True)
class GrblParameters:
    """Parameters of the machine that is faked.

    Attributes:
        firmware: "1.1h" or "grblHAL".
        settings: that differ from `SETTINGS`.
        start_mm: where it stands when switched on, in the counts of a homed machine [mm].
        boot_s: from switching on to its banner; it hears nothing before [s].
        homed: as if homed before; else it is locked where $22 asks for homing.
        homing_s: how long homing takes [s].
        switches: whether homing finds them.
        hold_cancels_jog: a hold ends a jog at Idle, and not at Hold:0.
        latency_s: from a byte to its effect, for hold and jog cancel [s].
        offset_mm: of work coordinates [mm].
    """

    firmware: str = "1.1h"
    settings: Mapping[int, float] = field(default_factory=dict)
    start_mm: Millimetres = (-50.0, -50.0, -50.0)
    boot_s: float = 0.0
    homed: bool = False
    homing_s: float = 0.5
    switches: bool = True
    hold_cancels_jog: bool = True
    latency_s: float = 0.0
    offset_mm: Millimetres = NOWHERE


@dataclass(frozen=True, slots=True)
class GrblFaults:
    """Faults; none by default.

    Attributes:
        no_banner: it starts without one.
        boot_dump: `error:7` and the settings before the banner.
        mute: it hears, and says nothing.
        status_in_reply: a status report in the midst of every reply.
        lose_ok_of: a line that begins so is not answered.
        double_ok: every reply comes twice.
        idle_s: for so long after a move began it says Idle [s].
        restart_after_mm, stuck_after_mm, jump_after_mm: so far into its moves it restarts, stands still while
            it says that it runs, or finds its count off by `jump_mm` [mm].
        noise: bytes before every line.
    """

    no_banner: bool = False
    boot_dump: bool = False
    mute: bool = False
    status_in_reply: bool = False
    lose_ok_of: str = ""
    double_ok: bool = False
    idle_s: float = 0.0
    restart_after_mm: float = math.inf
    stuck_after_mm: float = math.inf
    jump_after_mm: float = math.inf
    jump_mm: Millimetres = NOWHERE
    noise: bytes = b""
