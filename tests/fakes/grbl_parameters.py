"""Parameters of the faked GRBL machine: its settings, what it is, and the faults that it shows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from tests.fakes.grbl_motion import NOWHERE, Millimetres

SETTINGS: dict[int, float] = {1: 25, 3: 0, 10: 3, 13: 0, 20: 1, 21: 0, 22: 1, 23: 0, 25: 500, 27: 1} | {
    first + axis: value
    for first, value in ((100, 250.0), (110, 1200.0), (120, 50.0), (130, 100.0))
    for axis in range(3)
}
"""Steps/mm, mm/min, mm/s^2 and mm of each axis, and the switches that matter here; $10 of grblHAL is 511."""


@dataclass(frozen=True, slots=True)
class GrblParameters:
    """Parameters of the machine that is faked.

    Attributes:
        firmware: "1.1h" or "grblHAL"; what differs between them stands at `grbl_controller.GrblController`.
        settings: that differ from `SETTINGS`.
        start_mm: where it stands when switched on, in the counts of a homed machine [mm].
        boot_s: from switching on to its banner; it hears nothing before [s].
        homed: as if homed before; else it is locked where $22 asks for homing.
        homing_s: how long homing takes [s].
        switches: whether homing finds them.
        hold_cancels_jog: on 1.1h a hold ends a jog at Idle, as was seen, and not at Hold:0, as older
            relatives of it do. On grblHAL a hold does not end a jog at all.
        cancel_after_hold: on grblHAL a jog cancel still ends a jog that a hold has met. Not observed either
            way; without it is the worse case, and so the default.
        stop_hears: grblHAL, suspended after a jog cancel, hears lines again after 0x19 alone. Real simulators
            were seen to need 0x18 after it (14 of 14), and so that is the default.
        latency_s: from a byte to its effect, for hold, door and jog cancel [s].
        print_s: how long it prints a report, in which the next `?` is lost [s]; 70 bytes at 115200 baud are
            6 ms. Zero where the clock is in the test's hand: there all is said at one instant.
        offset_mm: of work coordinates [mm].
        startup: blocks run after each reset.
    """

    firmware: str = "1.1h"
    settings: Mapping[int, float] = field(default_factory=dict)
    start_mm: Millimetres = (-50.0, -50.0, -50.0)
    boot_s: float = 0.0
    homed: bool = False
    homing_s: float = 0.5
    switches: bool = True
    hold_cancels_jog: bool = True
    cancel_after_hold: bool = False
    stop_hears: bool = False
    latency_s: float = 0.0
    print_s: float = 0.0
    offset_mm: Millimetres = NOWHERE
    startup: tuple[str, str] = ("", "")


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
        silent: it answers lines, and no `?`.
        lose_every, garble_every, late_every: of so many questions one is lost, of so many reports one has a
            damaged byte, or comes `late_s` late [s]; 0 for none.
        wrong_digit_every: of so many reports one has a wrong digit in a coordinate; 0 for none.
        deaf_to_cancel: it drops 0x85; the control of tests that say what 0x85 is needed for.
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
    silent: bool = False
    lose_every: int = 0
    garble_every: int = 0
    late_every: int = 0
    wrong_digit_every: int = 0
    late_s: float = 2.0
    deaf_to_cancel: bool = False
