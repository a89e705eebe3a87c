"""A slow force sensor labels frames at a stand beside a fast one that guards, and never guards itself."""

from dataclasses import replace
from pathlib import Path

import pytest
from tests.refusals import refused
from tests.rig.rigs import near, quick

from palpate.core import DeviceError, Wrench
from palpate.devices import Mounting, Reason, Tripped
from palpate.recordings import Run
from palpate.rig import State, record
from palpate.rig.label_force import LABEL_FORCE
from palpate.rig.rig_check import check_rig

pytestmark = pytest.mark.usefixtures("coarse_looks")
SMALL = quick(frames=2)
PRELOAD_N = 3.0  # of the specimen on the scale, which the tare takes off


class SlowScale:
    """The force that a virtual rig knows, ten times a second, upside down and late by its delay."""

    rate_hz, range_n = 10.0, (100.0, 100.0, 100.0)

    def __init__(self, of, delay_s: float = 0.4) -> None:
        self.rig, self.delay_s, self.gone_after_s = of, delay_s, float("inf")
        self.begun_ns = self.next_ns = of.clock.now_ns()
        self.closed = 0

    def latest(self) -> Wrench:
        return self._sample(self.rig.clock.now_ns())

    def drain(self) -> list[Wrench]:
        now_ns = self.rig.clock.now_ns()
        if now_ns > self.begun_ns + self.gone_after_s * 1e9:
            raise DeviceError("unplugged")
        samples = []
        while self.next_ns <= now_ns:
            samples.append(self._sample(self.next_ns))
            self.next_ns += 100_000_000
        return samples

    def _sample(self, arrives_ns: int) -> Wrench:
        at_ns = arrives_ns - round(self.delay_s * 1e9)
        force = self.rig.truth(at_ns)["true_force_N"]
        return Wrench(at_ns, (0.0, 0.0, -(force + PRELOAD_N)))

    def close(self) -> None:
        self.closed += 1


def with_scale(**kwargs):
    fast = near()
    scale = SlowScale(fast, **kwargs)
    return replace(fast, label_force=scale, label_mounting=Mounting(("x", "y", "-z"))), scale


def test_frames_at_a_stand_carry_what_the_scale_measured_since_it_began(tmp_path: Path) -> None:
    bench, scale = with_scale()
    outcome = record(bench, SMALL, tmp_path / "run")
    assert outcome.state is State.DONE, outcome.message
    labels = Run.open(tmp_path / "run").labels
    assert labels["true_force_N"].max() > 0.2  # there is something to weigh
    assert (labels[LABEL_FORCE] - labels["true_force_N"]).abs().max() < 1e-6
    bench.close()
    assert scale.closed == 1


def test_without_its_delay_taken_off_the_labels_would_be_wrong(tmp_path: Path) -> None:
    """Negative control: the same scale that keeps its delay for itself."""
    bench, scale = with_scale()
    honest = scale._sample
    scale._sample = lambda arrives_ns: replace(honest(arrives_ns), time_ns=arrives_ns)
    assert record(bench, SMALL, tmp_path / "run").state is State.DONE
    labels = Run.open(tmp_path / "run").labels
    assert (labels[LABEL_FORCE] - labels["true_force_N"]).abs().max() > 0.05


def test_a_scale_that_goes_ends_the_run_by_name_with_the_probe_lifted(tmp_path: Path) -> None:
    bench, scale = with_scale()
    scale.gone_after_s = 5.0
    outcome = record(bench, SMALL, tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_SENSOR)
    assert "failed: unplugged" in outcome.message
    assert bench.stage.position_m()[2] < bench.origin_m[2]


def test_a_scale_that_prints_too_seldom_ends_the_run_by_name(tmp_path: Path) -> None:
    bench, scale = with_scale(delay_s=0.1)
    scale.drain = list
    outcome = record(bench, SMALL, tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_STALE)
    assert "measured 0" in outcome.message


def test_a_slow_sensor_is_refused_as_the_guard_before_anything_is_written(tmp_path: Path) -> None:
    bench, scale = with_scale()
    alone = replace(bench, force=scale, label_force=None)
    with refused("force-stale", Tripped):
        record(alone, SMALL, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_the_check_moves_nothing_by_a_slow_sensor_and_takes_it_as_a_label() -> None:
    bench, scale = with_scale()
    found = {one.code: one for one in check_rig(bench, close=False)}
    assert found["rig.force-rate"].ok
    assert found["label-force.sample-rate"].ok
    assert found["label-force.sample-gap"].ok
    alone = {one.code: one for one in check_rig(replace(bench, force=scale, label_force=None), close=False)}
    assert not alone["rig.force-rate"].ok
    assert not alone["stage.was-moved"].ok
