"""Faults of a GRBL controller and its line, on the fake of both firmwares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.rig.fault_matrix.fault_injection import AT_ONCE, NEXT, OPEN, STEP, Otherwise, RigFault
from tests.rig.fault_matrix.grbl_rig import GrblRig

from palpate.core import DeviceError
from palpate.devices import OperatorCommand

LOST = "its place is lost"
LINE = "its line is gone"


def spoilt(**faults: Any) -> Callable[[GrblRig], None]:
    """The fake fails so from now on."""
    return lambda rig: rig.spoil(**faults)


def said(data: bytes) -> Callable[[GrblRig], None]:
    """Somebody else's programme says these bytes."""
    return lambda rig: rig.say(data)


def restarted(**faults: Any) -> Callable[[GrblRig], None]:
    """The controller restarts by itself."""

    def begin(rig: GrblRig) -> None:
        with rig.terminal.lock:
            rig.terminal.catch_up()
            rig.spoil(**faults)
            rig.firmware._stop_dead()
            rig.firmware.power_up()

    return begin


def door_opened(rig: GrblRig) -> None:
    with rig.terminal.lock:
        rig.terminal.catch_up()
        rig.firmware.open_door()


def hard_limit(rig: GrblRig) -> None:
    """A limit switch is struck: the controller stops dead and locks."""
    with rig.terminal.lock:
        rig.terminal.catch_up()
        rig.firmware._stop_dead()
        rig.firmware._lock(1)


def jumped(rig: GrblRig) -> None:
    """It counts half a millimetre off from now on."""
    with rig.terminal.lock:
        rig.terminal.catch_up()
        rig.firmware._axes.shift((0.0, 0.5, 0.0))
        x, y, z = rig.firmware._slip_mm
        rig.firmware._slip_mm = (x, y - 0.5, z)


def unplugged(rig: GrblRig) -> None:
    rig.terminal.is_gone = True


class _Port:
    def __init__(self, port: Any, taken: Callable[[bytes], int]) -> None:
        self._port, self._taken = port, taken

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def write(self, data: bytes) -> int:
        return self._taken(data)


def refusing_port(rig: GrblRig) -> None:
    def refuse(data: bytes) -> int:
        raise OSError(5, "Input/output error")

    rig.driver._link._port = _Port(rig.driver._link._port, refuse)


def short_port(rig: GrblRig) -> None:
    port = rig.driver._link._port
    rig.driver._link._port = _Port(port, lambda data: len(data) - 1)


def deaf_and_aborted(rig: GrblRig) -> None:
    """It drops every jog cancel, and the operator aborts."""
    rig.spoil(deaf_to_cancel=True)
    rig.control.ask(OperatorCommand.ABORT)


def force_gone(rig: GrblRig) -> None:
    def gone(real: Any, *args: Any) -> Any:
        raise DeviceError("the force sensor does not answer")

    rig.force.replaced["drain"] = rig.force.replaced["latest"] = gone


def commanded(command: OperatorCommand) -> Callable[[GrblRig], None]:
    return lambda rig: rig.control.ask(command)


GRBL_FAULTS = (
    RigFault("every third report damaged", "line", spoilt(garble_every=3), ("done",), within=OPEN),
    RigFault("every third question lost", "line", spoilt(lose_every=3), ("done",), within=OPEN),
    RigFault("one report in forty late", "line", spoilt(late_every=40, late_s=0.3), ("done",), within=OPEN),
    RigFault("status in the midst of replies", "line", spoilt(status_in_reply=True), ("done",), within=OPEN),
    RigFault("every answer twice", "line", spoilt(double_ok=True), ("done",), within=OPEN),
    RigFault(
        "answers to moves lost",
        "line",
        spoilt(lose_ok_of="$J"),
        ("stage",),
        stays="it answers no move",
        within=NEXT,
    ),
    RigFault(
        "8-bit noise before every line",
        "line",
        spoilt(noise=b"\xff\xfe\x80"),
        ("stage",),
        stays="no line of it can be read",
        within=NEXT,
    ),
    RigFault("hears, and says nothing", "line", spoilt(mute=True), ("stage",), stays=LINE, within=STEP),
    RigFault("unplugged", "line", unplugged, ("stage",), stays=LINE, within=STEP),
    RigFault("port refuses to write", "line", refusing_port, ("stage",), stays=LINE, within=STEP),
    RigFault("port takes a byte too few", "line", short_port, ("stage",), stays=LINE, within=STEP),
    RigFault("restarts by itself", "controller", restarted(), ("stage",), stays=LOST),
    RigFault("restarts without a banner", "controller", restarted(no_banner=True), ("stage",), stays=LOST),
    RigFault(
        "restarts, and lists its settings", "controller", restarted(boot_dump=True), ("stage",), stays=LOST
    ),
    RigFault(
        "units and modes left by others", "controller", said(b"G20G91\n"), ("done", "stage"), within=OPEN
    ),
    RigFault(
        "soft limit: ALARM:2, then silence",
        "controller",
        said(b"G21G90G1X500F600\n"),
        ("stage",),
        stays=LOST,
        within=STEP,
    ),
    RigFault("hard limit: ALARM:1", "controller", hard_limit, ("stage",), stays=LOST),
    RigFault("count jumps by 0.5 mm", "controller", jumped, ("stage",), stays=LOST, within=STEP),
    RigFault(
        "says that it runs, and stands",
        "controller",
        spoilt(stuck_after_mm=0.0),
        ("stage", "stage-late"),
        stays="it does not move",
        within=STEP,
    ),
    RigFault(
        "says Idle before a move begins", "controller", spoilt(idle_s=0.02), ("done", "stage"), within=OPEN
    ),
    RigFault(
        "hold by somebody else",
        "controller",
        said(b"!"),
        ("done", "stage", "hardware-stop"),
        stays="it is held",
        within=STEP,
        elsewhere={
            "press": Otherwise(
                ("done", "stage", "hardware-stop", "force-dead"),
                "the force that ceases to rise may be seen before the report of the hold",
            )
        },
    ),
    RigFault("jog cancelled by somebody else", "controller", said(b"\x85"), ("done", "stage"), within=STEP),
    RigFault("reset by somebody else", "controller", said(b"\x18"), ("stage",), stays=LOST),
    RigFault(
        "put to sleep by somebody else",
        "controller",
        said(b"$SLP\n"),
        ("stage", "done"),
        stays=LOST,
        within=STEP,
    ),
    RigFault("put to check by somebody else", "controller", said(b"$C\n"), ("done", "stage"), within=STEP),
    RigFault(
        "door opened, and left open",
        "controller",
        door_opened,
        ("hardware-stop",),
        stays="its door is open",
        within=STEP,
    ),
    RigFault(
        "drops jog cancels, and is aborted",
        "controller",
        deaf_and_aborted,
        ("aborted", "stage"),
        stays="it does not stop",
        within=STEP,
    ),
    RigFault("force sensor does not answer", "other", force_gone, ("force-sensor",), within=AT_ONCE),
    RigFault("abort", "other", commanded(OperatorCommand.ABORT), ("aborted",), within=AT_ONCE),
    RigFault(
        "emergency stop",
        "other",
        commanded(OperatorCommand.ESTOP),
        ("e-stopped",),
        stays="emergency stop",
        within=AT_ONCE,
    ),
)
"""Faults of the controller, and three others whose stop it has to make, in the order of the table's rows."""
