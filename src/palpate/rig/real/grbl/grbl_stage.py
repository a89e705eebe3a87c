"""Stage on a Grbl 1.1 or grblHAL controller, over a serial port.

Every move is one bounded jog, `$J=G21G90G53...`, that states all its modes in absolute machine coordinates:
neither a reset nor a unit set by another program changes it. Only one is in flight, since a controller
completes what it holds when its link fails. An emergency stop needs a switch of its own.

Reference: behavior of Grbl 1.1h and grblHAL 1.1f as observed.
"""

from __future__ import annotations

import math
from dataclasses import replace

from palpate.core import NS_PER_S, Clock, DeviceError, Position, PositionUnknownError, RangeError, Travel
from palpate.rig.real.gcode_spec import MM_PER_M, S_PER_MIN, feed_mm_min, fixed
from palpate.rig.real.gcode_stage import CutOffError, GcodeStage, SilenceError
from palpate.rig.real.grbl.grbl_link import GrblLink, RefusedError
from palpate.rig.real.grbl.grbl_move import MoveSupervisor
from palpate.rig.real.grbl.grbl_parser import GrblState, GrblStatus, alarm_name
from palpate.rig.real.grbl.grbl_session import GrblSession, stands
from palpate.rig.real.grbl.grbl_supervisor import GrblMachine, GrblSpec
from palpate.rig.real.position_evidence import WHY, PositionFault
from palpate.rig.real.serial_port import SerialPort

MAX_HOMING_MM_MIN = 600.0  # at which the force stops it within a millimeter
MAX_PULL_OFF_MM = 5.0  # of homing; the probe is lifted by 8 mm before


class GrblStage(GcodeStage):
    """A `palpate.core.Stage`, see `GcodeStage`.

    Raises:
        DeviceError: no GRBL controller answers at the port.
        RangeError: the spec's limits are wider than the machine.
    """

    def __init__(self, spec: GrblSpec, port: SerialPort, clock: Clock | None = None) -> None:
        super().__init__(spec, port, clock)
        self._session = GrblSession(spec, port, self._clock)
        self._link: GrblLink = self._session.link

    @property
    def travel(self) -> Travel:
        """The spec's limits, or the machine's own; speed and deceleration of its slowest axis."""
        machine, spec = self._session.machine, self._spec
        least, greatest = self._session.mount.box_m(machine.least_mm)
        top = min(machine.top_mm_min) / S_PER_MIN / MM_PER_M
        return Travel(
            least_m=least if spec.least_m is None else spec.least_m,
            greatest_m=greatest if spec.greatest_m is None else spec.greatest_m,
            top_speed_m_s=top if spec.top_speed_m_s is None else min(top, spec.top_speed_m_s),
            acceleration_m_s2=min(machine.acceleration_mm_s2) / MM_PER_M,
            latency_s=spec.latency_s,
        )

    @property
    def steps_per_mm(self) -> tuple[float, float, float]:
        """Steps per millimeter of the machine's X, Y, and Z."""
        return self._session.machine.steps_per_mm

    @property
    def direction_mask(self) -> int:
        """Axes whose direction is inverted ($3): bits 0, 1, and 2 for X, Y, and Z."""
        return self._session.machine.reversed_axes

    def position_m(self) -> Position:
        """Place now [m]; of a move between two reports, by calculation. See `palpate.core.Stage`."""
        with self._lock:
            self._session.need_known()
            if move := self._session.move:
                self._session.glance(move)
                return self._session.mount.sensor_m(move.place_at(self._clock.now_ns()))
            return self._session.mount.sensor_m(self._session.place_standing())

    @property
    def health(self) -> str:
        """What was lost or damaged on the wire so far; empty where nothing was."""
        link = self._link
        counts = {"lines damaged": link.garbage, "questions for the status unanswered": link.unanswered}
        return ", ".join(f"{count} {what}" for what, count in counts.items() if count)

    def _go_by(self, by_m: float, speed_m_s: float, halts: int) -> None:
        session = self._session
        session.note_restart()
        _, place_mm = session.look()
        x, y, z = session.mount.sensor_m(place_mm)
        lost, session.lost = session.lost, ""
        try:
            self._go((x, y, z + by_m), speed_m_s, halts, homed=False)
        finally:
            session.lost = session.lost or lost

    @property
    def firmware(self) -> str:
        """Name and version of the controller's firmware, as its banner says; empty where none came."""
        return self._link.firmware

    def ask_firmware(self) -> str:
        """Firmware and version, asked of the controller where no banner named them; empty if unknown."""
        return self._session.ask_firmware()

    @property
    def reported(self) -> str:
        """State and active inputs of its newest report, such as "Door:1, Pn:D"; empty before any."""
        heard = self._link.latest
        return heard.status.in_words if heard else ""

    @property
    def machine(self) -> GrblMachine:
        """The controller's settings that bear on motion."""
        return self._session.machine

    @property
    def motors_hold(self) -> bool:
        """Whether the motors keep their current at rest ($1=255)."""
        return self._session.machine.motors_hold

    def hold_motors(self) -> None:
        """Set $1=255 in the controller's memory; the motors keep their current from the next move on."""
        with self._lock:
            session = self._session
            _, place_mm = session.standing()
            self._link.command("$1=255")
            session.machine = replace(session.machine, motors_hold=True)
            if not session.lost:
                session.regain(session.mount, place_mm)

    def _go(self, position_m: Position, speed_m_s: float, halts: int, *, homed: bool = True) -> None:
        move = self._begin(position_m, speed_m_s, homed=homed)
        words = "".join(f"{axis}{fixed(value)}" for axis, value in zip("XYZ", move.target_mm, strict=True))
        line = f"$J=G21G90G53{words}F{fixed(feed_mm_min(speed_m_s), 3)}"
        try:
            self._link.command(line, halts=halts, moves=True)
        except RefusedError:
            self._session.move = None
            self._link.restless = False
            raise
        except CutOffError:
            if not self._link.restless:  # recalled before it was sent
                self._session.move = None
            raise
        except SilenceError:
            self._session.bring_to_stand()  # it may have begun to move
            raise
        move.first = self._link.next_number

    def moving(self) -> bool:
        with self._lock:
            session = self._session
            move = session.move
            if move is None:
                status, place_mm = session.look()
                session.check_place(place_mm)
                return not (stands(status) or session.stuck)
            status_now = session.glance(move)
            if status_now is None or not move.arrived(status_now):
                return True
            session.settle(move.place_mm)
            return False

    def stop(self) -> None:
        """Slow down to a stand at once; returns when it stands. See `palpate.core.Stage`.

        A jog cancel, 0x85, goes out before anything is waited for: it stops a jog on Grbl 1.1 and on grblHAL,
        and keeps the count of steps; a hold, `!`, stops what is no jog. Calls in other threads that wait for
        an answer end with a `DeviceError`. At worst it takes the spec's `stop_s` and `silence_s`, the slowing
        down and three times `reply_s`.

        Raises:
            DeviceError: besides, it went on to its target, from further away than it needs to stop.
        """
        cancelled = self._link.halt()
        with self._lock:
            self._session.bring_to_stand(cancelled=cancelled)

    def _lose(self, why: str) -> None:
        self._session.lose(why)

    def home(self) -> None:
        """Drive to the switches and take the machine's own coordinates from there; returns when done.

        Raises:
            DeviceError: it is moving, has no switches, did not find them, was stopped, or would home towards
                the skin (`homing-not-confirmed`).
        """
        halts = self._link.halts
        with self._lock:
            axes, machine = self._session.spec.axes, self._session.machine
            if machine.homes_into_skin(axes):
                raise DeviceError(
                    f"homing by $23={machine.homes_down} would drive {axes[2][1]} towards the skin; it was "
                    "not homed. Set $23 so that it homes away from the skin, or correct axes, or give "
                    "--position touch-off",
                    code="homing-not-confirmed",
                )
            if machine.pull_off_mm > MAX_PULL_OFF_MM:  # a switch that is stuck would send it down so far
                raise DeviceError(
                    f"$27={machine.pull_off_mm:g} mm is the way back from the switches, towards the skin; "
                    f"{MAX_PULL_OFF_MM:g} mm are allowed; it was not homed. Set $27 to 1 to 3 mm",
                    code="homing-pull-off",
                )
            if machine.homing_mm_min > MAX_HOMING_MM_MIN:  # a switch that is not felt leads into the skin
                raise DeviceError(
                    f"$25={machine.homing_mm_min:g} mm/min is faster than a force can stop; "
                    f"{MAX_HOMING_MM_MIN:g} mm/min are allowed; it was not homed. Set $25 to 500",
                    code="homing-speed",
                )
            _home(self._session, halts)

    def unlock(self) -> None:
        """Reset it and lift the lock of an alarm without homing; its position stays unknown.

        Raises:
            DeviceError: it is moving or refuses.
        """
        with self._lock:
            session = self._session
            alarm = _clear(session)
            session.lose(f"it was unlocked without homing, after {alarm or 'no alarm'}")
            session.unlocked = True
            session.link.command("$X")

    def reference(self, position_m: Position | None = None) -> None:
        """Take the caller's word for where it stands.

        Args:
            position_m: where it is in the sensor's frame [m]; left out, the controller's own coordinates
                hold, as they do when it was homed and neither reset in motion nor pushed since.

        Raises:
            RangeError: the position is not finite.
            DeviceError: it is not standing idle.
        """
        if position_m is not None and not all(math.isfinite(value) for value in position_m):
            raise RangeError(f"position {position_m} m must be finite")
        with self._lock:
            self._session.note_restart()  # its place is about to be found anew
            _, place_mm = self._session.standing()
            mount = self._session.mount
            mount = mount.at_origin() if position_m is None else mount.placed(place_mm, position_m)
            self._session.settle(place_mm)
            self._session.regain(mount, place_mm)

    def recall(self) -> None:
        """Take its place from the last session, where nothing can have moved or reset it since.

        See `palpate.rig.real.position_evidence`.
        """
        with self._lock:
            self._session.note_restart()
            try:
                self._session.recall()
            except PositionUnknownError as e:
                self._session.lost = WHY[PositionFault(e.code)]
                raise

    def _begin(self, position_m: Position, speed_m_s: float, *, homed: bool = True) -> MoveSupervisor:
        """Everything that must hold before a line that moves is sent."""
        session = self._session
        session.need_known()
        if session.move:
            raise DeviceError("the stage is moving already; wait for it, or stop() it")
        fresh = self._link.out_of_step
        if fresh:
            session.standing()
            session.reset(suspended=True)
        _, place_mm = session.standing(fresh=fresh)
        if homed:
            session.need_homed()
        session.keep_marked()
        target_mm = session.mount.machine_mm(position_m)
        session.stored.move(place_mm, target_mm)
        session.move = MoveSupervisor(
            place_mm,
            target_mm,
            feed_mm_min(speed_m_s),
            session.machine,
            self._spec.still_s,
            self._clock.now_ns(),
        )
        return session.move


def _home(session: GrblSession, halts: int) -> None:
    """Home with the stage's lock held; `halts` is the link's count when this was asked for."""
    link = session.link
    _clear(session)
    session.lose("homing was not finished")
    session.homing, session.homed = True, None
    try:
        link.command("$H", timeout_s=session.spec.home_s, halts=halts, moves=True)
        status = _await_homed(session, halts)
    except RefusedError:
        session.homing = False
        link.restless = False
        raise
    except SilenceError:
        session.bring_to_stand()
        raise
    session.homing = False
    session.check_alarm()
    if status is None or status.state is not GrblState.IDLE:
        raise DeviceError("the stage did not finish homing; see to its switches, then home() again")
    _, place_mm = session.look()
    session.settle(place_mm)
    session.unlocked = False
    session.homed = True if session.homed is None else session.homed
    session.regain(session.mount.at_origin(), place_mm)


def _clear(session: GrblSession) -> str:
    """Make it take `$H` or `$X`: standing, in step, and past the alarm, which is named."""
    link = session.link
    if session.move:
        raise DeviceError("the stage is moving; stop() it first")
    session.note_restart()
    alarm = link.alarm
    heard = link.report(session.spec.reply_s) if alarm is None else None  # after some it answers nothing
    if heard and not stands(heard.status):
        raise DeviceError(f"the stage is in {heard.status.state}, not idle; stop() it first")
    state = heard.status.state if heard else None
    # Some alarms end by a reset alone, and so do sleep, check, and hold.
    if state not in (GrblState.IDLE, GrblState.ALARM) or link.out_of_step:
        session.reset(suspended=state is GrblState.IDLE)
    link.alarm = None
    return "" if alarm is None else alarm_name(alarm)


def _await_homed(session: GrblSession, halts: int) -> GrblStatus | None:
    """The first report past homing: an `ok` may have been to another line, so it proves nothing."""
    link, spec, clock = session.link, session.spec, session.clock
    began_ns = clock.now_ns()
    while clock.now_ns() - began_ns < spec.home_s * NS_PER_S:
        heard = link.report(spec.home_s)
        if link.halts != halts:
            raise CutOffError("homing was stopped; the stage's position is not known")
        if heard is None or heard.status.state not in (GrblState.HOME, GrblState.RUN):
            return heard.status if heard else None
        clock.sleep(spec.poll_s)
    return None
