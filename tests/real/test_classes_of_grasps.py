"""Touched or not, and which object, of fifteen real grasps: a stand-in, as no data of our sensors is public.

All fifteen grasps show the gel untouched and touched, so that sets of both can be promised at 90 %. Three
grasps show each object, which promise nothing.
"""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest

from palpate.calibration import CalibrationPlan, calibrate
from palpate.core import ManualClock
from palpate.estimators import read_card
from palpate.recordings import Manifest, Run, RunWriter

UNTOUCHED_N, TOUCHED_N = 0.3, 2.0  # below the one, above the other; frames between are left out
SIZE_PX = (320, 240)


@pytest.fixture(scope="module")
def cards(real_data, tmp_path_factory):
    source = real_data / "grasp-modulus"
    if not source.is_dir():
        pytest.skip(f"no grasps at {source}")
    folder = tmp_path_factory.mktemp("grasps")
    run = _recorded(source, folder / "run")
    plan = CalibrationPlan((), split="leave-one-out:press", classes={"touched": (), "object": ()})
    return {card.column: card for card in read_card(calibrate(run, plan, folder / "cal")).classes}


def _recorded(source, path) -> Run:
    about = Manifest.new(sensor="gel", labels={"press": "text", "object": "text", "touched": "flag"})
    clock = ManualClock()
    with RunWriter.create(path, about, clock=clock, overflow="wait") as writer:
        for table in sorted(source.glob("*_[123].csv")):
            force = pd.read_csv(table)["force_N"].to_numpy()
            untouched, touched = np.flatnonzero(force < UNTOUCHED_N), np.flatnonzero(force > TOUCHED_N)
            chosen = {*_spread(untouched, 6).tolist(), *_spread(touched, 12).tolist()}
            video = cv2.VideoCapture(str(table.with_suffix(".avi")))
            for row in range(len(force)):
                _, image = video.read()
                if row in chosen:
                    clock.sleep(0.03)
                    small = cv2.resize(image, SIZE_PX, interpolation=cv2.INTER_AREA)
                    labels = {"press": table.stem, "object": table.stem[:-2]}
                    touch = bool(force[row] > TOUCHED_N)
                    writer.frame(cv2.cvtColor(small, cv2.COLOR_BGR2RGB), labels=labels | {"touched": touch})
    return Run.open(path)


def _spread(rows: np.ndarray, most: int) -> np.ndarray:
    return rows[np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(int)]


@pytest.mark.slow
def test_touch_is_told_of_grasps_held_out_and_both_classes_are_held(cards) -> None:
    score = cards["touched"].score
    assert score.accuracy_low > 0.9 > score.baseline + 0.2
    assert [part.groups for part in score.coverage] == [15, 15]
    assert all(part.covered / part.rows > 0.87 for part in score.coverage)
    assert score.whole < 0.05
    assert cards["touched"].findings == ()


@pytest.mark.slow
def test_three_grasps_of_an_object_promise_nothing_however_often_it_is_right(cards) -> None:
    card = cards["object"]
    assert card.score.accuracy_low > 0.7 > card.score.baseline
    assert card.thresholds == (None,) * 5
    assert card.score.set_size == 5
    assert card.findings
