"""Small virtual rigs and plans that the tests share."""

from typing import Any

import numpy as np

from palpate.core.clock import NS_PER_S, ManualClock
from palpate.recordings.run_reader import Run
from palpate.rig.plans import Listed, StepHold
from palpate.rig.rig import Rig
from palpate.rig.virtual import Fault, Variation, virtual_rig
from palpate.rig.virtual.linear_rig import standing
from palpate.sensors import palm
from palpate.sensors.palm.palm_sensor import Palm

SPEC = palm.cropped(palm.palm(), 16, "tiny")
CLOCK_NS = 100 * NS_PER_S
CLEARANCE_MM = 0.4
IDEAL = Variation(
    seating_m=0.0, place_m=0.0, tilt_rad=(0.0, 0.0), lean=(0.0, 0.0), lean_spread=(0.0, 0.0), lamp=0.0,
    shift_px=0.0, backlash_m=0.0, force_noise_n=1e-4, force_drift_n=0.0, force_step_n=0.0,
    frame_jitter_s=0.0, relaxation=(),
)  # fmt: skip
"""Nothing varies: for tests of everything else."""


def rig(*faults: Fault, **kwargs: Any) -> Rig:
    """A rig of tiny frames on which nothing varies; faults count from its start."""
    settings = {"sensor": Palm(SPEC), "clock": ManualClock(CLOCK_NS), "variation": IDEAL, "faults": faults}
    return virtual_rig(**{**settings, **kwargs})


def near(*faults: Fault, **kwargs: Any) -> Rig:
    """The same with the probe 1 mm above the skin, so that the first approach is short."""
    made = rig(*faults, **kwargs)
    world = made.stage._world
    start = (0.0, 0.0, -1e-3)
    world._motions[-1] = standing(start, world.now_s)
    world._played = np.array(start)
    return made


def quick(**kwargs: Any) -> StepHold:
    """The small plan with one cycle, two places 2 mm apart, and one frame a shot: 8 shots, fast moves."""
    settings: dict[str, Any] = {
        "places": Listed(kind="listed", at_mm=((0.0, 0.0), (2.0, -1.0))),
        "cycles": 1,
        "frames": 1,
        "seek_mm_s": 5.0,
        "press_mm_s": 5.0,
    }
    return plan(**{**settings, **kwargs})


def plan(**kwargs: Any) -> StepHold:
    """Two places, two cycles, three depths, two frames: 16 shots with the references."""
    settings: dict[str, Any] = {
        "name": "small", "places": Listed(kind="listed", at_mm=((0.0, 0.0), (6.0, -4.0))), "cycles": 2,
        "depth_mm": 1.2, "step_mm": 0.4, "frames": 2, "reference_frames": 1, "clearance_mm": CLEARANCE_MM,
        "travel_mm_s": 50.0, "taps": 0,
    }  # fmt: skip
    return StepHold(**{**settings, **kwargs})


def keys(run: Run) -> list[tuple[str, int]]:
    """Shot and frame of every labelled frame, in the order of the run."""
    labels = run.labels.dropna(subset=["shot"])
    return list(zip(labels["shot"], labels["frame_in_shot"].astype(int), strict=True))


def wanted(of: StepHold) -> set[tuple[str, int]]:
    return {(s.key, k) for press in of.presses() for s, n in of.shots(press) for k in range(n)}
