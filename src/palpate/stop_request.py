"""Stop requests to the processes that hold devices, with as few imports as possible.

Every process that holds devices publishes an address file; see `palpate.devices.rpc`. A stop request needs
the file and one loopback connection, and neither NumPy, typer, the rig's file, nor the process that recorded.
Only modules in C are imported: `json` and `socket` load `re` and `enum`, which takes as long as the
interpreter's own start.
"""

from __future__ import annotations

import os
import select
import time

TYPE_CHECKING = False  # as in `typing`, whose import takes too long

if TYPE_CHECKING:
    from json import loads as decode
    from socket import AF_INET, SOCK_STREAM, socket

else:
    try:
        from _json import make_scanner
        from _socket import AF_INET, SOCK_STREAM, socket

        class _ScannerSettings:
            """What json.JSONDecoder gives its scanner."""

            strict, memo = True, {}
            object_hook = object_pairs_hook = None
            parse_int, parse_float, parse_constant = int, float, float

        def decode(text, scan=make_scanner(_ScannerSettings())):  # noqa: B008 - one scanner for all texts
            """Return the value of a JSON text."""
            try:
                return scan(text.lstrip(), 0)[0]
            except StopIteration as e:
                raise ValueError("not JSON") from e
    except ImportError:  # an interpreter other than CPython
        from json import loads as decode
        from socket import AF_INET, SOCK_STREAM, socket

HOST = "127.0.0.1"
CONNECT_S = 0.5
SILENT_S = 1.0  # without an answer, after which a process counts as not answering
MAX_FILE_BYTES = 4096
MAX_REPLY_BYTES = 1 << 20
NICENESS = -10
SUPERVISOR = " supervisor"  # end of a supervisor's name; see `palpate.devices.rpc.supervisor_name`

STOPPED, ENDED, REFUSED = "stopped", "opening-ended", "stop-refused"
GONE, SILENT = "not-reachable", "no-answer"
NOT_CONFIRMED = "stop-not-confirmed"


class Holder:
    """Process that holds devices, and its answer to a stop request.

    Attributes:
        name: name of what it holds.
        pid: its process id.
        code: STOPPED, ENDED (it was opening the devices and let go of them), REFUSED, GONE, or SILENT.
        asked_ns, stood_ns: times of request and standstill on its clock [ns]; None if not reported.
        message: reason of a refusal.
    """

    def __init__(self, name: str, port: int, token: str, pid: int) -> None:
        self.name, self.port, self.token, self.pid = name, port, token, pid
        self.code, self.message = GONE, ""
        self.asked_ns: int | None = None
        self.stood_ns: int | None = None
        self.socket: socket | None = None
        self.received = b""

    @property
    def is_supervisor(self) -> bool:
        """Whether it guards the motion of a recording process."""
        return self.name.endswith(SUPERVISOR)

    @property
    def stood_ms(self) -> float | None:
        """Time from the request to the standstill [ms]."""
        if self.asked_ns is None or self.stood_ns is None:
            return None
        return (self.stood_ns - self.asked_ns) / 1e6

    def to_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {"name": self.name, "pid": self.pid, "code": self.code, "stood_ms": self.stood_ms}


def address_folder() -> str:
    """Return the folder of the user's address files; see `palpate.devices.rpc.folder_of`."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return os.path.join(runtime or os.path.join(os.path.expanduser("~"), ".cache"), "palpate")


def holders_of(name: str, folder: str = "") -> list[Holder]:
    """Return the processes that hold a rig or a bench: those that record on it and those that supervise it.

    Args:
        name: name of the rig, which is "virtual:..." or its file's whole path, or name of the bench.
        folder: folder of the address files; "" for the user's own and those of all workspaces.
    """
    names = (name, name + SUPERVISOR)
    found = [_read(path) for path in _address_files(folder or address_folder())]
    return [one for one in found if one is not None and one.name in names]


def stop_all(holders: list[Holder]) -> None:
    """Send the stop to all of them before any answer is awaited; then fill in their answers."""
    _hurry()
    for one in holders:
        _send(one)
    end_s = time.monotonic() + SILENT_S
    try:
        while waiting := [one for one in holders if one.code == SILENT and one.socket is not None]:
            left_s = end_s - time.monotonic()
            if left_s <= 0:
                return
            for one in _readable(waiting, left_s):
                _receive(one)
    finally:
        for one in holders:
            if one.socket is not None:
                one.socket.close()


def how_stopped(holders: list[Holder]) -> str:
    """Return how a stop was confirmed, as a phrase; "" if no holder confirmed it."""
    stopped = [one for one in holders if one.code == STOPPED]
    if not stopped:
        return ""
    one = min(stopped, key=lambda holder: holder.is_supervisor)
    by = "the recording's supervisor" if one.is_supervisor else "the process that holds the rig"
    kept = "" if one.is_supervisor else "; it stays held until it is released there"
    return f"emergency stop by {by}: the stage stood after {one.stood_ms:.1f} ms{kept}{failed_text(holders)}"


def failed_text(holders: list[Holder]) -> str:
    """Return which processes were reached and did not confirm the stop, as a phrase; "" for none."""
    failed = [one for one in holders if one.code in (SILENT, REFUSED)]
    return "".join(f"; process {one.pid} of {one.name}: {one.message or one.code}" for one in failed)


def _address_files(folder: str) -> list[str]:
    """Return the address files of a folder and of the workspaces in it."""
    folders = [folder]
    try:
        with os.scandir(os.path.join(folder, "workspaces")) as entries:
            folders += [entry.path for entry in entries]
    except OSError:
        pass  # no process of a workspace was ever started
    found = []
    for one in folders:
        try:
            names = os.listdir(one)
        except OSError:
            continue
        found += [os.path.join(one, name) for name in names if name.startswith("devices-")]
    return [path for path in found if path.endswith(".json")]


def _read(path: str) -> Holder | None:
    try:
        with open(path, "rb") as file:
            fields = decode(file.read(MAX_FILE_BYTES).decode())
        return Holder(str(fields["name"]), int(fields["port"]), str(fields["token"]), int(fields["pid"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _hurry() -> None:
    """Ask to be scheduled before others; most systems permit that to an administrator only."""
    try:  # noqa: SIM105 - contextlib is not loaded
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    except (AttributeError, OSError):
        pass


def _send(one: Holder) -> None:
    """Connect, and send token and stop in one piece."""
    lines = f'{{"token": "{one.token}", "id": 0}}\n{{"id": 1, "do": "estop"}}\n'  # a token is URL-safe
    try:
        one.socket = socket(AF_INET, SOCK_STREAM)
        one.socket.settimeout(CONNECT_S)
        one.socket.connect((HOST, one.port))
        one.socket.sendall(lines.encode())
        one.code = SILENT
    except TimeoutError:
        one.code = SILENT
    except (OSError, OverflowError):
        one.code = GONE


def _readable(waiting: list[Holder], left_s: float) -> list[Holder]:
    sockets = {one.socket.fileno(): one for one in waiting if one.socket is not None}
    ready, _, _ = select.select(list(sockets), [], [], left_s)
    return [sockets[number] for number in ready]


def _receive(one: Holder) -> None:
    """Take in what came; the answer to the stop, or the end of the connection, settles the code."""
    assert one.socket is not None
    try:
        data = one.socket.recv(1 << 16)
    except OSError:
        data = b""
    one.received += data
    *lines, one.received = one.received.split(b"\n")
    for line in lines:
        _take(one, line)
    if one.code == SILENT and (not data or len(one.received) > MAX_REPLY_BYTES):
        one.code = GONE


def _take(one: Holder, line: bytes) -> None:
    """Take one line; pushed statuses are passed over."""
    try:
        message = decode(line.decode())
        if message.get("ok") is False:
            one.code, one.message = REFUSED, str(message.get("error", ""))
        elif message.get("id") == 1:
            answer = message["result"]
            one.asked_ns, one.stood_ns = answer.get("asked_ns"), answer.get("stood_ns")
            one.code = ENDED if one.stood_ns is None else STOPPED
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        one.code = GONE  # it does not speak the protocol
