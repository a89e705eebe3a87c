"""Messages between a supervisor and its client: one JSON object a line, over two pipes of their own.

The client writes orders, ``{"id": 7, "do": "towards", ...}``; the supervisor writes a reply with the same id,
and on the way ``{"look": n, "samples": [...], "positions": [...]}``, each of which the client answers with
``{"do": "heard", "look": n}`` once it has dealt with it. Lines of the client are shorter than a pipe takes in
one piece, so that any of its threads, and a signal's handler, may write without a lock.
"""

from __future__ import annotations

import math
import os
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from palpate.core import DeviceError, PalpateError, ProtocolError, Wrench, errors
from palpate.devices.motion_limits import Reason, Tripped
from palpate.devices.operator_control import OperatorCommand, OperatorInterrupt
from palpate.devices.rpc import Lines, decode_message, encode_message

WHOLE_BYTES = 4096  # that a pipe takes in one piece (POSIX asks for 512, Linux and macOS take these)
LINE_BYTES = 16 * 1024 * 1024
CHUNK = 1 << 16

Row = list[Any]


def sample_row(sample: Wrench) -> Row:
    """A force sample as plain values: time [ns], three forces [N], three torques [Nm], its fault.

    What is no number, as a faulty sample may hold, is None.
    """
    values = (*sample.force_n, *sample.torque_nm)
    return [sample.time_ns, *(value if math.isfinite(value) else None for value in values), sample.fault]


def sample_of(row: Row) -> Wrench:
    """A force sample from its plain values."""
    time_ns, *values, fault = row
    fx, fy, fz, tx, ty, tz = (math.nan if value is None else float(value) for value in values)
    return Wrench(int(time_ns), (fx, fy, fz), (tx, ty, tz), str(fault))


def error_fields(error: BaseException) -> dict[str, Any]:
    """An error as plain values."""
    if isinstance(error, OperatorInterrupt):
        return {"kind": "OperatorInterrupt", "error": error.command.value}
    if isinstance(error, Tripped):
        return {
            "kind": "Tripped",
            "error": str(error),
            "reason": error.reason.value,
            "numbers": error.numbers,
        }
    known = (one.__name__ for one in type(error).__mro__ if hasattr(errors, one.__name__))
    code = error.code if isinstance(error, PalpateError) else ""
    return {"kind": next(known, type(error).__name__), "error": str(error), "code": code}


def error_of(fields: Mapping[str, Any]) -> Exception:
    """The error that plain values tell of, or a `DeviceError` that names it."""
    kind, text = str(fields.get("kind")), str(fields.get("error"))
    if kind == "OperatorInterrupt":
        return OperatorInterrupt(OperatorCommand(text))
    if kind == "Tripped":
        return Tripped(Reason(str(fields.get("reason"))), text, fields.get("numbers"))
    family = getattr(errors, kind, None)
    if isinstance(family, type) and issubclass(family, PalpateError):
        return family(text, code=str(fields.get("code") or ""))
    return DeviceError(f"the supervisor failed: {kind}: {text}")


def write_line(to: int, message: Mapping[str, Any]) -> None:
    """Write a short message in one piece, from any thread.

    Raises:
        ProtocolError: it is longer than a pipe takes in one piece.
        OSError: nobody reads any more.
    """
    line = encode_message(message)
    if len(line) > WHOLE_BYTES:
        raise ProtocolError(f"an order of {len(line)} bytes; {WHOLE_BYTES} are allowed")
    os.write(to, line)


def read_messages(source: int) -> Iterator[dict[str, Any]]:
    """Messages as they come, until whoever writes them is gone.

    Raises:
        ProtocolError: what comes is no message.
    """
    lines = Lines(LINE_BYTES)
    while True:
        try:
            data = os.read(source, CHUNK)
        except OSError:
            return
        if not data:
            return
        for line in lines.feed(data):
            if line is None:
                raise ProtocolError(f"a line longer than {LINE_BYTES} bytes")
            yield decode_message(line)


class PipeWriter:
    """Writes from a thread of its own, so that a reader that is slow or stopped holds nobody up."""

    def __init__(self, to: int) -> None:
        self._to = to
        self._changed = threading.Condition()
        self._lines: deque[bytes] = deque()
        self._closed = False
        self._thread = threading.Thread(target=self._write, name="palpate-supervisor-writer", daemon=True)
        self._thread.start()

    def send(self, message: Mapping[str, Any]) -> None:
        """Send it after what was sent before."""
        line = encode_message(message)
        with self._changed:
            self._lines.append(line)
            self._changed.notify()

    def close(self, within_s: float) -> None:
        """Send what waits, as far as somebody reads it in time."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(within_s)

    def _write(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._lines)
                if not self._lines:
                    return
                data = b"".join(self._lines)
                self._lines.clear()
            try:
                while data:
                    data = data[os.write(self._to, data) :]
            except OSError:
                return  # nobody reads any more; the reader of the other pipe sees that too


def three(values: Sequence[Any]) -> tuple[float, float, float]:
    """Three numbers of a message."""
    x, y, z = (float(value) for value in values)
    return x, y, z
