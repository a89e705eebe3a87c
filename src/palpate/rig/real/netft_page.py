"""Fetch a Net F/T box's page within a time and a size, whatever answers at its address."""

from __future__ import annotations

import socket
from contextlib import closing, suppress
from http.client import HTTPConnection, HTTPException
from threading import Event, Timer

from palpate.core.errors import DeviceError
from palpate.rig.real.netft_calibration import MOST_PAGE_BYTES, PATH, Calibration, calibration


def fetch(host: str, port: int = 80, timeout_s: float = 2.0) -> Calibration:
    """What the box at an address says of itself.

    Args:
        host: its name or address.
        port: of its web server.
        timeout_s: for connecting, and again for the whole answer [s].

    Raises:
        DeviceError: nothing answers in time, or with an error.
        ProtocolError: what answers is not a Net F/T box.
    """
    page = f"http://{host}:{port}{PATH}"
    late = Event()
    try:
        with closing(HTTPConnection(host, port, timeout=timeout_s)) as connection:
            connection.connect()
            # A time-out of the socket begins anew with every byte; this one ends an answer that drips.
            timer = Timer(timeout_s, _cut, (connection.sock, late))
            timer.start()
            try:
                return calibration(_body(connection, page))
            finally:
                timer.cancel()
                timer.join()
    except (OSError, HTTPException, DeviceError) as error:
        if late.is_set():
            raise DeviceError(
                f"{page} did not answer whole within {timeout_s:g} s; is the network slow or the box busy?"
            ) from error
        if isinstance(error, DeviceError):
            raise
        raise DeviceError(
            f"{page} cannot be read ({error}); check the box's address, its power and the cable"
        ) from error


def _cut(connected: socket.socket, late: Event) -> None:
    late.set()
    with suppress(OSError):
        connected.shutdown(socket.SHUT_RDWR)


def _body(connection: HTTPConnection, page: str) -> bytes:
    connection.request("GET", PATH, headers={"Connection": "close"})
    with connection.getresponse() as answer:
        if answer.status != 200:
            raise DeviceError(f"{page} answers {answer.status} {answer.reason}; it has to be 200")
        body = answer.read(MOST_PAGE_BYTES + 1)
        if len(body) <= MOST_PAGE_BYTES and answer.length:  # a bounded read does not complain of an early end
            raise DeviceError(f"{page} ended {answer.length} bytes early; read it again")
        return body
