"""Process that owns a rig's stage and force sensor: ``python -m palpate.rig.supervisor_process``.

It speaks over its standard input and output with whoever started it, and may be stopped by anybody else of
the same user, at an address of its own.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from _thread import interrupt_main
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from itertools import chain
from types import FrameType
from typing import Any, BinaryIO

from palpate.core import DeviceError, ForceSensor, MonotonicClock, ProtocolError, Stage
from palpate.core.plugins import ERROR, plugin_calls
from palpate.devices import Mounting
from palpate.devices.rpc import Address, hold, publish, supervisor_name
from palpate.devices.rpc_server import RpcServer
from palpate.devices.supervisor.guard_messages import PipeWriter, error_fields, read_messages
from palpate.devices.supervisor.guard_supervisor import GuardSupervisor
from palpate.rig.rig_file.opened_rig import RigFile, open_guarded

SWITCH_S = 0.001  # between threads, so that a stop does not wait for what others compute
LET_GO_S = 8.0  # in which a supervisor before this one has lifted the probe and is gone
AGAIN_S = 0.1
SAID_S = 5.0
NICENESS = -10
GIVEN_UP = (
    "the devices were let go before all of them were open: a stop was asked for, or whoever records left"
)


def main() -> int:
    """Open the devices, guard them until the client is gone, lift the probe where it has to be, and end."""
    to = os.dup(1)
    os.dup2(2, 1)  # whatever a driver prints must not be taken for a message
    sys.setswitchinterval(SWITCH_S)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the client has it too, and says what is wished
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _give_up)
    _ask_for_priority()
    writer = PipeWriter(to)
    try:
        with ExitStack() as opened:
            _serve(writer, opened)
    except (Exception, KeyboardInterrupt) as e:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a client that hears this goes, and that is no fault
        told = DeviceError(GIVEN_UP) if isinstance(e, KeyboardInterrupt) else e
        writer.send({"opened": False, "ok": False, **error_fields(told)})
        writer.close(SAID_S)
        return 2
    writer.close(SAID_S)
    return 0


def _serve(writer: PipeWriter, opened: ExitStack) -> None:
    messages = read_messages(0)
    first = next(messages, None)
    if first is None:
        raise ProtocolError("nobody said which rig to open")
    file = RigFile.model_validate(first["rig"])
    name = supervisor_name(str(first["name"]))
    reader = _Reader(messages)
    opened.enter_context(_held(name))
    clock = MonotonicClock()
    stops = _Stops(clock)
    server = _server(name, stops)  # before anything is opened: homing is a motion too
    opened.callback(server.close)
    path = publish(Address(name, server.port, server.token, os.getpid()))
    opened.callback(path.unlink, missing_ok=True)
    with plugin_calls(f"a device did not open ({ERROR})", Exception):
        stage, force = open_guarded(file, clock, opened)
    assert file.limits is not None
    assert file.force is not None
    limits, mounting = file.limits.limits(), Mounting(file.force.axes)
    supervisor = GuardSupervisor(stage, force, limits, mounting, clock, writer.send)
    stops.supervisor = supervisor
    signal.signal(signal.SIGTERM, lambda *_: supervisor.leave())
    reader.pass_on_to(supervisor)
    writer.send({"opened": True, "ok": True, "result": _facts(stage, force)})
    supervisor.serve()


def _ask_for_priority() -> None:
    """Ask to be woken before others; most systems allow that to an administrator alone."""
    if hasattr(os, "setpriority"):
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, NICENESS)


def _give_up(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not cut short how the first is obeyed
    raise KeyboardInterrupt  # which nothing that opens, lifts or homes takes for a device's failure


def _abandon_opening() -> None:
    """End what the main thread does, from another one; also where it sleeps."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
    else:
        interrupt_main(signal.SIGTERM)


class _Reader:
    """Reads from the start on: a client that goes while devices are opened, or homed, is not waited for."""

    def __init__(self, messages: Iterator[Mapping[str, Any]]) -> None:
        self._messages = messages
        self._to: GuardSupervisor | None = None
        threading.Thread(target=self._read, name="palpate-orders", daemon=True).start()

    def pass_on_to(self, supervisor: GuardSupervisor) -> None:
        """From now on there is somebody to take orders."""
        self._to = supervisor

    def _read(self) -> None:
        first = next(self._messages, None)  # it orders nothing before it is told that all is open
        if self._to is not None:
            self._to.read(chain([first] if first else [], self._messages))
        else:
            _abandon_opening()


class _Stops:
    """Stops for anybody of the same user, from the first motion on: homing is one."""

    def __init__(self, clock: MonotonicClock) -> None:
        self._clock = clock
        self.supervisor: GuardSupervisor | None = None

    def status(self) -> dict[str, Any]:
        one = self.supervisor
        if one is None:
            return {"state": "opens", "held": False, "message": "", "shots": 0}
        return {"state": one.state, "held": one.held, "message": one.lifted, "shots": 0}

    def stop(self) -> dict[str, int]:
        """Stop the stage; while it is being opened, end that, which closes it: no `stood_ns` then."""
        if self.supervisor is not None:
            return self.supervisor.stop()
        _abandon_opening()
        return {"asked_ns": self._clock.now_ns()}


def _held(name: str) -> BinaryIO:
    """The right to supervise the rig; a supervisor whose client has just died may still be lifting."""
    end_s = time.monotonic() + LET_GO_S
    while True:
        try:
            return hold(name)
        except DeviceError:
            if time.monotonic() > end_s:
                raise
            time.sleep(AGAIN_S)


def _server(name: str, stops: _Stops) -> RpcServer:
    """Anybody of the same user may stop the stage, past the client."""
    asked = {"estop": lambda _: stops.stop(), "status": lambda _: stops.status()}
    return RpcServer(name, stops.status, lambda after: None, asked, {})


def _facts(stage: Stage, force: ForceSensor) -> dict[str, Any]:
    travel = stage.travel
    stops = (travel.top_speed_m_s, travel.acceleration_m_s2, travel.latency_s)
    return {
        "travel": [travel.least_m, travel.greatest_m, *stops],
        "rate_hz": force.rate_hz,
        "delay_s": getattr(force, "delay_s", 0.0),
        "range_n": force.range_n,
    }


if __name__ == "__main__":
    sys.exit(main())
