"""Stand-ins for what a live loop is made of: a source under a test's hand, and a reader that counts."""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np

from palpate.core import DeviceError, Drift, Frame, Readings
from palpate.core.reading import Reading
from palpate.sensing.live_sources import NoFrameYetError


def numbered(number: int, *, time_s: float | None = None, level: int | None = None) -> Frame:
    """A frame that shows its number."""
    image = np.full((4, 6), number % 251 if level is None else level, np.uint8)
    at_s = number / 10 if time_s is None else time_s
    return Frame(image, at_s, name=str(number), index=number, arrived_ns=time.monotonic_ns())


class HandedFrames:
    """A source that gives what a test puts into it.

    Attributes:
        gone: says why the device is gone; None while it is there.
        closed: how often it was closed.
    """

    def __init__(self, *, waits: bool, name: str = "handed", force=None) -> None:
        self.name, self.waits, self.force = name, waits, force
        self.gone: str | None = None
        self.closed = 0
        self._line: deque[Frame | None] = deque()
        self._changed = threading.Condition()

    def give(self, *frames: Frame | None) -> None:
        with self._changed:
            self._line.extend(frames)
            self._changed.notify_all()

    def grab(self, timeout_s: float) -> Frame | None:
        with self._changed:
            self._changed.wait_for(lambda: self._line or self.gone, timeout_s)
            if self.gone:
                raise DeviceError(self.gone)
            if not self._line:
                raise NoFrameYetError("nothing yet")
            return self._line.popleft()

    def close(self) -> None:
        self.closed += 1


class MeanReader:
    """Reads the mean grey level, after a while; its zero is taken off."""

    id = "mean"

    def __init__(self, takes_s: float = 0.0, *, differential: bool = False) -> None:
        self.takes_s, self.differential = takes_s, differential
        self.zeros: list[np.ndarray] = []
        self.read_numbers: list[int] = []
        self.drifts: Drift | None = None
        self.kind, self.valid = "", True
        self.started, self.may_end = threading.Event(), threading.Event()
        self.may_end.set()

    def read(self, frame: Frame) -> Readings:
        self.started.set()
        self.may_end.wait(30.0)
        time.sleep(self.takes_s)
        self.read_numbers.append(frame.index)
        off = float(self.zeros[-1].mean()) if self.zeros else 0.0
        value = float(frame.image.mean()) - off
        return Readings({"force_N": reading(value, frame, self.valid)})

    def zero(self, untouched: np.ndarray) -> Drift | None:
        self.zeros.append(untouched)
        return self.drifts

    def drift_of(self, image: np.ndarray) -> Drift | None:
        return self.drifts

    def kind_of(self, image: np.ndarray) -> str:
        return self.kind


def reading(value: float, frame: Frame, valid: bool = True) -> Reading:
    """A reading of force."""
    return Reading(
        quantity="force",
        unit="N",
        coverage=0.9,
        valid=valid,
        why="" if valid else "unlike",
        drift=None,
        calibration="mean",
        frame=frame.name,
        time_s=frame.time_s,
        value=value,
        low=value - 1,
        high=value + 1,
        calibrated_range=(0.0, 250.0),
    )


def until(holds, within_s: float = 5.0) -> None:
    """Wait until something holds."""
    end_s = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end_s, "it did not come about in time"
        time.sleep(0.005)
