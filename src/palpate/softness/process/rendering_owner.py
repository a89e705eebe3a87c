"""Owner of a display and an arm that renders an object for one client.

One thread runs the loop, one reads the client, one reports and supervises. The rendering ends, vented and
braking, when the client is gone or silent for `SILENT_S`, on request, on a fault, or when no period ends for
`HANGS_S`. The devices' own watchdogs cover a process that hangs longer.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

from palpate.core import Clock, PalpateError, ProtocolError
from palpate.devices.device_proxies import ArmProxy, DisplayProxy
from palpate.devices.operator_control import OperatorCommand, OperatorControl, OperatorInterrupt
from palpate.devices.supervisor.guard_messages import error_fields
from palpate.devices.supervisor.owning_process import Send
from palpate.softness.characteristics import SoftObject
from palpate.softness.control.bench_watch import BenchLimits
from palpate.softness.control.rendering_loop import LoopSample, RenderingLoop
from palpate.softness.control.servos import ReferenceTable
from palpate.softness.control.timed_loop import MAX_S, Pace, run_paced
from palpate.softness.process.bench_file import OpenedBench
from palpate.softness.process.rendering_session import (
    ObjectPieces,
    RenderingStatus,
    law_of_row,
    law_row,
    loop_row,
    status_row,
)
from palpate.softness.rendering_law import RenderingLaw

TELL_S = 0.05
EVERY = 10  # periods, of which one is told
KEPT = 1000  # samples that wait for a client
SILENT_S = 2.0
HANGS_S = 0.2
ENDED_S = 0.5


class RenderingOwner:
    """Renders for a client (a `DeviceOwner`); the caller closes `bench`, and `send` never blocks."""

    def __init__(
        self, bench: OpenedBench, law: RenderingLaw, limits: BenchLimits, clock: Clock, send: Send
    ) -> None:
        self._display = None if bench.display is None else DisplayProxy(bench.display, clock)
        self._arm, self._clock, self._send = ArmProxy(bench.arm, clock), clock, send
        self._law, self._simulated = law, bench.simulated
        self._control = OperatorControl()
        self._loop = RenderingLoop(
            self._display, self._arm, ReferenceTable(law), clock, limits, control=self._control,
            damping_n_s_m=bench.damping_n_s_m,
        )  # fmt: skip
        self._pace, self._samples = Pace(), deque[LoopSample](maxlen=KEPT)
        self._pieces = ObjectPieces()
        self._gone, self._over = threading.Event(), threading.Event()
        self._heard_s, self._silent = time.monotonic(), False
        self._why, self._wished = "", False

    def read(self, messages: Iterator[Mapping[str, Any]]) -> None:
        """Take in what the client writes, until it is gone."""
        try:
            for message in messages:
                self._heard_s = time.monotonic()
                self._take(message)
        finally:
            self.leave()

    def serve(self) -> None:
        """Render until it ends, and wait then for the client to leave."""
        teller = threading.Thread(target=self._tell, name="palpate-rendering-teller", daemon=True)
        teller.start()
        try:
            self._render()
        finally:
            self._over.set()
            teller.join(1.0)
            self._send({"status": status_row(self._status()), "samples": self._taken()})
        while not self._gone.wait(ENDED_S):
            if time.monotonic() - self._heard_s > SILENT_S:
                return

    def leave(self) -> None:
        """The client is gone, or the process has to end."""
        self._gone.set()

    def stop(self) -> dict[str, int]:
        """Emergency stop: the chamber is vented and the arm brakes at once, past whatever goes on."""
        asked_ns = self._clock.now_ns()
        self._control.ask(OperatorCommand.ESTOP)
        stood_ns = asked_ns
        for held in (self._display, self._arm):
            if held is not None:
                with suppress(PalpateError):  # the loop ends all the same, and says what could not be told
                    stood_ns = max(stood_ns, held.hold())
        return {"asked_ns": asked_ns, "stood_ns": stood_ns}

    def status(self) -> dict[str, Any]:
        """State: what it does, whether an emergency stop holds it, and why it ended."""
        now = self._status()
        return {"state": now.state, "held": self._arm.held, "message": now.why, "shots": 0}

    def _render(self) -> None:
        for device in (self._display, self._arm):
            if device is not None:
                device.release()
        try:
            run_paced(self._tick, MAX_S, self._pace.heard, lambda: not self._gone.is_set())
            self._why = "whoever rendered is gone" if self._gone.is_set() else "a day has passed"
        except OperatorInterrupt:
            self._why, self._wished = self._loop.safe, not self._silent
            if self._silent:
                self._why = f"whoever rendered has said nothing for {SILENT_S:g} s"
        except PalpateError:
            self._why = self._loop.safe
        except Exception as e:  # of the loop itself: a person's finger is on it, and they are told
            self._why = self._loop.safe or f"{type(e).__name__}: {e}"
        finally:
            if not self._loop.safe:
                self._loop.make_safe(self._why)

    def _tick(self) -> None:
        sample = self._loop.tick()
        if self._pace.periods % EVERY == 0:
            self._samples.append(sample)

    def _tell(self) -> None:
        """Tell the client how it goes, and end what nobody attends to."""
        while not self._over.wait(TELL_S):
            self._send({"status": status_row(self._status()), "samples": self._taken()})
            if time.monotonic() - self._heard_s > SILENT_S:
                self._silent = True
                self._control.ask(OperatorCommand.STOP)
            stands_s = time.perf_counter() - self._pace.latest_s
            if stands_s > HANGS_S and not self._loop.safe:
                self._loop.make_safe(f"no period has ended for {stands_s * 1e3:.0f} ms; a device hangs")

    def _taken(self) -> list[list[Any]]:
        rows = []
        while self._samples:
            rows.append(loop_row(self._samples.popleft()))
        return rows

    def _status(self) -> RenderingStatus:
        over, pace = self._over.is_set() or bool(self._loop.safe), self._pace
        why = self._why or self._loop.safe
        return RenderingStatus(
            "ended" if over else "renders", why if over else "", self._law.object.name, self._law.mode,
            pace.periods, pace.late_share, pace.longest_s, self._simulated, self._wished,
        )  # fmt: skip

    def _take(self, message: Mapping[str, Any]) -> None:
        match message.get("do"):
            case "heard":
                pass  # that it says something is all there is to know
            case "alive":
                self._send({"alive": True})
            case "command":
                self._obey(OperatorCommand(message["command"]))
            case "piece":
                self._pieces.take(message)
            case "object":
                self._answer(message, lambda: self._show(self._pieces.whole(message)))
            case other:
                self._answer(message, lambda: _unknown(other))

    def _obey(self, command: OperatorCommand) -> None:
        if command is OperatorCommand.ESTOP:
            self.stop()
        else:
            self._control.ask(command)

    def _show(self, soft: SoftObject) -> None:
        law = law_of_row(law_row(self._law), soft)
        self._loop.show(ReferenceTable(law))
        self._law = law

    def _answer(self, message: Mapping[str, Any], work: Any) -> None:
        try:
            work()
            answer: dict[str, Any] = {"ok": True, "result": None}
        except Exception as e:
            answer = {"ok": False, **error_fields(e)}
        self._send({"id": message.get("id"), **answer})


def _unknown(do: object) -> None:
    raise ProtocolError(f"there is nothing called {str(do)[:50]!r} to do")
