"""Session of a GRBL stage while its port is open: settings, place, and whether that can be trusted.

The place is lost on opening the port, on a banner that nobody asked for, on any alarm, on a jump and on a
reset in motion. It comes back by homing, on the caller's word, or as `position_evidence` accepts it. The
volatile marker is the spindle speed, the modal word S: jogs keep it, and every reset returns it to 0.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress

from palpate.core import NS_PER_S, Clock, DeviceError, HardwareStopError
from palpate.rig.real.gcode_spec import Millimetres, Mount, shown
from palpate.rig.real.gcode_stage import CutOffError, PositionLostError, SilenceError
from palpate.rig.real.grbl.grbl_link import CANCEL, HOLD, STOP, STOP_PINS, GrblLink, HeardStatus, RefusedError
from palpate.rig.real.grbl.grbl_move import MoveSupervisor
from palpate.rig.real.grbl.grbl_parser import GrblMessage, GrblState, GrblStatus, alarm_name
from palpate.rig.real.grbl.grbl_supervisor import (
    GrblMachine,
    GrblSpec,
    check_limits,
    check_reports,
    check_startup,
    read_machine,
)
from palpate.rig.real.position_evidence import (
    PositionEvidence,
    PositionFault,
    PositionStore,
    counted_by,
    new_marker,
    unknown,
)
from palpate.rig.real.serial_port import SerialPort

_STANDS = {GrblState.IDLE, GrblState.ALARM, GrblState.SLEEP, GrblState.CHECK}
_SPENT = {GrblState.SLEEP, GrblState.CHECK}  # standing, and brought back by a reset alone
_HOW = "call home(), or reference() on your own word"
_SPINDLE = re.compile(r"\bS(\d+)")  # modal word that any reset clears, and no jog changes
_SLOWING_S = 10.0  # from any speed, until the settings are known
_AGAIN_S = 0.1  # until a byte that asks for a stop is followed by the next, where it goes on
_OTHER_S = 0.3  # for a device that is no GRBL controller to say something
_SYNC_S = 0.5  # for the answer to an empty line of a controller that stands
_NEAR_PERIODS = 2.0  # before its predicted end from which a move is looked at as often as can be
_YOUNG_S = 0.003  # age of a report that two looks in a row share
_RESETS = 8  # stops from as many threads at once
_READINGS = 8  # status reports within which two must agree on the place of a stage that stands


class GrblSession:
    """The state behind a `GrblStage`, which holds its lock around every call here.

    Raises:
        DeviceError: there is no GRBL controller at the port, or its settings cannot be read.
        RangeError: the spec's limits are wider than the machine.
        InputError: it has none, and homing is off.
    """

    def __init__(self, spec: GrblSpec, port: SerialPort, clock: Clock) -> None:
        self.spec, self.clock = spec, clock
        self.mount = Mount(spec.axes)
        self.move: MoveSupervisor | None = None
        self.homing = self.unlocked = False
        self.stuck = False  # it stands in Jog until its door is closed
        self.hal = False  # grblHAL, as its banner or $I names it
        self.homed: bool | None = None  # as grblHAL says; None where it does not
        self.lost = "its port was just opened, which may have reset it"
        self._stood_mm: Millimetres | None = None
        self._boots = 0  # banners accounted for
        self.stored = PositionStore(spec.port)
        self._marked = False
        self._slowing_s = _SLOWING_S
        self._just_seen: HeardStatus | None = None
        self._left_mm = 0.0  # of a move, at least, when the last stop was asked for
        self.link = GrblLink(port, spec.reply_s, spec.status_s, clock)
        try:
            self.machine = self._greet()
            self.hal = "hal" in self.ask_firmware().lower()
            check_reports(self.machine, hal=self.hal)
            check_startup(self.link)
            check_limits(spec, self.machine)
            self._slowing_s = self.machine.slowing_s
        except BaseException:
            self.link.close()
            raise

    def look(self) -> tuple[GrblStatus, Millimetres]:
        """The controller's state, and its place in machine coordinates [mm], asked for now."""
        self.check_alarm()
        status, place_mm = self._where()
        self._check_restart()
        self._check_state(status)
        return status, place_mm

    def glance(self, move: MoveSupervisor) -> GrblStatus | None:
        """The newest report of a move, noted in it; waits for none but near the move's predicted end.

        Returns:
            None where none has come yet that counts.
        """
        self.check_alarm()
        near = move.near_end(self.clock.now_ns(), _NEAR_PERIODS * self.spec.status_s)
        heard = self.link.newest(_YOUNG_S if near else self.spec.status_s, self.spec.poll_s)
        self.check_alarm()
        self._check_restart()
        if self.link.silent_s > self.spec.silence_s:
            raise self._silent()
        if heard is None or heard.number < move.first:
            return None
        place_mm = self._place(heard.status)
        if place_mm and not move.plausible(place_mm, heard.time_ns):  # one wrong digit needs confirmation
            heard = self.link.report(self.spec.reply_s)
            if heard is None:
                raise self._silent()
            place_mm = self._place(heard.status)
        self._check_state(heard.status)
        if place_mm is None:
            return None
        move.note(place_mm, heard.time_ns)
        self.check_place(place_mm)
        ours = self.link.halted_ns >= move.began_ns and heard.status.state is GrblState.HOLD
        if _by_input(heard.status) and (heard.status.pins or not ours):
            where = shown(place_mm)
            raise HardwareStopError(f"the stage was stopped by {_input(heard.status)}, at {where} (machine)")
        return heard.status

    def standing(self, *, fresh: bool = True) -> tuple[GrblStatus, Millimetres]:
        """Look at a stage that must stand where it was left.

        Args:
            fresh: ask now; else what `place_standing` has just seen will do.
        """
        if fresh or self._just_seen is None or self.link.age_s(self._just_seen) > self.spec.poll_s:
            status, place_mm = self.look()
        else:
            self.check_alarm()
            self._check_restart()
            status, place_mm = self._just_seen.status, self._place(self._just_seen.status) or self.look()[1]
        if _by_input(status):
            raise HardwareStopError(f"the stage is stopped by {_input(status)}")
        if status.state is not GrblState.IDLE:
            raise DeviceError(f"the stage is in {status.state}, not idle; stop() it first")
        self.check_place(place_mm)
        return status, place_mm

    def place_standing(self) -> Millimetres:
        """Place of a stage with no move in flight, asked for now, and kept for a move that begins at once."""
        _, place_mm = self.look()
        self.check_place(place_mm)
        latest = self.link.latest
        self._just_seen = latest if latest and self._place(latest.status) == place_mm else None
        return place_mm

    def check_place(self, place_mm: Millimetres) -> None:
        """Compare a place with the way of the move, or with where it stood."""
        stray = ""
        if self.move:
            stray = self.move.stray(place_mm)
        elif self._stood_mm and math.dist(place_mm, self._stood_mm) > self.machine.tolerance_mm:
            stray = f"the stage stood at {shown(self._stood_mm)} and is now at {shown(place_mm)}"
        if stray:
            self.lose("it was found where no move had sent it")
            raise DeviceError(f"{stray}; it may have lost steps: {_HOW}", code="off-path")

    def settle(self, place_mm: Millimetres) -> None:
        """Note that it stands here, with no move in flight."""
        self.move, self._stood_mm, self.homing, self.stuck = None, place_mm, False, False
        self.link.restless = False
        self.stored.stand(place_mm)

    def regain(self, mount: Mount, place_mm: Millimetres) -> None:
        """Take its place as known again, in this frame; store it, unless it can be pushed at rest.

        A place stored with released motors would pass for evidence once $1=255 is set afterwards.
        """
        self.lost, self.mount, self._marked = "", mount, False
        if not self.machine.motors_hold:
            self.stored.forget(PositionFault.MOTORS_RELEASED)
            return
        self.stored.establish(new_marker(), self._settings, mount.origin_mm, place_mm)
        self.keep_marked()

    def recall(self) -> None:
        """Take its place from the last session."""
        _, place_mm = self.standing()
        said = self.link.command("$G")
        modal = " ".join(one.text for one in said if isinstance(one, GrblMessage) and one.tag == "GC")
        word = _SPINDLE.search(modal)
        marker = int(word[1]) if word else 0
        evidence = PositionEvidence(
            self.machine.motors_hold, marker, self._settings, place_mm, self.machine.tolerance_mm
        )
        stored = self.stored.recall(evidence)
        self.lost, self.mount, self._marked = "", Mount(self.spec.axes, stored.origin_mm), True
        self.settle(place_mm)

    def keep_marked(self) -> None:
        """Set the marker of a known place, unless it is set; the controller must be idle."""
        if self._marked or self.lost or not self.stored.marker:
            return
        try:
            self.link.command(f"S{self.stored.marker}")
            self._marked = True
        except (CutOffError, RefusedError):
            self.stored.forget()

    @property
    def _settings(self) -> str:
        machine = self.machine
        return counted_by(self.spec.axes, machine.steps_per_mm, f"{machine.reversed_axes} {self.spec.frame}")

    def lose(self, why: str) -> None:
        """Forget its place, and why."""
        self.lost, self._stood_mm = why, None
        self.stored.forget()

    def note_restart(self) -> bool:
        """Take note of a restart that nobody asked for; whether there was one."""
        if self.link.banners == self._boots:
            return False
        self._boots, self.move = self.link.banners, None
        self.homed = None if self.homed is None else False
        self.lose("its controller restarted by itself")
        return True

    def need_known(self) -> None:
        """Refuse to go on without a place."""
        if self.link.dead:
            raise DeviceError(self.link.dead)
        self.check_alarm()
        self._check_restart()
        if self.lost:
            raise unknown(self.lost, self.stored.lost)

    def need_homed(self) -> None:
        """Refuse to move unhomed where the spec asks for homing."""
        if not self.spec.require_homed:
            return
        if not self.machine.homing:
            raise DeviceError(
                "homing is off on the stage ($22=0); switch it on, or open with require_homed=False and say "
                "where it is by reference()"
            )
        unsure = self.homed is None and self.hal  # only grblHAL reports it
        if self.unlocked or self.homed is False or unsure:
            raise DeviceError("the stage is not homed, so its own limits do not hold; call home()")

    def check_alarm(self) -> None:
        """Refuse to go on after an alarm."""
        if self.link.alarm is not None:
            why = alarm_name(self.link.alarm)
            self.lose(f"it stopped with {why}")
            self.move = None
            raise DeviceError(f"the stage stopped with {why}; see to the cause, then home(), or unlock()")

    def bring_to_stand(self, *, cancelled: bool = False) -> None:
        """Slow down, see it stand, clear the move, and see that it ended short of its target.

        Args:
            cancelled: a jog cancel has gone out just now.

        A jog is cancelled, any other motion held; both slow down within the acceleration and keep the count
        of steps. A reset at a stand keeps it too, and clears what is held, asleep or only checking. A reset
        in motion, which loses the count and says so by an alarm, is left for homing, and for a controller
        that says nothing or does not come to a stand in time.

        A jog cancel that meets the end of its jog leaves grblHAL Idle, suspended, and deaf to lines. Its
        stop command, 0x19, then clears the suspended hold, so that the reset after it keeps the position.
        """
        lost_before, move, sent = self.lost, self.move, self.link.restless
        # Homing ignores all but a reset, and answers nothing until it ends.
        stood = None if self.homing else self._await_stand(cancelled)
        self.note_restart()
        if self.homing:
            self.lose("homing was stopped")
        state = stood[0].state if stood else None
        if state is GrblState.SLEEP:
            self.lose("it was asleep, with its motors off")
        if stood and stood[1] and state is GrblState.JOG:  # a reset with its door open loses the place
            self.settle(stood[1])
            self.stuck = self.link.restless = True  # it answers no line before the next stop
            raise _not_cleared(stood[0])
        if state not in (GrblState.IDLE, GrblState.ALARM) or (sent and not self._takes_lines(state)):
            self.reset(suspended=state is GrblState.IDLE)
        status, place_mm = self._cleared()
        stood_mm = stood[1] if stood else None
        if stood_mm and not self.lost and math.dist(place_mm, stood_mm) > self.machine.tolerance_mm:
            self.lose("its place changed when it was reset")
        if status.state is GrblState.ALARM and state is not GrblState.SLEEP:
            alarm = self.link.alarm
            self.lose("it is locked by an alarm" if alarm is None else f"it stopped with {alarm_name(alarm)}")
        elif status.state not in (GrblState.IDLE, GrblState.ALARM):
            if _held_still(status):
                self.settle(place_mm)
            raise _not_cleared(status)
        if not self.lost:
            self.check_place(place_mm)
        self.settle(place_mm)
        if self.lost and (stood is None or not lost_before):
            raise PositionLostError(f"the stage stands, but its position was lost: {self.lost}; {_HOW}")
        if status.state is GrblState.IDLE:
            self.keep_marked()
        if move and not self.lost:
            self._check_short(move, place_mm)

    def _check_short(self, move: MoveSupervisor, place_mm: Millimetres) -> None:
        """Refuse to call it stopped where it went on to its target from further away than it needs."""
        allowed = move.runs_on_mm(self.spec.latency_s) + self.machine.tolerance_mm
        if math.dist(place_mm, move.target_mm) <= self.machine.tolerance_mm and self._left_mm > allowed:
            raise DeviceError(
                f"the stage did not stop: it went on to its target, {self._left_mm:.3f} mm from where it was "
                f"asked to; {allowed:.3f} mm are its bound. It stands there, at {shown(place_mm)} (machine "
                "coordinates); do not rely on stop() before that is understood",
                code="stop-ignored",
            )

    def _takes_lines(self, state: GrblState | None) -> bool:
        """Whether it answers an empty line; after a cancel that met the end of its jog it can be deaf."""
        if state is GrblState.ALARM or self.link.out_of_step:
            return True  # it is not to be moved before a reset in any case
        try:
            self.link.command("", timeout_s=_SYNC_S)
        except SilenceError:
            return False
        except (CutOffError, RefusedError):  # another stop has come, and looks for itself; or it does answer
            return True
        return True

    def _await_stand(self, cancelled: bool) -> tuple[GrblStatus, Millimetres | None] | None:
        """The first report of a stand that can be trusted, and the place; None where none comes in time."""
        link, clock, move = self.link, self.clock, self.move
        began_ns, previous, sent = clock.now_ns(), None, int(cancelled)
        sent_ns = began_ns if cancelled else None
        if move:
            asked_ns = link.halted_ns if cancelled and link.halted_ns >= move.at_ns else began_ns
            self._left_mm = move.least_left_mm(asked_ns)
        slowing_s = move.slowing_s if move else self._slowing_s
        patience_s = max(self.spec.silence_s - link.silent_s, _SYNC_S)
        while heard := link.report(patience_s):
            patience_s = self.spec.silence_s
            status, place_mm, now_ns = heard.status, self._place(heard.status), clock.now_ns()
            if move and place_mm and previous is None:
                self._left_mm = max(self._left_mm, math.dist(place_mm, move.target_mm))
            # Idle can be of the moment before a line was read, and one place can have a wrong digit.
            same = previous == (status.state, place_mm)
            if same and stands(status):
                return status, place_mm
            late_s = (now_ns - began_ns) / NS_PER_S - slowing_s - self.spec.latency_s
            stuck = same and late_s > 0 and status.state is GrblState.JOG
            if stuck and "D" in status.pins:
                return status, place_mm
            if status.state is GrblState.HOME or late_s > self.spec.stop_s:
                return None
            if _goes_on(status) and (sent_ns is None or now_ns - sent_ns >= _AGAIN_S * NS_PER_S):
                link.slow_down(STOP if stuck else _next_byte(status, sent, late_s > 0))
                sent, sent_ns = sent + 1, now_ns
            previous = status.state, place_mm
            clock.sleep(self.spec.poll_s)
        return None

    def _cleared(self) -> tuple[GrblStatus, Millimetres]:
        """Its state and place once nothing is held, asleep or checking any more, if a reset can do that."""
        status, place_mm = self._where()
        for _ in range(_RESETS):  # the byte of another thread's stop can come after the reset
            if not (_held_still(status) or status.state in _SPENT):
                break
            self.reset()
            status, place_mm = self._where()
            if status.state is GrblState.DOOR:  # its input is still open
                break
        return status, place_mm

    def reset(self, *, suspended: bool = False) -> None:
        """Reset the controller: where it stands, this keeps the place and forgets answers still due.

        Args:
            suspended: it is Idle and may be suspended, in which a reset alone loses the place on grblHAL. In
                an alarm the stop command would unlock it.
        """
        if suspended:
            self.link.slow_down(STOP)
            self.link.report(_SYNC_S)  # it has obeyed before it reports
        if not (self.link.reset() or self.link.reset()):  # a banner can be lost
            self.lose("it did not come back from a reset")
            raise DeviceError(
                "the stage's controller does not answer a reset; it may be moving: cut its power"
                if self.link.restless
                else "the stage's controller does not answer a reset; check its cable and its power"
            )
        self._boots, self._marked = self.link.banners, False

    def ask_firmware(self) -> str:
        """Firmware and version, asked of the controller (`$I`) where no banner named them; empty if unknown.

        Grbl 1.1 answers ``[VER:1.1h.20190830:]``; a build may name itself in ``[FIRMWARE:...]`` as well.
        """
        if self.link.firmware:
            return self.link.firmware
        with suppress(RefusedError):  # in an alarm, or of a build without it
            told = {one.tag: one.text for one in self.link.command("$I") if isinstance(one, GrblMessage)}
            version = told.get("VER", "").strip(": ")
            return " ".join(filter(None, (told.get("FIRMWARE"), version and f"version {version}")))
        return ""

    def _greet(self) -> GrblMachine:
        """Get into step with a controller that may be booting, moving, held, locked or not there."""
        self.link.listen(self.spec.boot_s)
        heard = self.link.report(self.spec.reply_s)
        if heard is None:  # still booting, or locked by an alarm that only a reset ends
            self.link.reset()
            heard = self.link.report(self.spec.reply_s)
        if heard is None:
            self.link.slow_down(b"\n")  # makes some other devices say what they are, and moves none
            self.clock.sleep(_OTHER_S)
            raise DeviceError(
                f"nothing at {self.spec.port} answers as GRBL does, {self.link.tail.in_words()}; check that "
                f"this is the stage's port, power, cable, baud ({self.spec.baud}), and whether the board "
                "needs dtr = true",
                code="not-grbl",
            )
        self._boots = self.link.banners
        state: GrblState | None = heard.status.state
        if state not in (GrblState.IDLE, GrblState.ALARM):
            stood = self._await_stand(cancelled=False)
            if stood and stood[0].state is GrblState.JOG:
                raise _not_cleared(stood[0])
            state = stood[0].state if stood else None
        if state not in (GrblState.IDLE, GrblState.ALARM) or not self._takes_lines(state):
            self.reset(suspended=state is GrblState.IDLE)
            heard = self.link.report(self.spec.reply_s)
        if heard and _by_input(heard.status):
            raise HardwareStopError(f"the stage at {self.spec.port} is stopped by {_input(heard.status)}")
        machine = read_machine(self.link)
        self._boots = self.link.banners
        self.link.alarm = None
        return machine

    def _check_restart(self) -> None:
        if self.note_restart():
            raise DeviceError(
                f"the stage's controller restarted by itself; check its supply, then {_HOW}",
                code="controller-restarted",
            )

    def _check_state(self, status: GrblStatus) -> None:
        if status.state is GrblState.ALARM:
            self.check_alarm()
            self.lose("it is locked by an alarm")
            raise DeviceError(f"the stage is locked by an alarm or awaits homing; {_HOW} after unlock()")
        if status.state is GrblState.UNKNOWN:
            raise DeviceError(
                "the stage is in a state that this driver does not know, and so not safe to move"
            )

    def _where(self) -> tuple[GrblStatus, Millimetres]:
        """State and place, asked for now; a place where it is not expected takes two reports that agree."""
        previous = None if self.move else self._stood_mm
        for _ in range(_READINGS):
            heard = self.link.report(self.spec.silence_s)
            if heard is None:
                self.check_alarm()  # after some alarms it answers nothing
                raise self._silent()
            if (place_mm := self._place(heard.status)) is None:
                continue
            agree = previous and math.dist(place_mm, previous) <= self.machine.tolerance_mm
            if agree or not stands(heard.status):
                return heard.status, place_mm
            previous = place_mm
        raise DeviceError("no two reports agree on where the stage stands; check its cable")

    def _silent(self) -> DeviceError:
        what = (
            "it may still be moving: cut its power" if self.link.restless else "check its cable and its power"
        )
        return DeviceError(
            f"the stage has not answered for {self.spec.silence_s:g} s when asked for its status; {what}"
        )

    def _place(self, status: GrblStatus) -> Millimetres | None:
        """Machine coordinates of a report [mm]; None where it has none, or its field is damaged."""
        self.homed = status.homed if status.homed is not None else self.homed
        if (place := status.machine_mm) is None:
            return None
        if len(place) < len("XYZ"):
            raise DeviceError(f"the stage reports {len(place)} axes; three are needed")
        return place[0], place[1], place[2]


def stands(status: GrblStatus) -> bool:
    """Whether a state is one in which it does not move, for whatever reason."""
    return status.state in _STANDS or _held_still(status)


def _goes_on(status: GrblStatus) -> bool:
    return status.state in (GrblState.JOG, GrblState.RUN, GrblState.UNKNOWN)


def _by_input(status: GrblStatus) -> bool:
    """Whether an input of its own stops it, as a report tells: nothing here holds a move that is followed."""
    held = (
        status.state in (GrblState.DOOR, GrblState.HOLD) and status.substate != 3
    )  # moving back from a door
    return held or bool(set(status.pins) & set(STOP_PINS))


def _input(status: GrblStatus) -> str:
    """Which input, as far as it is told."""
    pins = [name for letter, name in STOP_PINS.items() if letter in status.pins]
    if status.state is GrblState.DOOR and not pins:
        pins = ["its door input"]
    name = " and ".join(pins) or "a hold that this programme did not ask for"
    return (
        f"{name} (it is in {status.in_words}); see why, free that input, then stop() it (palpate rig stop) "
        "and begin again"
    )


def _next_byte(status: GrblStatus, sent: int, overdue: bool) -> bytes:
    """What to send when so many bytes did not bring it to a stand: mostly the kind that fits its state."""
    if status.state is GrblState.JOG:
        return HOLD if overdue and sent % 2 else CANCEL
    return CANCEL if sent % 3 == 2 else HOLD


def _not_cleared(status: GrblStatus) -> DeviceError:
    """Say that it stands where it does, and that it may move only where it may."""
    if status.state is GrblState.JOG or (status.state is GrblState.DOOR and status.substate in (0, 1)):
        return HardwareStopError(f"the stage stands, stopped by {_input(status)}")
    if _held_still(status) or status.state in _SPENT:
        return DeviceError(f"the stage stands, and a reset does not clear its {status.state}; power it anew")
    return DeviceError(f"the stage could not be brought to a stand, it is in {status.state}: cut its power")


def _held_still(status: GrblStatus) -> bool:
    if status.state is GrblState.DOOR:
        return status.substate in (0, 1)  # 2 is moving away, 3 moving back
    return status.state is GrblState.HOLD and status.substate == 0
