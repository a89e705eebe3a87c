"""A fake GRBL controller with the lines that it reads: settings, jogs, moves, homing, sleep and check."""

from __future__ import annotations

from tests.fakes.gcode_words import MAX_LINE, Modes, RefusalError, Words, read_words
from tests.fakes.grbl_controller import PLANNER, RX_BYTES, GrblController, Work
from tests.fakes.grbl_motion import NOWHERE, Millimetres, PlannedBlock

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
            words = read_words(line)
            if not self._checking:
                yield from self._gcode(words)
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
        if self._checking and line == "$C":
            self._say("[MSG:Disabled]")
            self._soft_reset()
            return "ok"
        if self.state not in ("Idle", "Alarm") or (line == "$C" and self._alarm):
            raise RefusalError(8)
        if line == "$$":
            self._dump()
        elif line == "$I":
            version = "1.1f.20260817" if self._hal else "1.1h.20190830"
            self._say(f"[VER:{version}:]", f"[OPT:V,{PLANNER},{RX_BYTES}]")
            if self._hal:
                self._say("[FIRMWARE:grblHAL]")
        elif line == "$N":
            self._say(*(f"$N{i}={block}" for i, block in enumerate(self.model.startup)))
        elif line == "$G":
            unit, how = "G20" if self._modes.inches else "G21", "G91" if self._modes.steps else "G90"
            feed = f"{self._modes.feed_mm_min:.0f}"
            spindle = f"{self._modes.spindle:.0f}" + "." * (self.model.firmware == "grblHAL")
            self._say(f"[GC:{self._modes.motion} G54 G17 {unit} {how} G94 M5 M9 T0 F{feed} S{spindle}]")
        elif line == "$X":
            if self._hard:
                raise RefusalError(79)
            self._alarm = False
            self._say("[MSG:Caution: Unlocked]")
        elif line == "$C":
            self._checking = True
            self._say("[MSG:Enabled]")
        elif line == "$SLP":
            if self._hal:  # a default build has no sleep
                raise RefusalError(3)
            self._reply("ok")
            self._sleeping = True
            self._say("[MSG:Sleeping]")
            while True:
                yield
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
