"""Client of a rendering process."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import replace

from palpate.core import Closing, PalpateError
from palpate.devices.operator_control import OperatorCommand
from palpate.devices.supervisor.process_link import GoneWords, ProcessLink
from palpate.softness.characteristics import SoftObject
from palpate.softness.control.rendering_loop import LoopSample
from palpate.softness.process.bench_file import BenchFile
from palpate.softness.process.rendering_messages import (
    RenderingStatus,
    law_of_row,
    loop_sample,
    object_messages,
    status_of,
)
from palpate.softness.rendering_law import Mode, RenderingLaw

PROCESS = ("-m", "palpate.softness.process.rendering_process")
TOLD = GoneWords(
    "the process that renders is gone: the devices' own watchdogs vent the chamber and drop the arm's force. "
    "Take the finger away",
    "the process that renders does not answer: it hangs, and the devices' own watchdogs vent the chamber and "
    "drop the arm's force. Take the finger away, and use the switch",
    "take the finger away: the process that renders has not let go of the devices",
)
ENDS_S = 2.0  # in which it says that it has ended
QUIET_S = 5.0  # in which the process tells something
KEPT = 6000  # samples, of a minute


class RenderingSession(Closing):
    """Renders an object on a bench until closed; `peak_n` and `frequency_hz` are of the virtual finger."""

    def __init__(
        self, bench: BenchFile, soft: SoftObject, mode: Mode, peak_n: float = 1.0, frequency_hz: float = 1.0
    ) -> None:
        self.told_s = time.monotonic()
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._samples: deque[LoopSample] = deque(maxlen=KEPT)
        self._status = RenderingStatus("opens", "", soft.name, mode, simulated=bench.simulated)
        first = {
            "name": bench.name, "bench": bench.model_dump(mode="json"), "mode": mode.value,
            "peak_N": peak_n, "frequency_Hz": frequency_hz, "object": list(object_messages(soft)),
        }  # fmt: skip
        self._link = ProcessLink(PROCESS, first, TOLD)
        self.law: RenderingLaw = law_of_row(self._link.facts, soft)
        self._hearing = threading.Thread(target=self._hear, name="palpate-rendering-hears", daemon=True)
        self._hearing.start()

    @property
    def pid(self) -> int:
        """Id of the process that renders."""
        return self._link.pid

    def status(self) -> RenderingStatus:
        """The newest that it told."""
        with self._lock:
            return self._status

    def taken(self) -> list[LoopSample]:
        """Periods since the last call, one of ten; of the last minute at most."""
        with self._lock:
            samples, self._samples = list(self._samples), deque(maxlen=KEPT)
        return samples

    def show(self, soft: SoftObject) -> None:
        """Turn into another object, in the same mode."""
        law = law_of_row(self._link.facts, soft)  # what cannot be is refused before anything is sent
        *pieces, last = object_messages(soft)
        for piece in pieces:
            self._link.tell(**piece)
        self._link.ask(**last)
        self.law = law

    def stop(self) -> RenderingStatus:
        """End the rendering, and say how it stood; the session tells that until it is closed."""
        self._link.tell("command", command=OperatorCommand.STOP)
        self._ended.wait(ENDS_S)
        return self.status()

    def estop(self) -> None:
        """Emergency stop: the chamber is vented and the arm brakes, past whatever goes on."""
        self._link.tell("command", command=OperatorCommand.ESTOP)

    def close(self) -> None:
        """End, and wait until the devices were let go."""
        self._link.close()
        self._hearing.join()

    def _hear(self) -> None:
        try:
            while True:
                event = self._link.next_event(QUIET_S)
                if "status" in event:
                    self._link.tell("heard")
                    self._take(status_of(event["status"]), list(map(loop_sample, event["samples"])))
        except PalpateError as e:
            now = self.status()
            if now.state != "ended":
                self._take(replace(now, state="ended", why=str(e)), [])

    def _take(self, status: RenderingStatus, samples: list[LoopSample]) -> None:
        self.told_s = time.monotonic()
        with self._lock:
            self._status = status
            self._samples.extend(samples)
        if status.state == "ended":
            self._ended.set()
