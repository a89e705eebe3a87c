"""Acquisition of frames: bursts at a stand, sweeps on the move, and the labels of every frame."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from palpate.core import NS_PER_S, DeviceError, Frame, FrameSource, Wrench
from palpate.devices import ForceBias, ForceReached, Guard, Reason, Tripped
from palpate.devices.device_proxies import driver_errors
from palpate.devices.force_bias import Force
from palpate.recordings.label_tables import Label
from palpate.recordings.manifest import LabelKind
from palpate.rig.label_force import LABEL_FORCE, LabelForce
from palpate.rig.plans.recording_plan import Burst, PlannedPress, Shot, Sweep
from palpate.rig.press_motion import PressMotion
from palpate.rig.rig import Rig
from palpate.rig.run_progress import SHOT, Recorder

LABELS: dict[str, LabelKind] = {
    "shot": "text",
    "frame_in_shot": "number",
    "approach": "number",
    "location": "text",
    "press": "text",
    "cycle": "number",
    "phase": "text",
    "indenter": "text",
    "reference": "flag",
    "x_mm": "number",
    "y_mm": "number",
    "depth_mm": "number",
    "force_N": "number",
    "force_x_N": "number",
    "force_y_N": "number",
    "force_magnitude_N": "number",
}
"""Labels of every frame. In each kind of plan `depth_mm` is the way below the local zero, where the normal
force passed the plan's threshold in this approach, a little below first touch; 0 above it. `force_N` is
along z, positive in compression, the mean over the exposure."""

KEPT_S = 2.0  # of force samples, to average over exposures
LOOKS = 64  # at the stage's position that are remembered, for frames taken on the way
NEAR_S = 0.05  # within which a sample stands for an exposure that has none of its own
FROZEN = 5  # frames in a row that are the same to the last bit
GRAB_S = 2.0
STARVED_S = 0.5  # without a frame, while one is filmed: at the slowest rates still a few frames

Mark = Callable[[str, int, bool], None]


class Acquisition:
    """Records bursts and sweeps of frames, each frame with its labels; keeps the force of the last seconds.

    Attributes:
        late_s: how far the frames' stamps run behind the force's [s].
    """

    def __init__(
        self,
        rig: Rig,
        guard: Guard,
        motion: PressMotion,
        recorder: Recorder,
        bias: ForceBias,
        mark: Mark,
    ) -> None:
        self._rig = rig
        self._guard = guard
        self._motion = motion
        self._recorder = recorder
        self._bias = bias
        self._mark = mark
        self._samples: deque[tuple[int, Force]] = deque()
        self.late_s = 0.0
        self._same = self._stamped_ns = 0
        self._last: np.ndarray | None = None
        second = rig.label_force
        self._label_force = second and LabelForce(second, rig.label_mounting, guard, rig.clock)
        guard.samples.subscribe(self._remember)
        self._heights: deque[tuple[int, float]] = deque(maxlen=LOOKS)
        guard.positions.subscribe(lambda at, time_ns: self._heights.append((time_ns, at[2])))

    def begin(self, press: PlannedPress) -> None:
        """Label the next frames with this press."""
        self._press = press

    def tare(self) -> None:
        """Zero the labelling force sensor, standing in the air, where there is one."""
        if self._label_force:
            self._label_force.tare()

    def burst(self, burst: Burst) -> None:
        """Record the frames of a shot that are missing, at a stand."""
        if self._label_force:
            self._label_force.settle()
        begun_ns = self._rig.clock.now_ns()
        for i, k in enumerate(burst.missing):
            due_s = i * burst.every_s - (self._rig.clock.now_ns() - begun_ns) / NS_PER_S
            if due_s > 0:
                self._guard.wait(due_s)
            time_ns, frame = self._grabbed()
            self._guard.look()
            self._record(burst.shot, k, time_ns, frame)
            self._mark(burst.shot.key, k, k == burst.missing[-1])
        self._recorder.event(SHOT, key=burst.shot.key, frames=len(burst.missing))

    def sweep(self, sweep: Sweep) -> None:
        """Record frames as they come on the way down to the force or the depth, and back up."""
        x, y, z = self._guard.position_m()
        counter = iter(range(1_000_000_000))
        last_ns = self._rig.clock.now_ns()

        def take_in() -> None:
            nonlocal last_ns
            for time_ns, frame in drained(self._rig.camera):
                self._record(sweep.shot, next(counter), time_ns, frame)
                last_ns = self._rig.clock.now_ns()
            if self._rig.clock.now_ns() - last_ns > STARVED_S * NS_PER_S:
                raise Tripped(
                    Reason.CAMERA, f"no frame came for {STARVED_S:g} s of a sweep; is the camera still there?"
                )

        drained(self._rig.camera)
        due = self._motion.contact_due(sweep.depth_m)
        with self._guard.looks.subscribed(take_in), due:
            until = sweep.until_n
            lowest = self._rig.origin_m[2] + sweep.depth_m
            reached = self._guard.towards(
                (x, y, lowest),
                sweep.speed_m_s,
                None if until is None else ForceReached(until),
                step_m=lowest - z,
            )
            self._guard.away((x, y, z), sweep.speed_m_s)
        if until is not None and not reached:
            raise Tripped(
                Reason.NO_CONTACT,
                f"{until:g} N was not reached down to {sweep.depth_m * 1e3:g} mm below the expected surface",
            )
        self._recorder.event(SHOT, key=sweep.shot.key, frames=next(counter), whole=True)
        self._mark(sweep.shot.key, 0, True)

    def _record(self, shot: Shot, k: int, time_ns: int, frame: Frame) -> None:
        self._check_alive(time_ns, frame)
        labels = self._labels(shot, k, time_ns, frame.exposure_s or 0.0)
        self._recorder.frame(frame, time_ns, labels)

    def _labels(self, shot: Shot, k: int, time_ns: int, exposure_s: float) -> dict[str, Label]:
        press, force = self._press, self._mean_force(time_ns, exposure_s)
        at = self._guard.position_m()
        x, y, _ = self._rig.from_origin_mm(at)
        contact = self._motion.contact_m
        height_m = self._height_m(time_ns, exposure_s) if shot.phase == "sweep" else at[2]
        depth = 0.0 if contact is None else max(1e3 * (height_m - contact), 0.0)
        labels: dict[str, Label] = {
            "shot": shot.key,
            "frame_in_shot": float(k),
            "approach": float(self._motion.approach),
            "location": press.place.name,
            "press": f"{shot.place}/{shot.cycle}",
            "cycle": float(shot.cycle),
            "phase": shot.phase,
            "indenter": press.indenter,
            "reference": shot.phase == "reference",
            "x_mm": round(x, 6),
            "y_mm": round(y, 6),
            "depth_mm": round(depth, 6),
            "force_N": force[2],
            "force_x_N": force[0],
            "force_y_N": force[1],
            "force_magnitude_N": math.hypot(*force),
        }
        if self._label_force and shot.phase != "sweep":
            labels[LABEL_FORCE] = self._label_force.force_n()
        return labels | dict(self._rig.truth(time_ns))

    def _height_m(self, time_ns: int, exposure_s: float) -> float:
        """Where a moving stage was in the middle of an exposure, along its z [m]."""
        middle_ns = time_ns - round((self.late_s + exposure_s / 2) * NS_PER_S)
        times_ns, heights_m = zip(*self._heights, strict=True)
        return float(np.interp(middle_ns, times_ns, heights_m))

    def _remember(self, samples: Sequence[Wrench]) -> None:
        for sample in samples:
            if not sample.fault:
                self._samples.append((sample.time_ns, self._bias.force(sample)))
        while self._samples and self._samples[0][0] < self._samples[-1][0] - KEPT_S * NS_PER_S:
            self._samples.popleft()

    def _mean_force(self, time_ns: int, exposure_s: float) -> Force:
        """Mean over the exposure, on the force's clock; the nearest sample where none fell into it."""
        time_ns -= round(self.late_s * NS_PER_S)
        begun_ns = time_ns - exposure_s * NS_PER_S
        during = [force for at, force in self._samples if begun_ns <= at <= time_ns]
        if during:
            fx, fy, fz = np.mean(during, axis=0).tolist()
            return fx, fy, fz
        if self._samples:
            at, force = min(self._samples, key=lambda one: abs(one[0] - time_ns))
            if abs(at - time_ns) <= NEAR_S * NS_PER_S:
                return force
        raise Tripped(
            Reason.FORCE_STALE,
            f"no force was measured within {NEAR_S * 1e3:g} ms of a frame; is it streaming?",
        )

    def _grabbed(self) -> tuple[int, Frame]:
        try:
            with driver_errors("its driver raised"):
                return self._rig.camera.grab(GRAB_S)
        except DeviceError as e:
            raise Tripped(Reason.CAMERA, f"the camera failed: {e}") from e

    def _check_alive(self, time_ns: int, frame: Frame) -> None:
        """A frame of the size that was promised, later than the last, and not the same again and again."""
        check_size(self._rig.camera, frame)
        if time_ns < self._stamped_ns:
            raise Tripped(
                Reason.CAMERA,
                f"a frame is stamped {(self._stamped_ns - time_ns) / NS_PER_S:.3f} s before the one that "
                "came before it: the camera's stamps run backwards",
            )
        self._stamped_ns = time_ns
        alike = self._last is not None and np.array_equal(self._last, frame.image)
        self._same = self._same + 1 if alike else 0
        self._last = frame.image
        if self._same >= FROZEN:
            raise Tripped(Reason.CAMERA, f"{FROZEN + 1} frames in a row are the same: the camera is frozen")


def drained(camera: FrameSource) -> list[tuple[int, Frame]]:
    """Frames that a camera took meanwhile."""
    try:
        with driver_errors("its driver raised"):
            return camera.drain()
    except DeviceError as e:
        raise Tripped(Reason.CAMERA, f"the camera failed: {e}") from e


def check_size(camera: FrameSource, frame: Frame) -> None:
    """Refuse a frame of another size than the camera promised."""
    width, height = camera.size_px
    if frame.image.shape[:2] != (height, width):
        raise Tripped(
            Reason.CAMERA,
            f"a frame of {frame.image.shape[1]} x {frame.image.shape[0]} px came from a camera of "
            f"{width} x {height} px",
        )
