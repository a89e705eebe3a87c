"""Laws of what presses by hand are worth: later presses of the same hand are read, and intervals hold."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.calibration.evaluation import evaluate
from palpate.estimators.certified import Estimator
from palpate.recordings import Run
from palpate.sensing.collection import PressCollector
from palpate.workflows.press_feeds import VirtualFeed
from palpate.workflows.start_session import StartSession

HELD_OUT = 12


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_forty_presses_read_later_presses_of_the_same_hand(tmp_path: Path, seed: int) -> None:
    session = StartSession(tmp_path / "session")
    session.choose("virtual:tactip", "virtual", seed=seed)
    feed = session.feed()
    assert isinstance(feed, VirtualFeed)
    session.check_settings(feed)
    session.take_untouched(feed)
    session.collect(feed)
    later = PressCollector(
        tmp_path / "later", feed.sensor, feed.weighing, frame_late_s=feed.frame_late_s, clock=feed.clock
    )
    feed.press(go_on=True)
    with later:
        while len(later.presses) < HELD_OUT:
            frame = feed.grab()
            assert feed.force is not None
            later.on_force(feed.force.drain())
            later.on_frame(frame)
    feed.close()
    session.train(curve=False)
    found = evaluate(Estimator.open(session.calibration), Run.open(tmp_path / "later"))["targets"]["force_N"]
    assert found["r2"] > 0.8
    assert found["coverage_90"] > 0.7  # of 12 presses, 90 % hold within 0.71 to 1 in 95 of 100 draws
