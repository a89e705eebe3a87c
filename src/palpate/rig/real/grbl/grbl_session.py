"""Session of a GRBL stage while its port is open: settings, place, and whether that can be trusted.

The place is lost on opening the port, on a banner that nobody asked for, on any alarm, on a jump and on a
reset in motion. It comes back by homing or on the caller's word, never by itself.
"""

from __future__ import annotations

import math

from palpate.core import NS_PER_S, Clock, DeviceError
from palpate.rig.real.grbl.grbl_link import GrblLink, SerialPort
from palpate.rig.real.grbl.grbl_parser import GrblState, GrblStatus, alarm_name
from palpate.rig.real.grbl.grbl_supervisor import (
    GrblMachine,
    GrblSpec,
    Millimetres,
    Mount,
    MoveSupervisor,
    check_limits,
    read_machine,
    shown,
)

_STANDS = {GrblState.IDLE, GrblState.ALARM, GrblState.SLEEP, GrblState.CHECK}
_HOW = "call home(), or reference() on your own word"
_SLOWING_S = 10.0  # from any speed, until the settings are known
_HOLD_AGAIN_S = 0.25  # a second hold too soon would meet a jog that just ended, and leave it held
_HOLDS_MET = 8  # stops from as many threads at once
_OFFSET_WITHIN = 40  # status reports; the work offset comes in one of 10 to 30


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
        self.homed: bool | None = None  # as grblHAL says; None where it does not
        self.lost = "its port was just opened, which may have reset it"
        self._offset_mm: tuple[float, ...] | None = None
        self._stood_mm: Millimetres | None = None
        self._boots = 0  # banners accounted for
        self._slowing_s = _SLOWING_S
        self.link = GrblLink(port, spec.reply_s)
        try:
            self.machine = self._greet()
            check_limits(spec, self.machine)
            self._slowing_s = self.machine.slowing_s
        except BaseException:
            self.link.close()
            raise

    def look(self) -> tuple[GrblStatus, Millimetres]:
        """The controller's state, and its place in machine coordinates [mm]."""
        self.check_alarm()
        status, place_mm = self._where()
        self._check_restart()
        if status.state is GrblState.ALARM:
            self.check_alarm()
            self.lose("it is locked by an alarm")
            raise DeviceError(f"the stage is locked by an alarm or awaits homing; {_HOW} after unlock()")
        if status.state is GrblState.UNKNOWN:
            raise DeviceError(
                "the stage is in a state that this driver does not know, and so not safe to move"
            )
        return status, place_mm

    def standing(self) -> tuple[GrblStatus, Millimetres]:
        """Look at a stage that must stand where it was left."""
        status, place_mm = self.look()
        if status.state is not GrblState.IDLE:
            raise DeviceError(f"the stage is in {status.state}, not idle; stop() it first")
        self.check_place(place_mm)
        return status, place_mm

    def check_place(self, place_mm: Millimetres) -> None:
        """Compare a place with the way of the move, or with where it stood."""
        stray = ""
        if self.move:
            stray = self.move.stray(place_mm)
        elif self._stood_mm and math.dist(place_mm, self._stood_mm) > self.machine.tolerance_mm:
            stray = f"the stage stood at {shown(self._stood_mm)} and is now at {shown(place_mm)}"
        if stray:
            self.lose("it was found where no move had sent it")
            raise DeviceError(f"{stray}; it may have lost steps: {_HOW}")

    def settle(self, place_mm: Millimetres) -> None:
        """Note that it stands here, with no move in flight."""
        self.move, self._stood_mm, self.homing = None, place_mm, False
        self.link.restless = False

    def regain(self, mount: Mount) -> None:
        """Take its place as known again, in this frame."""
        self.lost, self.mount = "", mount

    def lose(self, why: str) -> None:
        """Forget its place, and why."""
        self.lost, self._stood_mm = why, None

    def note_restart(self) -> bool:
        """Take note of a restart that nobody asked for; whether there was one."""
        if self.link.banners == self._boots:
            return False
        self._boots, self._offset_mm, self.move = self.link.banners, None, None
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
            raise DeviceError(f"the stage's position is not known: {self.lost}; {_HOW}")

    def need_homed(self) -> None:
        """Refuse to move unhomed where the spec asks for homing."""
        if not self.spec.require_homed:
            return
        if not self.machine.homing:
            raise DeviceError(
                "homing is off on the stage ($22=0); switch it on, or open with require_homed=False and say "
                "where it is by reference()"
            )
        unsure = self.homed is None and "hal" in self.link.firmware.lower()  # grblHAL says; Grbl never does
        if self.unlocked or self.homed is False or unsure:
            raise DeviceError("the stage is not homed, so its own limits do not hold; call home()")

    def check_alarm(self) -> None:
        """Refuse to go on after an alarm."""
        if self.link.alarm is not None:
            why = alarm_name(self.link.alarm)
            self.lose(f"it stopped with {why}")
            self.move = None
            raise DeviceError(f"the stage stopped with {why}; see to the cause, then home(), or unlock()")

    def bring_to_stand(self) -> None:
        """Hold, see it stand, and clear the move.

        A hold slows down within the acceleration and keeps the count of steps; a reset only then, at
        Hold:0, forgets the rest of the move and keeps the count too. A jog that the hold itself cancels
        ends Idle and needs no reset. A reset in motion, which loses the count, is left for a controller
        that says nothing or does not come to a stand in time.
        """
        lost_before, holding = self.lost, self.link.restless
        # Homing ignores a hold, and answers nothing until it ends.
        stood, stood_mm = (None, None) if self.homing else self._await_stand(holding)
        self.note_restart()
        if stood is None:
            self.lose("it had to be reset while it may have been moving")
        if stood is None or stood.state not in _STANDS:
            self.reset()
        status, place_mm = self._where()
        for _ in range(_HOLDS_MET):  # the hold of another thread's stop can come after the reset
            if not _held_still(status):
                break
            self.reset()
            status, place_mm = self._where()
        if stood_mm and not self.lost and math.dist(place_mm, stood_mm) > self.machine.tolerance_mm:
            self.lose("its place changed when it was reset")
        if status.state is GrblState.ALARM:
            alarm = self.link.alarm
            self.lose("it is locked by an alarm" if alarm is None else f"it stopped with {alarm_name(alarm)}")
        elif status.state is not GrblState.IDLE:
            raise DeviceError(
                f"the stage could not be brought to a stand, it is in {status.state}: cut its power"
            )
        if not self.lost:
            self.check_place(place_mm)
        self.settle(place_mm)
        if self.lost and (stood is None or not lost_before):
            raise DeviceError(f"the stage stands, but its position was lost: {self.lost}; {_HOW}")

    def _await_stand(self, holding: bool) -> tuple[GrblStatus | None, Millimetres | None]:
        """The first report of a stand that can be trusted, and the place; None where none comes in time."""
        began_ns, previous = self.clock.now_ns(), None
        held_ns = began_ns if holding else began_ns - round(_HOLD_AGAIN_S * NS_PER_S)
        while self.clock.now_ns() - began_ns < (self.spec.stop_s + self._slowing_s) * NS_PER_S:
            status = self.link.ask()
            if status is None:
                break
            place_mm = self._place(status)
            if _held_still(status):
                return status, place_mm
            # Idle can be of the moment before the hold was taken up; the same twice cannot.
            if status.state in _STANDS and (previous == status or not holding):
                return status, place_mm
            going = status.state not in _STANDS and status.state is not GrblState.HOLD
            if going and self.clock.now_ns() - held_ns >= _HOLD_AGAIN_S * NS_PER_S:
                self.link.hold()  # the first may have been lost, or was never sent
                holding, held_ns = True, self.clock.now_ns()
            previous = status
            self.clock.sleep(self.spec.poll_s)
        return None, None

    def reset(self) -> None:
        """Reset the controller: where it stands, this keeps the place and forgets answers still due."""
        if not self.link.reset():
            self.lose("it did not come back from a reset")
            raise DeviceError(
                "the stage's controller does not answer a reset; it may be moving: cut its power"
            )
        self._boots, self._offset_mm = self.link.banners, None

    def _greet(self) -> GrblMachine:
        """Get into step with a controller that may be booting, moving, held, locked or not there."""
        self.link.listen(self.spec.boot_s)
        status = self.link.ask()
        if status is None:  # still booting, or locked by an alarm that only a reset ends
            self.link.reset()
            status = self.link.ask()
        if status is None:
            raise DeviceError(
                f"nothing at {self.spec.port} answers as GRBL does; check power, cable, baud, and whether "
                "the board needs dtr=True"
            )
        self._boots = self.link.banners
        if status.state not in _STANDS:
            self.link.hold()
            stood, _ = self._await_stand(holding=True)
            if stood is None or stood.state not in _STANDS:
                self.reset()
        machine = read_machine(self.link)
        self._boots = self.link.banners
        self.link.alarm = None
        return machine

    def _check_restart(self) -> None:
        if self.note_restart():
            raise DeviceError(f"the stage's controller restarted by itself; check its supply, then {_HOW}")

    def _where(self) -> tuple[GrblStatus, Millimetres]:
        for _ in range(_OFFSET_WITHIN):
            status = self.link.ask()
            if status is None:
                self.check_alarm()  # after some alarms it answers nothing
                raise DeviceError("the stage does not answer; if it moves, cut its power")
            place_mm = self._place(status)
            if place_mm is not None:
                return status, place_mm
        raise DeviceError("the stage does not report where it is; set $10=1 on it")

    def _place(self, status: GrblStatus) -> Millimetres | None:
        """Machine coordinates of a report, of either kind [mm]."""
        self._offset_mm = status.offset_mm or self._offset_mm
        self.homed = status.homed if status.homed is not None else self.homed
        if status.machine_mm is not None:
            place = status.machine_mm
        elif status.work_mm is not None and self._offset_mm is not None:
            place = tuple(a + b for a, b in zip(status.work_mm, self._offset_mm, strict=False))
        else:
            return None
        if len(place) < len("XYZ"):
            raise DeviceError(f"the stage reports {len(place)} axes; three are needed")
        return place[0], place[1], place[2]


def _held_still(status: GrblStatus) -> bool:
    if status.state is GrblState.DOOR:
        return status.substate in (0, 1)  # 2 is moving away, 3 moving back
    return status.state is GrblState.HOLD and status.substate == 0
