"""A fake GRBL controller but for its lines: bytes and time in, bytes and motion out; it fails as told.

Made from observed behaviour of Grbl 1.1h and grblHAL 1.1f and from their public documentation, not from their
code. The tests put it on a pseudo-terminal. Simplified: every move starts and ends at a stand, and all axes
share one acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Generator

from tests.fakes.gcode_words import Modes, RefusalError
from tests.fakes.grbl_motion import NOWHERE, Axes, Millimetres, add_mm, in_words
from tests.fakes.grbl_parameters import SETTINGS, GrblFaults, GrblParameters
from tests.fakes.grbl_wire import OutgoingLines

PLANNER, RX_BYTES = 15, 128
Work = Generator[None, None, str]
"""A line being done: it yields while it has to wait, and returns its answer."""
_TICK_S = 0.002
HOLD, CANCEL, DOOR, RESET, STOP = ord("!"), 0x85, 0x84, 0x18, 0x19
_REALTIME = {ord("?"), HOLD, ord("~"), RESET, STOP}
_FEED, _PINS, _OFFSETS = 8, 16, 32  # bits of $10 on grblHAL; Grbl 1.1 always reports these fields


class GrblController:
    """The controller and its axes; `grbl_firmware.GrblFirmware` adds what lines mean.

    How it stops, with the source of each:

    - Feed hold `!` stops a move (Run) on both, by way of Hold:1 to Hold:0, where it keeps its place and waits
      for `~` or 0x18. In Idle it ends in Hold:0. In Alarm, Check, Sleep and while homing it does nothing.
      Observed on both; the states in which it does nothing after the public Grbl 1.1 interface description.
    - In a jog `!` acts as a jog cancel on 1.1h, and ends Idle. On grblHAL it is ignored: the state turns Run
      and the jog runs to its end. Observed on Grbl 1.1h and grblHAL 1.1f.20260817; see also
      github.com/grblHAL/STM32F4xx/issues/105.
    - Jog cancel 0x85 ends a jog at Idle with its place kept, on both; in any other state it does nothing.
      Observed. On grblHAL it also drops lines that were not read yet, which are then never answered (its
      public documentation).
    - A jog cancel that meets the very end of its jog leaves grblHAL Idle, suspended, and deaf to lines. 0x18
      then locks it with ALARM:3 although nothing moves. 0x19 removes the suspended hold, so that 0x18 keeps
      the place; whether it also hears lines after 0x19 alone is `stop_hears`. Observed on grblHAL; 1.1h shows
      no such state (120 stops).
    - 0x19 on grblHAL slows any motion down to Idle and keeps the place. In Alarm it unlocks. 1.1h ignores it.
      Observed.
    - The door, by its input or 0x84, stops every motion on 1.1h: a jog is cancelled first, then the state is
      Door. An input that stays open brings Door back after a reset. Public Grbl 1.1 interface description;
      stock 1.1h has no such input.
    - The door in a jog on grblHAL slows it down to a stand that is reported as Jog with Pn:D, never as Door,
      and deaf. 0x18 then raises ALARM:3. 0x19 ends it once the door is closed; before, it leaves the Jog for
      good. `~` after closing goes on to the target, as Run. Observed.
    - The hold's input stops a move (Run) as the byte does, and no jog on either. Observed.
    - 0x18 at a stand keeps the place; in motion it loses steps and locks with ALARM:3, while homing with
      ALARM:6. Observed.
    - After `$SLP` (Sleep) and `$C` (Check) only 0x18 brings it back. Observed. Sleep switches the motors off
      and so comes back locked; Check comes back Idle. Public Grbl 1.1 interface description.
    - At rest the motors are released after $1 milliseconds, unless $1 is 255; in an alarm and asleep they are
      released in any case. Public Grbl 1.1 documentation.
    - `S` is modal: it survives jogs and a jog cancel, and any reset returns it to 0. Observed on both.
    - A `?` is not answered while homing and after ALARM:1 and ALARM:2; grblHAL answers after ALARM:1.
      Observed.

    Attributes:
        faults: may be changed at any time.
        received: every byte that came, for tests to look at.
        stops: each byte that asked for a stop, in the order of coming, with the true place then [mm].
        door_open: the door's input.
        hold_pressed: the hold's input.
    """

    def __init__(self, model: GrblParameters, faults: GrblFaults, now_s: float) -> None:
        self.model = model
        self.wire = OutgoingLines(faults, model.print_s)
        self.settings = {**SETTINGS, **({10: 511} if self._hal else {}), **model.settings}
        self.received = bytearray()
        self.stops: list[tuple[int, Millimetres]] = []
        self.door_open = self.hold_pressed = False
        self._now_s = now_s
        self._axes = Axes(min(self.settings[n] for n in (120, 121, 122)), model.start_mm)
        self._slip_mm = NOWHERE  # how far it truly is from its counts
        self._travelled_mm = 0.0
        self._jumped = False
        self._work: Work | None = None
        self._delayed: list[tuple[float, int]] = []
        self._alarm = self._booting = self._sleeping = self._hung = self._homing = False
        self._critical = self._cancelling = self._suspended = self._stranded = False
        self._forget()
        self.power_up()
        if model.homed:
            self.homed, self._alarm = True, False
            self._axes.put(model.start_mm)
            self._slip_mm = NOWHERE

    @property
    def faults(self) -> GrblFaults:
        """The faults that it shows now."""
        return self.wire.faults

    @faults.setter
    def faults(self, faults: GrblFaults) -> None:
        self.wire.faults = faults

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
        if self._sleeping:
            return "Sleep"
        if self._alarm:
            return "Alarm"
        if self._checking:
            return "Check"
        stands = self._axes.speed_mm_s == 0.0
        if self._door:
            return f"Door:{int(self.door_open) if stands else 2}"
        if self._holding:
            return "Hold:0" if stands else "Hold:1"
        if self._axes.blocks or self._stranded:
            hidden = self._now_s - self._began_s < self.faults.idle_s
            jogging = self._stranded or (self._jogging and not self._spoilt)
            return "Idle" if hidden else "Jog" if jogging else "Run"
        return "Idle"

    @property
    def motors_hold(self) -> bool:
        """Whether the motors have current."""
        if self._alarm or self._sleeping:
            return False
        return bool(self._axes.blocks) or self.settings[1] == 255

    def push(self, by_mm: Millimetres) -> bool:
        """Push the carriage by hand; it moves, uncounted, only where the motors are released."""
        if not self.motors_hold:
            self._slip_mm = add_mm(self._slip_mm, by_mm)
        return not self.motors_hold

    def power_up(self) -> None:
        """Start as if switched on: counts at zero, locked where homing is asked for."""
        self._slip_mm, self.homed = self.place_mm, False
        self._axes.put(NOWHERE)
        self._alarm = self.settings[22] == 1
        self._deaf_until_s = self._now_s + self.model.boot_s
        self._booting = True
        self._forget()
        self._boot()

    def open_door(self) -> None:
        """Open the door's input, as a switch on the machine does."""
        self.door_open = True
        self._realtime(DOOR)

    def press_hold(self) -> None:
        """Press the hold's input, as a button on the machine does."""
        self.hold_pressed = True
        if not (self._jogging and self._axes.blocks):
            self._realtime(HOLD)

    def close_door(self) -> None:
        """Close the door's input."""
        self.door_open = False

    def receive(self, data: bytes) -> None:
        """Bytes from the host, now."""
        self.received += data
        if self._booting:
            return
        for byte in data:
            if byte == STOP and not self._hal:
                continue
            if byte in _REALTIME or byte >= 0x80:
                self._realtime(byte)
            elif len(self._rx) < RX_BYTES:
                self._rx.append(byte)
        self._serve()

    def take(self) -> bytes:
        """Bytes for the host."""
        return self.wire.take()

    def run_to(self, now_s: float) -> None:
        """Let time go by until then [s]."""
        while self._now_s < now_s - 1e-9:
            step_s = min(_TICK_S, now_s - self._now_s)
            if not (self._axes.blocks or self._work or self._booting or self._delayed):
                step_s = now_s - self._now_s  # nothing can happen meanwhile
            self._now_s += step_s
            self._tick(step_s)
        self.wire.run_to(self._now_s)

    def _tick(self, step_s: float) -> None:
        if self._booting:
            self._boot()
            return
        while self._delayed and self._now_s >= self._delayed[0][0]:
            self._take_up(*self._delayed.pop(0)[1:])
        before = self._axes.place_mm
        self._axes.advance(step_s)
        self._travelled_mm += math.dist(before, self._axes.place_mm)
        self._break_down()
        if self._cancelling and self._axes.speed_mm_s == 0.0:
            self._axes.clear()
            self._cancelling = False
        if not self._axes.blocks:
            self._jogging = self._spoilt = False
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
        while not (self._sleeping or self._suspended or self._stranded):
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
            mute = self._homing or (self._critical and not self._hard_but_answers())
            if self.wire.hears_question(self._now_s) and not mute:
                self.wire.report(self._report(), self._now_s)
            return
        if byte in (HOLD, CANCEL, DOOR, RESET, STOP):
            self.stops.append((byte, self.place_mm))
        if byte == RESET:
            self._soft_reset()
        elif byte == STOP:
            self._stop()
        elif byte == ord("~"):
            if not self.door_open and (self._axes.blocks or not self._stranded):
                self._spoilt = self._spoilt or self._stranded
                self._holding = self._door = self._stranded = self._axes.holding = False
        elif byte == CANCEL:
            self._cancel()
        elif byte in (HOLD, DOOR):
            self._delay(byte)

    def _cancel(self) -> None:
        if self.faults.deaf_to_cancel:
            return
        if self._hal:
            self._rx.clear()
        if self._jogging and self._axes.blocks:  # told apart when it comes, not when it is taken up
            self._delay(CANCEL)

    def _stop(self) -> None:
        if self._homing or self._sleeping:
            return
        self._rx.clear()
        self._hold_pending = False
        self._suspended = self._suspended and not self.model.stop_hears
        self._stranded = self._stranded and self.door_open
        self._cancelling = self._axes.holding = bool(self._axes.blocks)
        self._alarm = self._alarm and self._critical
        self._say("[MSG:Stop]")

    def _delay(self, byte: int) -> None:
        if self.model.latency_s == 0:
            self._take_up(byte)
        else:
            self._delayed.append((self._now_s + self.model.latency_s, byte))

    def _take_up(self, byte: int) -> None:
        if self._alarm or self._homing or self._checking or self._sleeping:
            return
        jogging, hal = self._jogging and bool(self._axes.blocks), self._hal
        if byte == DOOR and jogging and hal:
            self._stranded = self._axes.holding = True
        elif self._stranded:
            return
        elif byte == DOOR:
            self._door = True
            self._cancelling = self._cancelling or jogging
            self._axes.holding = bool(self._axes.blocks)
        elif byte == CANCEL and not jogging:
            self._suspended = self._hold_pending = hal
        elif byte == CANCEL or (jogging and not hal and self.model.hold_cancels_jog):
            if not self._spoilt or self.model.cancel_after_hold:
                self._cancelling = self._axes.holding = True
        elif jogging and hal:
            self._spoilt = not self._cancelling
        elif not (jogging and self._cancelling):
            self._holding = self._axes.holding = True

    def _soft_reset(self) -> None:
        slept = self._sleeping
        moved = self._axes.speed_mm_s > 0.0 or self._stranded or self._hold_pending
        stale = self._critical and self._work is not None
        homing = self._homing
        self._stop_dead()
        self._forget()
        if stale:
            self._reply("ok")
        if moved or homing:
            self._alarm = True
            self._say("ALARM:6" if homing else "ALARM:3")
        self._alarm = self._alarm or slept
        self._greet()
        if self.door_open:
            self._take_up(DOOR)

    def _stop_dead(self) -> None:
        blocks = self._axes.blocks
        start, end = (blocks[0].start_mm, blocks[0].end_mm) if blocks else (NOWHERE, NOWHERE)
        speed, length = self._axes.clear(), math.dist(start, end)
        if speed > 0 and length > 0:
            further = speed**2 / (2 * self._axes.acceleration_mm_s2) / length
            x, y, z = (further * (b - a) for a, b in zip(start, end, strict=True))
            self._slip_mm = add_mm(self._slip_mm, (x, y, z))

    def _forget(self) -> None:
        self._modes = Modes()
        self._rx, self._line = bytearray(), ""
        self._work = None
        self._delayed = []
        self._holding = self._jogging = self._cancelling = self._homing = self._critical = self._hard = False
        self._sleeping = self._checking = self._door = False
        self._spoilt = False  # a hold has met a jog on grblHAL
        self._suspended = False  # a jog cancel has met the end of its jog on grblHAL
        self._hold_pending = False
        self._stranded = False  # the door was opened in a jog on grblHAL
        self._reports, self._began_s = 0, -math.inf

    def _lock(self, code: int) -> None:
        self._alarm, self._critical, self._hard = True, code in (1, 2), code == 1
        self._say(f"ALARM:{code}")
        if self._critical:
            self._say("[MSG:Reset to continue]")

    def _hard_but_answers(self) -> bool:
        return self._hard and self._hal

    @property
    def _hal(self) -> bool:
        return self.model.firmware == "grblHAL"

    def _shows(self, field: int) -> bool:
        return not self._hal or bool(int(self.settings[10]) & field)

    def _greet(self, *, dump: bool = False) -> None:
        if dump:
            self._say("error:7")
            self._dump()
        if not self.faults.no_banner:
            name = "GrblHAL 1.1f ['$' or '$HELP' for help]" if self._hal else "Grbl 1.1h ['$' for help]"
            self._say("", name)
        if self._alarm:
            self._say("[MSG:'$H'|'$X' to unlock]")

    def _dump(self) -> None:
        for number, value in sorted(self.settings.items()):
            if math.isnan(value):  # a setting that this firmware lacks
                continue
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
        if self._shows(_FEED):
            fields.append(f"FS:{self.speed_mm_s * 60:.0f},0")
        if (pins := "D" * self.door_open + "H" * self.hold_pressed) and self._shows(_PINS):
            fields.append(f"Pn:{pins}")
        if self._reports % 10 == 2 and self._shows(_OFFSETS):
            fields.append(f"WCO:{in_words(offset)}")
        if self._hal:
            fields.append(f"H:{int(self.homed)}")
        return f"<{'|'.join(fields)}>"

    def _reply(self, reply: str) -> None:
        if self.faults.lose_ok_of and self._line.startswith(self.faults.lose_ok_of):
            return
        for _ in range(2 if self.faults.double_ok else 1):
            if self.faults.status_in_reply:
                self.wire.put(f"{reply[0]}{self._report()}\r\n{reply[1:]}\r\n".encode())
            else:
                self._say(reply)

    def _say(self, *lines: str) -> None:
        self.wire.say(*lines)

    def _do(self, line: str) -> Work:
        raise NotImplementedError
