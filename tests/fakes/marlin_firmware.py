"""A fake Marlin controller: bytes and time in, bytes and motion out. It fails as it is told to.

Made from Marlin's public documentation and from logs that users published, not from its code, and compared
with no real controller. What each thing it does is taken from:

* numbers, checksums, `Error:checksum mismatch, Last Line: 30` and `Resend: 31`: RepRap's G-code page, M110,
  and logs in its forum; `ok` when a line is queued, not done: docs/Queue.md;
* M114's `X:` as planned and `Count` as the steps made, M114_LEGACY: the page of M114;
* M410 at once with an emergency parser and in its turn without, with no slowing down and steps lost by it, a
  line cut short hiding it: the page of M410, the commit that brought the parser; M112: the page of M112;
* G28's `echo:busy: processing` every 2 s: the page of M113; M118, M211, M503, M84: their pages and logs.

Simplified: every move starts and ends at a stand, all axes share one acceleration, and a stop from above the
jerk loses the way that slowing down would have taken.
"""

from __future__ import annotations

import math
import re
from collections.abc import Generator
from dataclasses import dataclass, field
from functools import reduce
from operator import xor

from tests.fakes.grbl_motion import NOWHERE, Axes, Millimetres, PlannedBlock, add_mm

Work = Generator[None, None, tuple[str, ...]]
_TICK_S = 0.002
_BUSY_S = 2.0
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_PLANNER = 16


@dataclass(frozen=True, slots=True)
class MarlinParameters:
    """Parameters of the machine that is faked.

    Attributes:
        emergency_parser: M410 and M112 are heeded as they arrive.
        legacy_m114: it tells its place only when the move is over.
        steps_per_mm, top_mm_s, acceleration_mm_s2, jerk_mm_s: M92, M203, M201, M205.
        junction: it has junction deviation and no jerk.
        least_mm, greatest_mm: its box, M211.
        start_mm: where it stands when switched on, in the counts of a homed machine [mm].
        homing_s: how long homing takes [s].
        boot_s: from switching on to its `start`; it hears nothing before [s].
        needs_homing: it refuses to move before.
        core_xy: its counts are motors'.
        level_mm: by which bed levelling shifts its Z [mm].
        latency_s: from M410 to its effect [s].
        idle_s: without a move, until the motors are released; 0 for never. M84 S changes it until the next
            start [s].
        extruder: M114 and G92 have an E.
    """

    emergency_parser: bool = True
    legacy_m114: bool = False
    steps_per_mm: Millimetres = (80.0, 80.0, 400.0)
    top_mm_s: Millimetres = (300.0, 300.0, 5.0)
    acceleration_mm_s2: float = 100.0
    jerk_mm_s: Millimetres = (8.0, 8.0, 4.0)
    junction: bool = False
    least_mm: Millimetres = NOWHERE
    greatest_mm: Millimetres = (200.0, 200.0, 200.0)
    start_mm: Millimetres = (100.0, 100.0, 100.0)
    homing_s: float = 5.0
    boot_s: float = 0.0
    needs_homing: bool = False
    core_xy: bool = False
    level_mm: float = 0.0
    latency_s: float = 0.0
    idle_s: float = 120.0
    extruder: bool = True


@dataclass(frozen=True, slots=True)
class MarlinFaults:
    """Faults; none by default.

    Attributes:
        mute: it hears, and says nothing.
        ignores_stop: it does not heed M410.
        lose_ok_of: the `ok` of a line that begins so is lost.
        lose_every, damage_every: one of so many lines of the host is lost, or has a bit turned; 0 for none.
        garble_every: one of so many lines that it says is damaged; 0 for none.
        noise: bytes before every line that it says.
        restart_after_mm, stuck_after_mm, jump_after_mm: so far into its moves it restarts, stands still, or
            finds its count off by `jump_mm` [mm].
        quiet_start: it does not say `start`.
    """

    mute: bool = False
    ignores_stop: bool = False
    lose_ok_of: str = ""
    lose_every: int = 0
    damage_every: int = 0
    garble_every: int = 0
    noise: bytes = b""
    restart_after_mm: float = math.inf
    stuck_after_mm: float = math.inf
    jump_after_mm: float = math.inf
    jump_mm: Millimetres = NOWHERE
    quiet_start: bool = False


@dataclass(slots=True)
class _Modes:
    steps: bool = False
    feed_mm_s: float = 25.0
    percent: float = 100.0  # of it, as a panel or another program sets it
    words: dict[str, float] = field(default_factory=dict)


class MarlinFirmware:
    """The controller and its axes.

    Attributes:
        faults: may be changed at any time.
        received: every byte that came, for tests to look at.
        stops: the true place when each M410 took effect [mm].
        killed: it gave up, and hears nothing until it is switched on again.
    """

    def __init__(self, model: MarlinParameters, faults: MarlinFaults, now_s: float) -> None:
        self.model, self.faults = model, faults
        self.received = bytearray()
        self.stops: list[Millimetres] = []
        self._now_s = now_s
        self._out = bytearray()
        self._axes = Axes(model.acceleration_mm_s2, model.start_mm)
        self._slip_mm = NOWHERE  # how far it truly is from its counts
        self._travelled_mm, self._jumped = 0.0, False
        self._heard_lines = self._said_lines = 0
        self.power_up()

    @property
    def place_mm(self) -> Millimetres:
        """True place, in the counts of a homed machine [mm]."""
        return add_mm(self._axes.place_mm, self._slip_mm)

    @property
    def speed_mm_s(self) -> float:
        """Speed [mm/s]."""
        return 0.0 if self._axes.stuck else self._axes.speed_mm_s

    @property
    def motors_hold(self) -> bool:
        """Whether the motors have current."""
        idle = 0 < self._idle_s <= self._now_s - self._moved_s
        return bool(self._axes.blocks) or not (self._released or idle)

    def push(self, by_mm: Millimetres) -> bool:
        """Push the carriage by hand; it moves, uncounted, only where the motors are released."""
        if not self.motors_hold:
            self._slip_mm = add_mm(self._slip_mm, by_mm)
        return not self.motors_hold

    def power_up(self) -> None:
        """Start as if switched on: counts at zero, not homed, motors released until the first move."""
        self._idle_s, self._moved_s, self._released = self.model.idle_s, self._now_s, True
        self._extruder_mm = 0.0
        self._slip_mm, self.homed = self.place_mm, False
        self._axes.put(NOWHERE)
        self.killed, self._last_line = False, 0
        self._modes, self._line = _Modes(), bytearray()
        self._queue: list[str] = []
        self._work: Work | None = None
        self._doing, self._stop_s, self._busy_s = "", math.inf, math.inf
        self._deaf_until_s, self._booting = self._now_s + self.model.boot_s, True
        self._boot()

    def receive(self, data: bytes) -> None:
        """Bytes from the host, now."""
        self.received += data
        if self._booting or self.killed:
            return
        for byte in data:
            if byte in b"\r\n":
                line = self._line.decode("ascii", "replace").strip()
                self._line.clear()
                if line:
                    self._hear(line)
            else:
                self._line.append(byte)
        self._serve()

    def take(self) -> bytes:
        """Bytes for the host."""
        sent = bytes(self._out)
        self._out.clear()
        return b"" if self.faults.mute else sent

    def run_to(self, now_s: float) -> None:
        """Let time go by until then [s]."""
        while self._now_s < now_s - 1e-9:
            step_s = min(_TICK_S, now_s - self._now_s)
            if not (self._axes.blocks or self._work or self._booting or self._stop_s < math.inf):
                step_s = now_s - self._now_s  # nothing can happen meanwhile
            self._now_s += step_s
            self._tick(step_s)

    def _tick(self, step_s: float) -> None:
        if self._booting:
            self._boot()
            return
        if self._now_s >= self._stop_s:
            self._stop_dead()
        before = self._axes.place_mm
        if self._axes.blocks:
            self._moved_s, self._released = self._now_s, False
        self._axes.advance(step_s)
        self._travelled_mm += math.dist(before, self._axes.place_mm)
        self._break_down()
        if self._work and self._now_s >= self._busy_s:
            self._say("echo:busy: processing")
            self._busy_s = self._now_s + _BUSY_S
        self._serve()

    def _boot(self) -> None:
        if self._now_s >= self._deaf_until_s:
            self._booting = False
            if not self.faults.quiet_start:
                self._say("start", "Marlin 2.1.2", "echo:Hardcoded Default Settings Loaded")

    def _break_down(self) -> None:
        self._axes.stuck = self._axes.stuck or self._travelled_mm > self.faults.stuck_after_mm
        if self._travelled_mm > self.faults.jump_after_mm and not self._jumped:
            self._jumped = True
            self._axes.shift(self.faults.jump_mm)
            x, y, z = (-by for by in self.faults.jump_mm)
            self._slip_mm = add_mm(self._slip_mm, (x, y, z))
        if self._travelled_mm > self.faults.restart_after_mm:
            self._travelled_mm = -math.inf  # once
            self._stop_dead()
            self.power_up()

    def _hear(self, line: str) -> None:
        self._heard_lines += 1
        faults = self.faults
        if faults.lose_every and self._heard_lines % faults.lose_every == 0:
            return
        if faults.damage_every and self._heard_lines % faults.damage_every == 0:
            line = line[:-4] + chr(ord(line[-4]) ^ 1) + line[-3:] if len(line) > 4 else line
        if self.model.emergency_parser and line in ("M410", "M112"):
            self._emergency(line)
            self._say("ok")
            return
        if (command := self._checked(line)) is not None:
            self._queue.append(command)

    def _emergency(self, line: str) -> None:
        if line == "M112":
            self._stop_dead()
            self.killed = True
            self._queue, self._work = [], None
            self._say("Error:Printer halted. kill() called!")
        elif not self.faults.ignores_stop:
            self._stop_s = self._now_s + self.model.latency_s
            if self.model.latency_s == 0:
                self._stop_dead()

    def _checked(self, line: str) -> str | None:
        if not line.startswith("N"):
            return line
        body, star, told = line.rpartition("*")
        found = re.match(r"N(\d+) (.*)", body)
        if not star or not found or not told.isdigit() or reduce(xor, body.encode()) != int(told):
            self._ask_again("checksum mismatch")
            return None
        number, command = int(found[1]), found[2]
        if number != self._last_line + 1 and not command.startswith("M110"):
            self._ask_again("Line Number is not Last Line Number+1")
            return None
        self._last_line = number
        return command

    def _ask_again(self, why: str) -> None:
        self._say(f"Error:{why}, Last Line: {self._last_line}", f"Resend: {self._last_line + 1}", "ok")

    def _serve(self) -> None:
        while self._work or self._queue:
            if self._work is None:
                self._doing = self._queue.pop(0)
                self._work, self._busy_s = self._do(self._doing), self._now_s + _BUSY_S
            try:
                next(self._work)
                return
            except StopIteration as done:
                self._work = None
                self._say(*done.value)
                if not (self.faults.lose_ok_of and self._doing.startswith(self.faults.lose_ok_of)):
                    self._say("ok")

    def _do(self, line: str) -> Work:
        words = {letter: float(value) for letter, value in _WORD.findall(line)}
        match line.split()[0]:
            case "G0" | "G1":
                return (yield from self._move(words))
            case "G28":
                return (yield from self._home())
            case "G90" | "G91":
                self._modes.steps = line.startswith("G91")
            case "M110":
                self._last_line = int(line.rpartition("N")[2])
            case "M112" | "M410":
                self._emergency(line)
            case "M114":
                while self.model.legacy_m114 and self._axes.blocks:
                    yield
                return (self._place(),)
            case "M115":
                parser = int(self.model.emergency_parser)
                return ("FIRMWARE_NAME:Marlin 2.1.2 (Nov 2022) MACHINE_TYPE:fake EXTRUDER_COUNT:1",
                        "Cap:EEPROM:1", f"Cap:EMERGENCY_PARSER:{parser}")  # fmt: skip
            case "M118":
                return (line.partition(" ")[2],)
            case "M211":
                low, high = (
                    "X{:.2f} Y{:.2f} Z{:.2f}".format(*ends)
                    for ends in (self.model.least_mm, self.model.greatest_mm)
                )
                return (f"echo:Soft endstops: ON  Min:  {low}   Max:  {high}",)
            case "M503":
                return self._settings()
            case "G92" if self.model.extruder and set(words) == {"G", "E"}:
                self._extruder_mm = words["E"]
            case "M84" if "S" in words:
                self._idle_s = words["S"]
            case "M84":
                self._released = True
            case "M17":
                self._released, self._moved_s = False, self._now_s
            case "M220":
                self._modes.percent = words["S"]
            case "G21" | "M400":
                pass
            case _:
                return (f'echo:Unknown command: "{line}"',)
        return ()

    def _settings(self) -> tuple[str, ...]:
        model = self.model

        def axes(values: Millimetres) -> str:
            return "X{:.2f} Y{:.2f} Z{:.2f} E25.00".format(*values)

        jerk = "J0.01" if model.junction else axes(model.jerk_mm_s)
        acceleration = model.acceleration_mm_s2
        return (
            "echo:; Steps per unit:",
            f"echo: M92 {axes(model.steps_per_mm)}",
            f"echo:  M203 {axes(model.top_mm_s)}",
            f"echo:  M201 {axes((acceleration, acceleration, acceleration))}",
            f"echo:  M204 P500.00 R500.00 T{10 * acceleration:.2f}",
            "echo:; Advanced: B<min_segment_time_us> S<min_feedrate> T<min_travel_feedrate>",
            f"echo:  M205 B20000.00 S0.00 T0.00 {jerk}",
        )

    def _move(self, words: dict[str, float]) -> Work:
        if self.model.needs_homing and not self.homed:
            return ("echo:Home XYZ First",)
        while len(self._axes.blocks) >= _PLANNER:
            yield
        start = self._axes.end_mm
        ends = []
        for axis, at, low, high in zip(
            "XYZ", start, self.model.least_mm, self.model.greatest_mm, strict=True
        ):
            end = at if axis not in words else words[axis] + (at if self._modes.steps else 0.0)
            ends.append(min(max(end, low), high) if self.homed else end)  # clipped, and nothing is said
        self._modes.feed_mm_s = words.get("F", 60 * self._modes.feed_mm_s) / 60
        feed_mm_s = self._modes.feed_mm_s * self._modes.percent / 100
        self._axes.add(PlannedBlock(start, (ends[0], ends[1], ends[2]), feed_mm_s))
        return ()

    def _home(self) -> Work:
        end_s = self._now_s + self.model.homing_s
        while self._now_s < end_s:
            yield
        true = self.place_mm
        self._axes.put(self.model.least_mm)
        self._slip_mm = NOWHERE
        self.homed = True
        self._travelled_mm += math.dist(true, self.model.least_mm)
        return ()

    def _place(self) -> str:
        x, y, z = self._axes.end_mm
        place, steps = self._axes.place_mm, self.model.steps_per_mm
        place = add_mm(place, (0.0, 0.0, self.model.level_mm))
        a, b, c = (round(at * n) for at, n in zip(place, steps, strict=True))
        letters = "ABZ" if self.model.core_xy else "XYZ"
        counts = " ".join(f"{letter}:{n}" for letter, n in zip(letters, (a, b, c), strict=True))
        extruder = f"E:{self._extruder_mm:.2f} " if self.model.extruder else ""
        return f"X:{x:.2f} Y:{y:.2f} Z:{z:.2f} {extruder}Count {counts}"

    def _stop_dead(self) -> None:
        self._stop_s = math.inf
        if not self._axes.blocks:
            return
        self.stops.append(self.place_mm)
        start, end = self._axes.blocks[0].start_mm, self._axes.blocks[0].end_mm
        speed, length = self._axes.clear(), math.dist(start, end)
        parts = [speed * abs(b - a) / length for a, b in zip(start, end, strict=True)] if length else []
        if any(part > jerk * 1.001 for part, jerk in zip(parts, self.model.jerk_mm_s, strict=False)):
            further = speed**2 / (2 * self._axes.acceleration_mm_s2) / length
            x, y, z = (further * (b - a) for a, b in zip(start, end, strict=True))
            self._slip_mm = add_mm(self._slip_mm, (x, y, z))
        steps = self.model.steps_per_mm
        x, y, z = (round(at * n) / n for at, n in zip(self._axes.place_mm, steps, strict=True))
        self._axes.put((x, y, z))

    def _say(self, *lines: str) -> None:
        for line in lines:
            self._said_lines += 1
            data = line.encode()
            if self.faults.garble_every and self._said_lines % self.faults.garble_every == 0:
                data = data[: len(data) // 2] + b"\xfe" + data[len(data) // 2 + 1 :]
            self._out += self.faults.noise + data + b"\n"
