"""Faults of a GRBL controller and its line, on the fake of both firmwares."""

from collections.abc import Callable
from functools import partial
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


line_fault = partial(RigFault, "line")
controller_fault = partial(RigFault, "controller")
other_fault = partial(RigFault, "other")
GRBL_FAULTS = (
    line_fault("every third report damaged", spoilt(garble_every=3), ("done",), within=OPEN),
    line_fault("every third question lost", spoilt(lose_every=3), ("done",), within=OPEN),
    line_fault("one report in forty late", spoilt(late_every=40, late_s=0.3), ("done",), within=OPEN),
    line_fault("status in the midst of replies", spoilt(status_in_reply=True), ("done",), within=OPEN),
    line_fault("every answer twice", spoilt(double_ok=True), ("done",), within=OPEN),
    line_fault(
        "answers to moves lost", spoilt(lose_ok_of="$J"), ("stage",), stays="it answers no move", within=NEXT
    ),
    line_fault(
        "8-bit noise before every line",
        spoilt(noise=b"\xff\xfe\x80"),
        ("stage",),
        stays="no line of it can be read",
        within=NEXT,
    ),
    line_fault("hears, and says nothing", spoilt(mute=True), ("stage",), stays=LINE, within=STEP),
    line_fault("unplugged", unplugged, ("stage",), stays=LINE, within=STEP),
    line_fault("port refuses to write", refusing_port, ("stage",), stays=LINE, within=STEP),
    line_fault("port takes a byte too few", short_port, ("stage",), stays=LINE, within=STEP),
    controller_fault("restarts by itself", restarted(), ("stage",), stays=LOST),
    controller_fault("restarts without a banner", restarted(no_banner=True), ("stage",), stays=LOST),
    controller_fault("restarts, and lists its settings", restarted(boot_dump=True), ("stage",), stays=LOST),
    controller_fault("units and modes left by others", said(b"G20G91\n"), ("done", "stage"), within=OPEN),
    controller_fault(
        "soft limit: ALARM:2, then silence", said(b"G21G90G1X500F600\n"), ("stage",), stays=LOST, within=STEP
    ),
    controller_fault("hard limit: ALARM:1", hard_limit, ("stage",), stays=LOST),
    controller_fault("count jumps by 0.5 mm", jumped, ("stage",), stays=LOST, within=STEP),
    controller_fault(
        "says that it runs, and stands",
        spoilt(stuck_after_mm=0.0),
        ("stage", "stage-late"),
        stays="it does not move",
        within=STEP,
    ),
    controller_fault("says Idle before a move begins", spoilt(idle_s=0.02), ("done", "stage"), within=OPEN),
    controller_fault(
        "hold by somebody else",
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
    controller_fault("jog cancelled by somebody else", said(b"\x85"), ("done", "stage"), within=STEP),
    controller_fault("reset by somebody else", said(b"\x18"), ("stage",), stays=LOST),
    controller_fault(
        "put to sleep by somebody else", said(b"$SLP\n"), ("stage", "done"), stays=LOST, within=STEP
    ),
    controller_fault("put to check by somebody else", said(b"$C\n"), ("done", "stage"), within=STEP),
    controller_fault(
        "door opened, and left open", door_opened, ("hardware-stop",), stays="its door is open", within=STEP
    ),
    controller_fault(
        "drops jog cancels, and is aborted",
        deaf_and_aborted,
        ("aborted", "stage"),
        stays="it does not stop",
        within=STEP,
    ),
    other_fault("force sensor does not answer", force_gone, ("force-sensor",), within=AT_ONCE),
    other_fault("abort", commanded(OperatorCommand.ABORT), ("aborted",), within=AT_ONCE),
    other_fault(
        "emergency stop",
        commanded(OperatorCommand.ESTOP),
        ("e-stopped",),
        stays="emergency stop",
        within=AT_ONCE,
    ),
)
"""Faults of the controller, and three others whose stop it has to make, in the order of the table's rows."""
