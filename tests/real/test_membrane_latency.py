"""Latency between frames and force of a real press that was recorded a row a frame: a stand-in, not a TacTip.

The membrane has no pins: motion is the first component of optical flow from the first frame, on a grid. Frame
and force are read in one loop, so that none should be later than the other by more than a frame.
"""

import numpy as np
import pytest

from palpate.estimators.compliance.press_latency import pin_course, press_latency
from palpate.estimators.flow.horn_schunck import dis
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_table import read_press_table

STILL = 10  # frames before the press that set force to zero
GRID_PX = 16


@pytest.mark.slow
def test_frames_and_force_of_one_loop_are_less_than_a_frame_apart(real_data) -> None:
    folder = real_data / "membrane-press"
    if not folder.is_dir():
        pytest.skip(f"no press of a membrane at {folder}")
    with open_sequence(folder / "press.tif") as pages:
        frames = list(pages)
    axes = [
        read_press_table(folder / "force.csv", len(frames), force_column=name)
        for name in ("Fx_N", "Fy_N", "Fz_N")
    ]
    force = np.stack([axis.force_n for axis in axes])
    force = np.linalg.norm(force - force[:, :STILL].mean(axis=1, keepdims=True), axis=0)
    still, time = frames[0], axes[0].time_s
    flows = [np.stack(dis(still, frame))[:, ::GRID_PX, ::GRID_PX].reshape(2, -1).T for frame in frames]
    motion = pin_course(np.asarray(flows, np.float64))
    found = press_latency(time, force, axes[0].frame_sample, motion)
    assert found.low_s < 0 < found.high_s
    assert abs(found.seconds) < np.median(np.diff(time))
