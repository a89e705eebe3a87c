"""A fake GRBL controller: bytes and time in, bytes and motion out. It fails as it is told to.

Made from observed behaviour of Grbl 1.1h and grblHAL 1.1f, not from their code. The tests put it on a
pseudo-terminal. Simplified: every move starts and ends at a stand, and all axes share one acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Generator

from palpate.rig.fakes.gcode_words import MAX_LINE, Modes, RefusalError, Words, read_words
from palpate.rig.fakes.grbl_motion import NOWHERE, Axes, Millimetres, PlannedBlock, add_mm, in_words
from palpate.rig.fakes.grbl_parameters import SETTINGS, GrblFaults, GrblParameters

PLANNER, RX_BYTES = 15, 128
Work = Generator[None, None, str]
"""A line being done: it yields while it has to wait, and returns its answer."""
_TICK_S = 0.002
_REALTIME = {ord("?"), ord("!"), ord("~"), 0x18}


class GrblController:
    """The controller and its axes; `GrblFirmware` adds what lines mean.

    Attributes:
        faults: may be changed at any time.
        received: every byte that came, for tests to look at.
        holds: the true place when each hold came [mm].
    """

    def __init__(self, model: GrblParameters, faults: GrblFaults, now_s: float) -> None:
        self.model, self.faults = model, faults
        self.settings = {**SETTINGS, **model.settings}
        self.received = bytearray()
        self.holds: list[Millimetres] = []
        self._now_s = now_s
        self._out = bytearray()
        self._axes = Axes(min(self.settings[n] for n in (120, 121, 122)), model.start_mm)
        self._slip_mm = NOWHERE  # how far it truly is from its counts
        self._travelled_mm = 0.0
        self._jumped = False
        self._modes = Modes()
        self._rx, self._line = bytearray(), ""
        self._work: Work | None = None
        self._delayed: list[tuple[float, int]] = []
        self._holding = self._jogging = self._cancelling = self._homing = self._critical = self._hard = False
        self.power_up()
        if model.homed:
            self.homed, self._alarm = True, False
            self._axes.put(model.start_mm)
            self._slip_mm = NOWHERE

    @property
    def place_mm(self) -> Millimetres:
        """True place, in the counts of a homed machine [mm]."""
        return add_mm(self._axes.place_mm, self._slip_mm)

    @property
    def speed_mm_s(self) -> float:
        """Speed [mm/s]."""
        return 0.0 if self._axes.stuck else self._axes.speed_mm_s

    @property
    def state(self) -> str:
        """The state as a status report names it."""
        if self._homing:
            return "Home"
        if self._alarm:
            return "Alarm"
        if self._holding:
            return "Hold:0" if self._axes.speed_mm_s == 0.0 else "Hold:1"
        if self._axes.blocks:
            hidden = self._now_s - self._began_s < self.faults.idle_s
            return "Idle" if hidden else "Jog" if self._jogging else "Run"
        return "Idle"

    def power_up(self) -> None:
        """Start as if switched on: counts at zero, locked where homing is asked for."""
        self._slip_mm, self.homed = self.place_mm, False
        self._axes.put(NOWHERE)
        self._alarm = self.settings[22] == 1
        self._deaf_until_s = self._now_s + self.model.boot_s
        self._booting = True
        self._forget()
        self._boot()

    def receive(self, data: bytes) -> None:
        """Bytes from the host, now."""
        self.received += data
        if self._booting:
            return
        for byte in data:
            if byte in _REALTIME or byte >= 0x80:
                self._realtime(byte)
            elif len(self._rx) < RX_BYTES:
                self._rx.append(byte)
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
            if not (self._axes.blocks or self._work or self._booting or self._delayed):
                step_s = now_s - self._now_s  # nothing can happen meanwhile
            self._now_s += step_s
            self._tick(step_s)

    def _tick(self, step_s: float) -> None:
        if self._booting:
            self._boot()
            return
        if self._delayed and self._now_s >= self._delayed[0][0]:
            self._slow_down(self._delayed.pop(0)[1])
        before = self._axes.place_mm
        self._axes.advance(step_s)
        self._travelled_mm += math.dist(before, self._axes.place_mm)
        self._break_down()
        if self._cancelling and self._axes.speed_mm_s == 0.0:
            self._axes.clear()
            self._cancelling = False
        if not self._axes.blocks:
            self._jogging = False
        self._serve()

    def _boot(self) -> None:
        if self._now_s >= self._deaf_until_s:
            self._booting = False
            self._greet(dump=self.faults.boot_dump)

    def _break_down(self) -> None:
        if self._travelled_mm > self.faults.stuck_after_mm:
            self._axes.stuck = True
        if self._travelled_mm > self.faults.jump_after_mm and not self._jumped:
            self._jumped = True
            self._axes.shift(self.faults.jump_mm)
            x, y, z = (-by for by in self.faults.jump_mm)
            self._slip_mm = add_mm(self._slip_mm, (x, y, z))
        if self._travelled_mm > self.faults.restart_after_mm:
            self._travelled_mm = -math.inf  # once
            self._stop_dead()
            self.power_up()

    def _serve(self) -> None:
        """Get on with lines, until one has to wait."""
        while True:
            if self._work is None:
                end = min((self._rx.find(c) for c in b"\r\n" if c in self._rx), default=-1)
                if end < 0:
                    return
                line = self._rx[:end].decode("ascii", "replace").strip()
                del self._rx[: end + 1]
                self._line, self._work = line, self._do(line)
            try:
                next(self._work)
                return
            except StopIteration as done:
                self._work = None
                self._reply(done.value)
            except RefusalError as refusal:
                self._work = None
                self._reply(f"error:{refusal.code}")

    def _realtime(self, byte: int) -> None:
        if byte == ord("?"):
            if not (self._homing or (self._critical and not self._hard_but_answers())):
                self._out += self._report().encode() + b"\r\n"
        elif byte == 0x18:
            self._soft_reset()
        elif byte == ord("~"):
            self._holding = self._axes.holding = False
        elif byte in (ord("!"), 0x85):
            if byte == ord("!"):
                self.holds.append(self.place_mm)
            self._delayed.append((self._now_s + self.model.latency_s, byte))
            if self.model.latency_s == 0:
                self._slow_down(self._delayed.pop()[1])

    def _slow_down(self, byte: int) -> None:
        if self._alarm or self._homing:
            return
        jogging = self._jogging and bool(self._axes.blocks)
        if byte == 0x85 or (jogging and self.model.hold_cancels_jog):
            if jogging:
                self._cancelling = self._axes.holding = True
        else:
            self._holding = self._axes.holding = True

    def _soft_reset(self) -> None:
        moved = self._axes.speed_mm_s > 0.0
        stale = self._critical and self._work is not None
        homing = self._homing
        self._stop_dead()
        self._forget()
        if stale:
            self._reply("ok")
        if moved or homing:
            self._alarm = True
            self._say("ALARM:6" if homing else "ALARM:3")
        self._greet()

    def _stop_dead(self) -> None:
        """The counts stop at once; what is driven runs on by its momentum."""
        blocks = self._axes.blocks
        start, end = (blocks[0].start_mm, blocks[0].end_mm) if blocks else (NOWHERE, NOWHERE)
        speed, length = self._axes.clear(), math.dist(start, end)
        if speed > 0 and length > 0:
            further = speed**2 / (2 * self._axes.acceleration_mm_s2) / length
            x, y, z = (further * (b - a) for a, b in zip(start, end, strict=True))
            self._slip_mm = add_mm(self._slip_mm, (x, y, z))

    def _forget(self) -> None:
        """Undo what a reset undoes."""
        self._modes = Modes()
        self._rx, self._line = bytearray(), ""
        self._work = None
        self._delayed = []
        self._holding = self._jogging = self._cancelling = self._homing = self._critical = self._hard = False
        self._reports, self._began_s = 0, -math.inf

    def _lock(self, code: int) -> None:
        self._alarm, self._critical, self._hard = True, code in (1, 2), code == 1
        self._say(f"ALARM:{code}")
        if self._critical:
            self._say("[MSG:Reset to continue]")

    def _hard_but_answers(self) -> bool:
        return self._hard and self.model.firmware == "grblHAL"

    def _greet(self, *, dump: bool = False) -> None:
        if dump:
            self._say("error:7")
            self._dump()
        if not self.faults.no_banner:
            hal = self.model.firmware == "grblHAL"
            self._say("", "GrblHAL 1.1f ['$' or '$HELP' for help]" if hal else "Grbl 1.1h ['$' for help]")
        if self._alarm:
            self._say("[MSG:'$H'|'$X' to unlock]")

    def _dump(self) -> None:
        for number, value in sorted(self.settings.items()):
            self._say(f"${number}={value:.3f}" if number >= 100 else f"${number}={value:g}")

    def _report(self) -> str:
        self._reports += 1
        place, offset = self._axes.place_mm, self.model.offset_mm
        mask = int(self.settings[10])
        fields = [self.state]
        if mask & 1:
            fields.append(f"MPos:{in_words(place)}")
        else:
            x, y, z = (a - b for a, b in zip(place, offset, strict=True))
            fields.append(f"WPos:{in_words((x, y, z))}")
        if mask & 2:
            fields.append(f"Bf:{max(PLANNER - len(self._axes.blocks), 0)},{RX_BYTES - len(self._rx)}")
        fields.append(f"FS:{self.speed_mm_s * 60:.0f},0")
        if self._reports % 10 == 2:
            fields.append(f"WCO:{in_words(offset)}")
        if self.model.firmware == "grblHAL":
            fields.append(f"H:{int(self.homed)}")
        return f"<{'|'.join(fields)}>"

    def _reply(self, reply: str) -> None:
        if self.faults.lose_ok_of and self._line.startswith(self.faults.lose_ok_of):
            return
        for _ in range(2 if self.faults.double_ok else 1):
            if self.faults.status_in_reply:
                self._out += f"{reply[0]}{self._report()}\r\n{reply[1:]}\r\n".encode()
            else:
                self._say(reply)

    def _say(self, *lines: str) -> None:
        for line in lines:
            self._out += self.faults.noise + line.encode() + b"\r\n"

    def _do(self, line: str) -> Work:
        raise NotImplementedError


_NO_SWITCH_S = 20.0  # of searching before homing gives up


class GrblFirmware(GrblController):
    """The controller with the lines that it reads. See `GrblController` for what can be looked at."""

    def _do(self, line: str) -> Work:
        if len(line) > MAX_LINE:
            raise RefusalError(11)
        if line.startswith("$J="):
            return (yield from self._jog(line[3:]))
        if line.startswith("$"):
            return (yield from self._dollar(line))
        if line:
            yield from self._gcode(read_words(line))
        return "ok"

    def _jog(self, text: str) -> Work:
        if self._alarm:
            raise RefusalError(9)
        if self.state not in ("Idle", "Jog") or (self._axes.blocks and not self._jogging):
            raise RefusalError(8)
        words = read_words(text)
        if not set(words.codes) <= {"G20", "G21", "G53", "G90", "G91"}:
            raise RefusalError(16)
        modes = words.modes_after(Modes(inches=self._modes.inches, steps=self._modes.steps))
        if modes.feed_mm_min <= 0:
            raise RefusalError(22)
        target = self._target(words, modes)
        if not self._within(target):
            raise RefusalError(15)
        yield from self._queue(PlannedBlock(self._axes.end_mm, target, modes.feed_mm_min / 60.0), jog=True)
        return "ok"

    def _dollar(self, line: str) -> Work:
        if self.state not in ("Idle", "Alarm"):
            raise RefusalError(8)
        if line == "$$":
            self._dump()
        elif line == "$I":
            self._say(f"[VER:{self.model.firmware}.20190830:]", f"[OPT:V,{PLANNER},{RX_BYTES}]")
        elif line == "$G":
            unit, how = "G20" if self._modes.inches else "G21", "G91" if self._modes.steps else "G90"
            feed = f"{self._modes.feed_mm_min:.0f}"
            self._say(f"[GC:{self._modes.motion} G54 G17 {unit} {how} G94 M5 M9 T0 F{feed} S0]")
        elif line == "$X":
            if self._hard:
                raise RefusalError(79)
            self._alarm = False
            self._say("[MSG:Caution: Unlocked]")
        elif line == "$H":
            return (yield from self._home())
        else:
            self._set(line)
        return "ok"

    def _set(self, line: str) -> None:
        number, equals, value = line[1:].partition("=")
        if not (equals and number.isdigit() and int(number) in self.settings):
            raise RefusalError(3)
        if int(number) == 20 and float(value) == 1 and self.settings[22] == 0:
            raise RefusalError(10)
        self.settings[int(number)] = float(value)

    def _home(self) -> Work:
        if self.settings[22] == 0:
            raise RefusalError(5)
        self._homing = True
        until_s = self._now_s + (self.model.homing_s if self.model.switches else _NO_SWITCH_S)
        while self._now_s < until_s:
            yield
        self._homing = False
        if not self.model.switches:
            self._lock(9)
            return "ok"
        pull_off = -self.settings[27]
        self._axes.put((pull_off, pull_off, pull_off))
        self._slip_mm, self._alarm, self.homed = NOWHERE, False, True
        return "ok"

    def _gcode(self, words: Words) -> Work:
        modes = words.modes_after(self._modes)
        axes, motion = words.axes_mm(modes.inches), modes.motion
        if "G4" in words.codes:
            while self._axes.blocks:
                yield
            until_s = self._now_s + words.numbers.get("P", 0.0)
            while self._now_s < until_s:
                yield
        elif axes:
            if self._alarm:
                raise RefusalError(9)
            if motion != "G0" and modes.feed_mm_min <= 0:
                raise RefusalError(22)
            top = min(self.settings[n] for n in (110, 111, 112))
            speed = top if motion == "G0" else min(modes.feed_mm_min, top)
            block = PlannedBlock(self._axes.end_mm, self._target(words, modes), speed / 60.0)
            if not self._within(block.end_mm):
                while self._axes.blocks:
                    yield
                self._lock(2)
                while True:
                    yield
            yield from self._queue(block, jog=False)
        self._modes = modes
        return "ok"

    def _queue(self, block: PlannedBlock, *, jog: bool) -> Work:
        while len(self._axes.blocks) > PLANNER:
            yield
        if not self._axes.blocks:
            self._began_s, self._jogging = self._now_s, jog
        self._axes.add(block)
        return "ok"

    def _target(self, words: Words, modes: Modes) -> Millimetres:
        from_mm = self._axes.end_mm
        target = list(from_mm)
        for axis, value in words.axes_mm(modes.inches).items():
            i = "XYZ".index(axis)
            zero = 0.0 if "G53" in words.codes else self.model.offset_mm[i]
            target[i] = from_mm[i] + value if modes.steps else zero + value
        return target[0], target[1], target[2]

    def _within(self, target: Millimetres) -> bool:
        if self.settings[20] == 0 or (self.model.firmware == "grblHAL" and not self.homed):
            return True
        return all(-self.settings[130 + i] <= value <= 0.0 for i, value in enumerate(target))
