"""Presses found in live frames and forces, each read as a whole once it ends: stiffness by touch.

A press begins where the force beside the camera rises above a threshold, and is over once it has stayed below
half of that for a moment. What is read is the loading, from just before the touch up to the greatest force,
as a recorded press is: its samples of force as a table, and of every frame the sample that it belongs to.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from palpate.calibration.compliance.compliance_calibration import ComplianceCalibration, reference_trial
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_cues import reading_record
from palpate.core import NS_PER_S, Closing, Frame, Image, PalpateError, Reading, Readings, Wrench
from palpate.core.shared_history import SharedHistory
from palpate.recordings.exchange.press_table import PressTable

THRESHOLD_N = 0.15
OVER_S = 0.15  # below half of the threshold, after which a press is over
BEFORE_S = 0.4  # of the untouched sensor, that belongs to a press
RESTING_S = 5.0  # of untouched samples, whose median is the force sensor's bias: a slow press is no drift
RESTING = 400  # of them at most, however fast they come
MIN_FRAMES = 8
MAX_FRAMES = 600  # of one press: twenty seconds at 30 frames a second
MAX_PRESSES = 4  # that wait to be read; later ones are passed over, and said so
LATE_S = 0.3  # by which frames and forces may come apart

TimedImages = list[tuple[int, Image]]
TimedForces = list[tuple[int, float]]
PressRead = Callable[[Sequence[Image], PressTable, str], Sequence[Reading]]


@dataclass(frozen=True, slots=True)
class LivePress:
    """Completed press.

    Attributes:
        number: Number of the press, from 1.
        readings: Stiffness first; empty where it could not be read.
        why, code: Reason and code of a press without readings; empty otherwise.
        took_s: Time from its end to its readings [s].
    """

    number: int
    readings: tuple[Reading, ...]
    why: str
    code: str
    frames: int
    force_n: float
    took_s: float

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "press": self.number,
            "readings": [reading_record(one) for one in self.readings],
            "why": self.why,
            "code": self.code,
            "frames": self.frames,
            "force_N": round(self.force_n, 4),
            "took_s": round(self.took_s, 3),
        }


def compliance_of(calibration: ComplianceCalibration) -> PressRead:
    """Function that reads a press by a calibration of compliance, as `palpate read` does."""

    def read(frames: Sequence[Image], table: PressTable, name: str) -> Sequence[Reading]:
        press = reference_trial(frames, table).press
        return read_touch(calibration, [press], name).readings

    return read


class PressReader(Closing):
    """Subscriber that cuts presses out of frames and forces, and reads each in a thread of its own.

    Frames and forces have to be on one clock, as those of a camera and of a force sensor on one machine are.
    """

    def __init__(
        self,
        read: PressRead,
        told: Callable[[LivePress], None] | None = None,
        *,
        threshold_n: float = THRESHOLD_N,
    ) -> None:
        """Wait for presses.

        Args:
            read: Reader of one press; see `compliance_of`.
            told: Callback for each press, in this subscriber's thread.
            threshold_n: Force above which there is contact [N].
        """
        self.presses = SharedHistory[LivePress](100)
        self._read, self._told, self._threshold_n = read, told, threshold_n
        self._lock = threading.Lock()
        self._frames: deque[tuple[int, Image]] = deque(maxlen=MAX_FRAMES)
        self._samples: deque[tuple[int, float]] = deque()
        self._resting: deque[tuple[int, float]] = deque()
        self._begun_ns: int | None = None
        self._below_ns: int | None = None
        self._number, self._waiting = 0, 0
        self._work: SimpleQueue[tuple[int, TimedImages, TimedForces] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._read_all, name="palpate-live-presses", daemon=True)
        self._thread.start()

    def on_frame(self, frame: Frame, readings: Readings | None) -> None:
        """Keep a frame of a press, or of the moment before one."""
        if frame.fault:
            return
        with self._lock:
            at_ns = round(frame.time_s * NS_PER_S)
            self._frames.append((at_ns, frame.image))
            since_ns = at_ns if self._begun_ns is None else self._begun_ns
            while self._frames[0][0] < since_ns - round((BEFORE_S + LATE_S) * NS_PER_S):
                self._frames.popleft()

    def on_force(self, samples: Sequence[Wrench]) -> None:
        """Follow the force."""
        for one in samples:
            if not one.fault:
                self._follow(one.time_ns, one.force_n[2])

    def wait(self, count: int, timeout_s: float) -> bool:
        """Wait until so many presses have been read; False where they were not in time."""
        end_s = time.monotonic() + timeout_s
        while self._number < count or self._waiting:
            if time.monotonic() > end_s:
                return False
            time.sleep(0.01)
        return True

    def close(self) -> None:
        """Read what waits, then end."""
        self._work.put(None)
        self._thread.join()

    def _follow(self, at_ns: int, raw_n: float) -> None:
        if self._begun_ns is None:
            bias_n = float(np.median([n for _, n in self._resting])) if self._resting else raw_n
            self._samples.append((at_ns, raw_n - bias_n))
            while self._samples[0][0] < at_ns - round(BEFORE_S * NS_PER_S):
                self._samples.popleft()
            if raw_n - bias_n > self._threshold_n:
                self._begun_ns, self._below_ns, self._bias_n = at_ns, None, bias_n
            else:
                self._rest(at_ns, raw_n)
            return
        force_n = raw_n - self._bias_n
        self._samples.append((at_ns, force_n))
        if force_n >= self._threshold_n / 2:
            self._below_ns = None
        elif self._below_ns is None:
            self._below_ns = at_ns
        elif at_ns - self._below_ns >= OVER_S * NS_PER_S:
            self._end_press()

    def _rest(self, at_ns: int, raw_n: float) -> None:
        """Keep a sample of the untouched sensor, unless one just before it is kept."""
        if self._resting and at_ns - self._resting[-1][0] < RESTING_S / RESTING * NS_PER_S:
            return
        self._resting.append((at_ns, raw_n))
        while self._resting[0][0] < at_ns - RESTING_S * NS_PER_S:
            self._resting.popleft()

    def _end_press(self) -> None:
        with self._lock:
            assert self._begun_ns is not None
            samples = list(self._samples)
            peak_ns = max(samples, key=lambda one: one[1])[0]
            loading = [one for one in samples if one[0] <= peak_ns]
            frames = [one for one in self._frames if loading[0][0] <= one[0] <= peak_ns]
            self._begun_ns = self._below_ns = None
            self._samples.clear()
        with self._lock:
            self._number += 1
            self._waiting += 1
        self._work.put((self._number, frames, loading))

    def _read_all(self) -> None:
        while True:
            try:
                item = self._work.get(timeout=1.0)
            except Empty:
                continue
            if item is None:
                return
            self._tell(self._one(*item))
            with self._lock:
                self._waiting -= 1

    def _one(self, number: int, frames: TimedImages, samples: TimedForces) -> LivePress:
        begun_s, force_n = time.monotonic(), samples[-1][1]
        readings: tuple[Reading, ...] = ()
        why = code = ""
        if self._waiting > MAX_PRESSES:
            code = "too-many-presses"
            why = f"{self._waiting} presses wait to be read; press more slowly"
        elif len(frames) < MIN_FRAMES:
            code = "too-few-frames"
            why = f"{len(frames)} frames while the force rose; at least {MIN_FRAMES}: press more slowly"
        else:
            try:
                table = press_table(frames, samples)
                readings = tuple(self._read([image for _, image in frames], table, f"press {number}"))
            except PalpateError as refusal:
                why, code = str(refusal), refusal.code
        return LivePress(number, readings, why, code, len(frames), force_n, time.monotonic() - begun_s)

    def _tell(self, press: LivePress) -> None:
        self.presses.append(press)
        if self._told is not None:
            self._told(press)


def press_table(frames: Iterable[tuple[int, Image]], samples: Sequence[tuple[int, float]]) -> PressTable:
    """Return the table of one press; each frame belongs to the sample nearest in time.

    Args:
        frames: Capture times [ns] and images.
        samples: Times [ns] and forces [N]; the first of equal times counts.
    """
    apart = [samples[0], *(b for a, b in pairwise(samples) if b[0] > a[0])]
    at_ns = np.array([at for at, _ in apart], np.int64)
    time_s = (at_ns - at_ns[0]) / NS_PER_S
    force_n = np.array([force for _, force in apart], np.float64)
    of_frame = [int(np.abs(at_ns - at).argmin()) for at, _ in frames]
    return PressTable(
        time_s=time_s,
        force_n=force_n,
        position_m=None,
        area_m2=None,
        frame_sample=np.array(of_frame, np.int64),
        force_column="force_N",
        position_column=None,
        area_column=None,
        turned=False,
    )
