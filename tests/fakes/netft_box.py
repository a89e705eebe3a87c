"""A Net F/T box that is not there: real UDP and HTTP sockets on this computer, and every fault on demand.

Written from the protocol, not from the driver: it packs its own bytes and shares no code with it.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler
from socketserver import ThreadingTCPServer
from threading import Event, Thread
from typing import NamedTuple

from palpate.core import Closing, InputError

Triple = tuple[float, float, float]
STOP, START, BIAS = 0x0000, 0x0002, 0x0042
_BEHIND_S = 0.2  # a computer busy for longer makes the fake skip time, not send in a burst


@dataclass(frozen=True, slots=True)
class FakePage:
    """Page of the box about itself. `newtons` and `newton_metres` are what one of its units is, in SI."""

    product: str = "Net F/T that is not there"
    serial: str = "FT00000"
    counts_per_force: float = 1_000_000
    counts_per_torque: float = 1_000_000
    force_unit: str = "N"
    newtons: float = 1.0
    torque_unit: str = "Nm"
    newton_metres: float = 1.0
    rate_hz: float = 500.0
    ranges: str = "330;330;990;30;30;30"
    bias: str = "0;0;0;0;0;0"

    def xml(self) -> bytes:
        """The page, in the order of a real box's."""
        fields = {
            "runstat": "0x00000000",
            "runrate": 7000,
            "cfgcalsn": self.serial,
            "scfgfu": self.force_unit,
            "scfgtu": self.torque_unit,
            "cfgcpf": f"{self.counts_per_force:g}",
            "cfgcpt": f"{self.counts_per_torque:g}",
            "cfgmr": self.ranges,
            "setbias": self.bias,
            "comrdtrate": f"{self.rate_hz:g}",
            "prodname": self.product,
        }
        body = "\n".join(f"<{name}>{value}</{name}>" for name, value in fields.items())
        return f'<?xml version="1.0"?><netft>\n{body}\n</netft>\n'.encode()


class ReceivedRequest(NamedTuple):
    """Request that came over UDP; header, command and records are -1 where it was not eight bytes."""

    header: int
    command: int
    records: int
    source: tuple[str, int]


class FakeNetFT(Closing):
    """A box that streams a force. Change its attributes while it runs to make it fail.

    Attributes:
        force, torque: functions of the seconds since it was made, in N and Nm.
        page: what it says of itself; assign another to change its calibration.
        requests: all that was asked over UDP, oldest first.
        pages_read: how often its page was asked for.
        sent: how many datagrams it has sent.
        status: of every record from now on.
        counts: sent in place of the force; None for the force.
        ft_step: measurements from one record to the next; 0 is a measurement that stands still.
        rdt_sequence, ft_sequence: of the last record.
        first_sequence: what the RDT sequence begins with at each start.
        sent_hz: records a second that it sends; None for those that its page states.
        hold_s: for so long it keeps records, and sends all at once, as a busy switch does; 0 for never [s].
        silent: sends nothing, as without power or with the stream gone elsewhere.
        lost_starts, lost_stops: so many of the next requests go unheard.
        http_status, http_body: in place of 200 and of the page.
        http_drip_s: pause after each byte of the page [s].
        http_missing: how many more bytes the page claims to have than come.

    Example:
        >>> with FakeNetFT(force=lambda t: (0.0, 0.0, -1.0)) as box:
        ...     box.host, box.was_biased
        ('127.0.0.1', False)
    """

    def __init__(
        self,
        force: Callable[[float], Triple] = lambda t: (0.0, 0.0, 0.0),
        torque: Callable[[float], Triple] = lambda t: (0.0, 0.0, 0.0),
        page: FakePage | None = None,
    ) -> None:
        self.force, self.torque, self.page = force, torque, page or FakePage()
        self.requests: list[ReceivedRequest] = []
        self.pages_read = self.sent = 0
        self.status = self.rdt_sequence = self.ft_sequence = 0
        self.counts: tuple[int, ...] | None = None
        self.ft_step = self.first_sequence = 1
        self.silent = False
        self.sent_hz: float | None = None
        self.hold_s = 0.0
        self._kept: list[bytes] = []
        self._kept_since = 0.0
        self.lost_starts = self.lost_stops = 0
        self.http_status, self.http_body, self.http_drip_s, self.http_missing = 200, b"", 0.0, 0
        self.host = "127.0.0.1"
        self._client: tuple[str, int] | None = None
        self._instead: deque[tuple[bytes, ...] | int] = deque()
        self._delayed: bytes | None = None
        self._left = 0
        self._closing = Event()
        self._began = self._due = time.monotonic()
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind((self.host, 0))
        self._http = _Web((self.host, 0), _handler(self))
        self.rdt_port = int(self._udp.getsockname()[1])
        self.http_port = int(self._http.server_address[1])
        self._threads = [
            Thread(target=self._serve, name="fake Net F/T", daemon=True),
            Thread(target=self._http.serve_forever, args=(0.02,), name="fake Net F/T page", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def was_biased(self) -> bool:
        """Whether anybody ever asked it to take the present load as zero."""
        return any(request.command == BIAS for request in self.requests)

    @property
    def streams_to(self) -> tuple[str, int] | None:
        """Whom its records go to; None where it was not started, or was stopped."""
        return self._client

    def lose(self, n: int = 1) -> None:
        """Count the next n records, and send none of them."""
        self._instead.extend([0] * n)

    def repeat(self, n: int = 1) -> None:
        """Send each of the next n records twice."""
        self._instead.extend([2] * n)

    def swap(self) -> None:
        """Send the next two records in the wrong order."""
        self._instead.extend([-1, 1])

    def send_instead(self, *datagrams: bytes) -> None:
        """Send these in place of the next record, whose numbers are not used up."""
        self._instead.append(datagrams)

    def close(self) -> None:
        """Let go of both ports. Closing again does nothing."""
        if not self._closing.is_set():
            self._closing.set()
            self._http.shutdown()
            for thread in self._threads:
                thread.join()
            self._http.server_close()
            self._udp.close()

    def record(self) -> bytes:
        """The next record: counts its sequences on and packs it."""
        self.rdt_sequence = (self.rdt_sequence + 1) % 2**32
        self.ft_sequence = (self.ft_sequence + self.ft_step) % 2**32
        counts = self._measured() if self.counts is None else self.counts
        return struct.pack(">III6i", self.rdt_sequence, self.ft_sequence, self.status, *counts)

    def _measured(self) -> tuple[int, ...]:
        t, page = time.monotonic() - self._began, self.page
        force = [f / page.newtons * page.counts_per_force for f in self.force(t)]
        torque = [m / page.newton_metres * page.counts_per_torque for m in self.torque(t)]
        if not all(map(math.isfinite, [*force, *torque])):
            raise InputError(f"the fake's force or torque at {t} s is not finite; give finite N and Nm")
        return tuple(max(-(2**31), min(round(c), 2**31 - 1)) for c in [*force, *torque])

    def _serve(self) -> None:
        while not self._closing.is_set():
            now = time.monotonic()
            wait_s = min(max(self._due - now, 0.0), 0.02) if self._client else 0.02
            self._udp.settimeout(wait_s)
            with suppress(TimeoutError, BlockingIOError, ConnectionError):
                self._take(*self._udp.recvfrom(64))
            if self._client and time.monotonic() >= self._due:
                self._due = max(
                    self._due + 1 / (self.sent_hz or self.page.rate_hz), time.monotonic() - _BEHIND_S
                )
                if not self.silent:
                    self._send()

    def _take(self, data: bytes, source: tuple[str, int]) -> None:
        header, command, records = struct.unpack(">HHI", data) if len(data) == 8 else (-1, -1, -1)
        request = ReceivedRequest(header, command, records, source)
        self.requests.append(request)
        if request.header != 0x1234:
            return
        if request.command == START:
            if self.lost_starts > 0:
                self.lost_starts -= 1
                return
            self._client, self._left, self._due = source, request.records, time.monotonic()
            self.rdt_sequence = (self.first_sequence - 1) % 2**32
        elif request.command == STOP:
            if self.lost_stops > 0:
                self.lost_stops -= 1
                return
            self._client = None

    def _send(self) -> None:
        what = self._instead.popleft() if self._instead else 1
        if isinstance(what, tuple):
            self._put(*what)
        elif what < 0:
            self._delayed = self.record()
        else:
            self._put(*[self.record()] * what)
            if self._delayed is not None:
                self._put(self._delayed)
                self._delayed = None

    def _put(self, *datagrams: bytes) -> None:
        if self.hold_s:
            self._kept_since = self._kept_since if self._kept else time.monotonic()
            self._kept.extend(datagrams)
            if time.monotonic() - self._kept_since < self.hold_s:
                return
        datagrams = (*self._kept, *(() if self.hold_s else datagrams))
        self._kept.clear()
        for datagram in datagrams:
            if self._client is None:
                return
            with suppress(ConnectionError):  # the client has gone; a real box does not notice
                self._udp.sendto(datagram, self._client)
            self.sent += 1
            if self._left == 1:
                self._client = None
            self._left = max(self._left - 1, 0)


class _Web(ThreadingTCPServer):
    allow_reuse_address = True


def _handler(box: FakeNetFT) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = 5.0  # for a client that connects and then says nothing [s]

        def do_GET(self) -> None:
            box.pages_read += 1
            body = box.http_body or box.page.xml()
            status = box.http_status if self.path == "/netftapi2.xml" else 404
            with suppress(ConnectionError):
                self.send_response(status)
                self.send_header("Content-Type", "text/xml")
                if box.http_missing:
                    self.send_header("Content-Length", str(len(body) + box.http_missing))
                self.end_headers()
                self._write(body)

        def _write(self, body: bytes) -> None:
            step = 1 if box.http_drip_s else len(body)
            for at in range(0, len(body), step):
                self.wfile.write(body[at : at + step])
                if box.http_drip_s and box._closing.wait(box.http_drip_s):
                    return

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    return Handler
