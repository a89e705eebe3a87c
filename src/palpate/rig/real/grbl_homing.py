"""Finding a GRBL stage's place by its switches, and lifting its lock; only ever on request."""

from __future__ import annotations

from palpate.core.clock import NS_PER_S
from palpate.core.errors import DeviceError
from palpate.rig.real.grbl_lines import State, Status
from palpate.rig.real.grbl_link import CutOffError, RefusedError, SilenceError
from palpate.rig.real.grbl_names import alarm_name
from palpate.rig.real.grbl_session import Session


def home(session: Session, halts: int) -> None:
    """Drive to the switches and take the machine's own coordinates from there.

    Args:
        session: with the stage's lock held.
        halts: the link's count of halts when this was asked for.

    Raises:
        DeviceError: it is moving, has no switches, did not find them, or was stopped.
    """
    link = session.link
    _clear(session)
    session.lose("homing was not finished")
    session.homing, session.homed = True, None
    try:
        link.command("$H", timeout_s=session.spec.home_s, halts=halts, moves=True)
        status = _await_homed(session, halts)
    except RefusedError:
        session.homing = False
        link.settled()
        raise
    except SilenceError:
        session.bring_to_stand()
        raise
    session.homing = False
    session.check_alarm()
    if status is None or status.state is not State.IDLE:
        raise DeviceError("the stage did not finish homing; see to its switches, then home() again")
    _, place_mm = session.look()
    session.settle(place_mm)
    session.unlocked = False
    session.homed = True if session.homed is None else session.homed
    session.found(session.mount.at_origin())


def unlock(session: Session) -> None:
    """Reset it and lift the lock of an alarm; its place stays unknown.

    Raises:
        DeviceError: it is moving, or refuses.
    """
    alarm = _clear(session)
    session.lose(f"it was unlocked without homing, after {alarm or 'no alarm'}")
    session.unlocked = True
    session.link.command("$X")


def _clear(session: Session) -> str:
    """Make it take `$H` or `$X`: standing, in step, and past the alarm, which is named."""
    link = session.link
    if session.journey:
        raise DeviceError("the stage is moving; stop() it first")
    session.note_restart()
    alarm = link.alarm
    status = link.ask() if alarm is None else None  # after some alarms it answers nothing
    if status and status.state not in (State.IDLE, State.ALARM):
        raise DeviceError(f"the stage is in {status.state}, not idle; stop() it first")
    if status is None or link.out_of_step:  # and some end by a reset alone
        session.reset()
    link.forget_alarm()
    return "" if alarm is None else alarm_name(alarm)


def _await_homed(session: Session, halts: int) -> Status | None:
    """The first report past homing: an `ok` may have been to another line, so it proves nothing."""
    link, spec, clock = session.link, session.spec, session.clock
    began_ns = clock.now_ns()
    while clock.now_ns() - began_ns < spec.home_s * NS_PER_S:
        status = link.ask(spec.home_s)
        if link.halts != halts:
            raise CutOffError("homing was stopped; the stage's position is not known")
        if status is None or status.state not in (State.HOME, State.RUN):
            return status
        clock.sleep(spec.poll_s)
    return None
