"""A force whose zero moves while it presses: found by the zero after the press, taken back, recorded anew."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rig.altered_force import ChangedForce
from tests.rig.rigs import keys, near, quick, wanted

from palpate.core import NS_PER_S, Wrench
from palpate.devices import ForceBias, Reason
from palpate.recordings import Run, check
from palpate.rig import State, done_in, record
from palpate.rig.engine import DISBELIEVED
from palpate.rig.plans import Listed
from palpate.rig.rig import Rig
from palpate.rig.run_progress import fields_of
from palpate.rig.virtual import Variation
from palpate.rig.zero_drift import slope_n_s

pytestmark = pytest.mark.usefixtures("coarse_looks")


SMALL = quick(places=Listed(kind="listed", at_mm=((0.0, 0.0),)), cycles=2, press_mm_s=2.0)


def varied() -> Rig:
    return near(variation=Variation(), seed=5)


def drifting(begun_s: float, ended_s: float, slope_n_s: float = 1.0) -> Rig:
    """A rig whose normal zero moves between two times, at so many newtons a second."""
    one = varied()

    def shifted(sample: Wrench) -> Wrench:
        x, y, z = sample.force_n
        seconds = max(min(sample.time_ns / NS_PER_S, ended_s) - begun_s, 0.0)
        return replace(sample, force_n=(x, y, z + slope_n_s * seconds))

    return replace(one, force=ChangedForce(one.force, shifted))


def span_of_last_press(path: Path) -> tuple[float, float]:
    """When the last press of the small plan goes down, and when it is over, on a sound rig [s]."""
    sound = varied()
    assert record(sound, SMALL, path).state is State.DONE
    run = Run.open(path)
    assert len(fields_of(run, "zero-moved")) == 2, "every press ends with a zero, the last included"
    down = run.times_s[run.labels.index[run.labels["phase"] == "down"][-1]]
    begun_s = (sound.clock.now_ns() - run.end_ns + run.manifest.created_ns) / NS_PER_S
    return begun_s + float(down) - 0.3, begun_s + float(down) + 0.1


@pytest.mark.parametrize(
    "goes_on",
    [False, pytest.param(True, marks=pytest.mark.slow)],
    ids=["ends before the zero", "goes on in the air"],
)
def test_a_press_whose_zero_moved_is_named_taken_back_and_recorded_anew(tmp_path, goes_on):
    begun_s, ended_s = span_of_last_press(tmp_path / "sound")
    out = tmp_path / "run"
    outcome = record(drifting(begun_s, ended_s + (60.0 if goes_on else 0.0)), SMALL, out)
    assert outcome.state is State.FAILED
    assert outcome.reason in ({Reason.FORCE_DRIFT} if not goes_on else DISBELIEVED)
    assert (outcome.shots, outcome.void_shots) == (4, 4)
    assert check(out).void_frames == 4
    assert sorted({key for key, _ in keys(Run.open(out))}) == sorted(done_in(Run.open(out)))
    assert record(varied(), SMALL, out).state is State.DONE
    run = Run.open(out)
    assert sorted(keys(run)) == sorted(wanted(SMALL))
    assert (run.labels["force_N"] - run.labels["true_force_N"]).abs().max() < 0.05


@pytest.mark.slow
def test_a_small_movement_of_the_zero_is_told_as_a_figure(tmp_path: Path) -> None:
    begun_s, ended_s = span_of_last_press(tmp_path / "sound")
    out = tmp_path / "run"
    outcome = record(drifting(begun_s, ended_s, 0.1), SMALL, out)
    assert outcome.state is State.DONE
    assert outcome.zero_moved_n == pytest.approx(0.04, abs=0.01)
    assert check(out).zero_moved_N == outcome.zero_moved_n


def air(slope: float, noise_n: float, seed: int = 0) -> list[Wrench]:
    noise = noise_n * np.random.default_rng(seed).standard_normal(300)
    return [Wrench(i * 1_000_000, (0.0, 0.0, 1e-3 * slope * i + float(e))) for i, e in enumerate(noise)]


@pytest.mark.parametrize("slope", [1.0, -1.0, 0.4])
def test_a_force_that_still_drifts_in_the_air_has_its_slope(slope: float) -> None:
    assert slope_n_s(air(slope, 0.005), ForceBias(noise_n=0.005)) == pytest.approx(slope, abs=0.02)


@pytest.mark.parametrize("noise_n", [0.005, 0.05])
def test_noise_is_no_drift(noise_n: float) -> None:
    before = ForceBias(noise_n=0.005)
    assert all(slope_n_s(air(0.0, noise_n, seed), before) == 0.0 for seed in range(50))
