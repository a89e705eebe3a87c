"""Frame of a process that owns devices, for one client and safe without it.

It speaks over its standard input and output with whoever started it, and may be stopped by anybody else of
the same user, at an address of its own, from before its devices are open: homing is a motion too.

Real-time scheduling of a process that guards a motion, where the system permits it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from _thread import interrupt_main
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from itertools import chain
from types import FrameType, SimpleNamespace
from typing import Any, BinaryIO, Protocol

from palpate.core import DeviceError, MonotonicClock, PalpateError, ProtocolError
from palpate.core.failure_log import record_failure, report_to_stderr, thread_failures
from palpate.core.plugins import ERROR, plugin_calls
from palpate.devices.rpc import Address, hold, publish, supervisor_name
from palpate.devices.rpc_server import RpcServer
from palpate.devices.supervisor.guard_messages import PipeWriter, error_fields, read_messages

REALTIME_PRIORITY = 10  # of 1 to 99; the kernel's own threads for devices have 50
NICENESS = -10
FIFO, NICE, NORMAL = "fifo", "nice", "normal"
REMEDY = (
    "allow it with '{user} - rtprio 20' in /etc/security/limits.d/palpate.conf and log in again, or run "
    "the process with the capability CAP_SYS_NICE"
)
Facts = dict[str, str]


def request_priority(system: Any = os, user: Callable[[], str] | None = None) -> Facts:
    """Request SCHED_FIFO for this process, or else a higher priority, and return what was granted.

    To be called before other threads are started: they inherit the policy of the thread that starts them.

    Args:
        system: module with the system's calls, such as `os`.
        user: returns the name of the user, for the remedy; that of the process where left out.

    Returns:
        ``scheduling``: "fifo", "nice" or "normal"; and ``remedy``: what to do where it is not "fifo",
        empty where the system has no such scheduling.
    """
    if not hasattr(system, "sched_setscheduler"):
        return {"scheduling": raise_priority(system), "remedy": ""}
    try:
        system.sched_setscheduler(0, system.SCHED_FIFO, system.sched_param(REALTIME_PRIORITY))
    except OSError:
        return {"scheduling": raise_priority(system), "remedy": REMEDY.format(user=(user or _user)())}
    return {"scheduling": FIFO, "remedy": ""}


def probe_realtime(system: Any = os, user: Callable[[], str] | None = None) -> Facts:
    """Return what `request_priority` would be granted, without a change of this process.

    The request is made in a thread of its own, whose policy ends with it.
    """
    found: Facts = {}
    calls = ("sched_setscheduler", "SCHED_FIFO", "sched_param")  # niceness may be of the whole process
    bare = SimpleNamespace(**{name: getattr(system, name) for name in calls if hasattr(system, name)})
    thread = threading.Thread(target=lambda: found.update(request_priority(bare, user)), daemon=True)
    thread.start()
    thread.join()
    return found


def raise_priority(system: Any = os) -> str:
    """Request a higher priority, not real-time scheduling, and return "nice" if granted, or else "normal"."""
    if hasattr(system, "setpriority"):
        with suppress(OSError):
            system.setpriority(system.PRIO_PROCESS, 0, NICENESS)
            return NICE
    return NORMAL


def _user() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a user without a name, as in a container
        return f"#{os.getuid()}" if hasattr(os, "getuid") else "*"


SWITCH_S = 0.001  # between threads, so that a stop does not wait for what others compute
LET_GO_S = 8.0  # in which the process before this one has made its devices safe and is gone
AGAIN_S = 0.1
SAID_S = 5.0
GIVEN_UP = (
    "the devices were let go before all of them were open: a stop was asked for, or whoever opened them left"
)

Send = Callable[[Mapping[str, Any]], None]


class DeviceOwner(Protocol):
    """What owns the devices, once they are open."""

    def read(self, messages: Iterator[Mapping[str, Any]]) -> None:
        """Take in what the client writes, until it is gone; run in a thread of its own."""

    def serve(self) -> None:
        """Do what is asked, until the client is gone; the devices are safe then."""

    def leave(self) -> None:
        """End `serve`; from any thread, and from a signal's handler."""

    def stop(self) -> dict[str, int]:
        """Emergency stop, from any thread; when it was asked for, and when all stood [ns]."""

    def status(self) -> dict[str, Any]:
        """State as plain values: what it does, whether it is held, and why."""


Opens = Callable[[Mapping[str, Any], MonotonicClock, Send, ExitStack], tuple[DeviceOwner, dict[str, Any]]]
"""Opens the devices that the first message names: their owner, and facts for the client."""


def run_owner(opens: Opens) -> int:
    """Open the devices, serve until the client is gone, and end; the process's exit status.

    Args:
        opens: given the first message, the clock, what sends to the client, and a stack that closes devices.
    """
    to = os.dup(1)
    os.dup2(2, 1)  # whatever a driver prints must not be taken for a message
    sys.setswitchinterval(SWITCH_S)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the client has it too, and says what is wished
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _give_up)
    priority = request_priority()  # before any thread is started
    writer = PipeWriter(to)
    try:
        with thread_failures(), ExitStack() as opened:
            _serve(opens, writer, opened, priority)
    except (Exception, KeyboardInterrupt) as e:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a client that hears this goes, and that is no fault
        told = DeviceError(GIVEN_UP) if isinstance(e, KeyboardInterrupt) else e
        if not isinstance(told, PalpateError):
            report_to_stderr(record_failure(told, "the process that owns the devices"))
        writer.send({"opened": False, "ok": False, **error_fields(told)})
        writer.close(SAID_S)
        return 2
    writer.close(SAID_S)
    return 0


def _serve(opens: Opens, writer: PipeWriter, opened: ExitStack, priority: Facts) -> None:
    messages = read_messages(0)
    first = next(messages, None)
    if first is None:
        raise ProtocolError("nobody said which devices to open")
    name = supervisor_name(str(first["name"]))
    reader = _Reader(messages)
    opened.enter_context(_held(name))
    clock = MonotonicClock()
    stops = _Stops(clock)
    server = _server(name, stops)
    opened.callback(server.close)
    path = publish(Address(name, server.port, server.token, os.getpid()))
    opened.callback(path.unlink, missing_ok=True)
    with plugin_calls(f"a device did not open ({ERROR})", Exception):
        owner, facts = opens(first, clock, writer.send, opened)
    stops.owner = owner
    signal.signal(signal.SIGTERM, lambda *_: owner.leave())
    reader.pass_on_to(owner)
    writer.send({"opened": True, "ok": True, "result": facts | priority})
    owner.serve()


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
        self._to: DeviceOwner | None = None
        threading.Thread(target=self._read, name="palpate-orders", daemon=True).start()

    def pass_on_to(self, owner: DeviceOwner) -> None:
        """From now on there is somebody to take orders."""
        self._to = owner

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
        self.owner: DeviceOwner | None = None

    def status(self) -> dict[str, Any]:
        one = self.owner
        if one is None:
            return {"state": "opens", "held": False, "message": "", "shots": 0}
        return one.status()

    def stop(self) -> dict[str, int]:
        """Stop the devices; while they are being opened, end that, which closes them: no `stood_ns` then."""
        if self.owner is not None:
            return self.owner.stop()
        _abandon_opening()
        return {"asked_ns": self._clock.now_ns()}


def _held(name: str) -> BinaryIO:
    """The right to own the devices; an owner whose client has just died may still be making them safe."""
    end_s = time.monotonic() + LET_GO_S
    while True:
        try:
            return hold(name)
        except DeviceError:
            if time.monotonic() > end_s:
                raise
            time.sleep(AGAIN_S)


def _server(name: str, stops: _Stops) -> RpcServer:
    """Anybody of the same user may stop the devices, past the client."""
    asked = {"estop": lambda _: stops.stop(), "status": lambda _: stops.status()}
    return RpcServer(name, stops.status, lambda after: None, asked, {})
