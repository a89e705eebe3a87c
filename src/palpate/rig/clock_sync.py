"""Taps before the first press, which synchronize the clocks of frames and force.

Each device stamps its data on arrival; a few short presses that both detect give the difference of their
delays. Taps are repeated whenever a recording resumes. Their analysis runs in a thread, so that a stop never
waits for it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from dataclasses import asdict
from itertools import islice
from typing import TypeVar

import numpy as np

from palpate.core import NS_PER_S, Float, Frame, InputError, Int, RangeError, UInt8, Wrench, ndarray
from palpate.devices import ForceBias, ForceReached, Guard, OperatorCommand, Reason, Tripped
from palpate.devices.operator_control import AT_ONCE
from palpate.recordings import Offset, offset_between
from palpate.rig.acquisition import STARVED_S, check_size, drained
from palpate.rig.plans.recording_plan import RecordingPlan
from palpate.rig.rig import Rig
from palpate.rig.run_progress import Recorder

CLOCKS = "clocks"
MM = 1e-3
RESTS_S = (0.25, 0.4, 0.3, 0.55)  # between taps, in turn: uneven, so that no tap is taken for its neighbour
MAX_S = 0.4  # of the offset looked for, to either side
MAX_DEEP_MM = 1.0  # below the lowest place where contact may be found
MAX_PIXELS = 30_000  # of a frame that are compared, evenly over it: more changes nothing, and takes memory
MAX_ANALYSIS_S = 120.0  # of real time; it takes a second, and on a machine that is busy a hundred
LOOK_S = 0.02  # between two looks while it is waited for
ENDS = (*AT_ONCE, OperatorCommand.STOP)
"""What ends the wait for the analysis: no press is under way, after which a stop could wait to come."""

Pixels = UInt8[ndarray, " _"]
Signal = Float[ndarray, " _"]
Times = Int[ndarray, " _"]
Answer = TypeVar("Answer")


class ClockSync:
    """A few taps at the place where the probe hangs."""

    def __init__(
        self, rig: Rig, plan: RecordingPlan, guard: Guard, recorder: Recorder, bias: ForceBias
    ) -> None:
        self._rig = rig
        self._plan = plan
        self._guard = guard
        self._recorder = recorder
        self._bias = bias
        self._force: list[tuple[int, float]] = []
        self._frames: list[tuple[int, Pixels]] = []
        self._exposure_s = 0.0
        self._last_ns = 0

    def tap(self) -> Offset:
        """Tap, and say how far the frames run behind the force."""
        drained(self._rig.camera)
        self._last_ns = self._rig.clock.now_ns()
        with self._guard.samples.subscribed(self._feel), self._guard.looks.subscribed(self._look):
            self._guard.wait(2 * MAX_S)
            for rest_s in islice(RESTS_S * self._plan.taps, self._plan.taps):
                self._once()
                self._guard.wait(rest_s)
            self._guard.wait(2 * MAX_S)
        return self._offset()

    def _once(self) -> None:
        """Press until the force says so, and go back."""
        plan = self._plan
        x, y, z = self._guard.position_m()
        deepest_mm = plan.seek_mm + min(plan.deepest_mm, MAX_DEEP_MM)
        lowest = (x, y, self._rig.origin_m[2] + deepest_mm * MM)
        speed = plan.press_mm_s * MM
        if not self._guard.towards(lowest, speed, ForceReached(plan.tap_N)):
            raise Tripped(
                Reason.NO_CONTACT,
                f"a tap of {plan.tap_N:g} N was not felt down to {deepest_mm:g} mm below the "
                "expected surface; is the layer there, and the force sensor's sign right?",
            )
        self._guard.away((x, y, z), speed)

    def _feel(self, samples: Sequence[Wrench]) -> None:
        self._force += [(one.time_ns, self._bias.force(one)[2]) for one in samples if not one.fault]

    def _look(self) -> None:
        for time_ns, frame in drained(self._rig.camera):
            check_size(self._rig.camera, frame)
            self._exposure_s = frame.exposure_s or 0.0
            self._frames.append((time_ns, _thinned(frame)))
            self._last_ns = self._rig.clock.now_ns()
        if self._rig.clock.now_ns() - self._last_ns > STARVED_S * NS_PER_S:
            raise Tripped(Reason.CAMERA, f"no frame came for {STARVED_S:g} s; is the camera still there?")

    def _offset(self) -> Offset:
        if not self._frames:
            raise Tripped(Reason.CAMERA, "not a single frame came while the probe tapped")
        frame_ns = np.array([at for at, _ in self._frames])
        try:
            offset, change = awaited(lambda: self._analysed(frame_ns), self._watch, MAX_ANALYSIS_S)
        except (RangeError, InputError) as e:  # InputError: stamps that do not increase
            raise Tripped(
                Reason.CLOCKS,
                f"{self._plan.taps} taps do not tell the frames' clock from the force's: {e}; look at what "
                "the camera shows, or plan without (taps = 0)",
            ) from e
        except TimeoutError as e:
            raise Tripped(
                Reason.CLOCKS,
                f"the analysis of {self._plan.taps} taps took more than {MAX_ANALYSIS_S:g} s; end what else "
                "runs on this machine, or plan without (taps = 0)",
            ) from e
        ago_s = np.round((self._rig.clock.now_ns() - frame_ns) / NS_PER_S, 6)
        self._recorder.event(
            CLOCKS, **asdict(offset), frames_ago_s=ago_s.tolist(), change=np.round(change, 5).tolist()
        )
        return offset

    def _analysed(self, frame_ns: Times) -> tuple[Offset, Signal]:
        """The offset, and each frame's score. It reads what was collected, and touches no device."""
        force_ns, force = np.array([at for at, _ in self._force]), np.array([n for _, n in self._force])
        change = most_telling([pixels for _, pixels in self._frames])
        begun = min(int(force_ns[0]), int(frame_ns[0]))
        offset = offset_between(
            (force_ns - begun) / NS_PER_S,
            force,
            (frame_ns - begun) / NS_PER_S,
            change,
            exposure_s=self._exposure_s,
            most_s=MAX_S,
        )
        return offset, change

    def _watch(self) -> None:
        """One look while nothing moves and the analysis runs. No time passes here on a clock set by hand."""
        self._guard.look(asks=ENDS)
        drained(self._rig.camera)  # so that what comes next is no frame of before
        self._guard.looks.publish()


def awaited(work: Callable[[], Answer], look: Callable[[], None], most_s: float) -> Answer:
    """Result of a computation in a thread of its own, while the caller's thread goes on to look.

    A thread cannot be ended from outside: one that is left, by an exception of `look` or for its time, runs
    on to its end, and nobody hears of it.

    Args:
        work: what to compute; it moves nothing and asks no device.
        look: called every `LOOK_S` until the result is there; its exceptions end the wait.
        most_s: real time that it may take [s].

    Raises:
        TimeoutError: it took longer.
    """
    result: Future[Answer] = Future()

    def compute() -> None:
        try:
            result.set_result(work())
        except BaseException as e:
            result.set_exception(e)

    end_s = time.monotonic() + most_s
    threading.Thread(target=compute, name="palpate-tap-analysis", daemon=True).start()
    while not wait((result,), LOOK_S).done:
        look()
        if time.monotonic() > end_s:
            raise TimeoutError(f"no result within {most_s:g} s")
    return result.result()


def _thinned(frame: Frame) -> Pixels:
    height, width = frame.image.shape[:2]
    step = math.ceil(math.sqrt(height * width / MAX_PIXELS))
    return np.ascontiguousarray(frame.image[::step, ::step]).ravel()


def most_telling(images: Sequence[Pixels]) -> Signal:
    """Score of each frame along the first principal component of all.

    Of frames over their mean brightness, so that a lamp that flickers is no signal. All pixels tell together,
    which leaves far less noise than there is in a mean difference.
    """
    frames = np.stack(images).astype(np.float32)
    frames /= np.maximum(frames.mean(axis=1, keepdims=True), 1.0)
    frames -= frames.mean(axis=0)
    size, towards = np.linalg.eigh(frames @ frames.T)
    return np.asarray(towards[:, -1] * math.sqrt(max(float(size[-1]), 0.0)), dtype=float)
