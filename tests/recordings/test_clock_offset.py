"""The clock offset between force and frames is recovered from taps, and its interval covers the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import binom
from tests.refusals import refused

from palpate.core import InputError, ManualClock, RangeError
from palpate.recordings.clock_offset import Offset, offset_between

FORCE_HZ, FRAME_HZ = 200.0, 30.0
EXPOSURE_S = 0.02


@dataclass
class Tapped:
    """Taps at 2 mm/s to 1 mm under a sphere, the skin at rest between; frames stamped late by `offset_s`."""

    offset_s: float
    seed: int = 0
    taps: int = 5
    noise_n: float = 0.005
    blur: float = 0.02  # of the frames' signal, which rises to about 5
    jitter_s: float = 1e-3
    exponent: float = 0.7  # of the law from force to signal

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.starts = 1.0 + np.cumsum(self.rng.uniform(1.3, 1.8, self.taps))
        end = self.starts[-1] + 2.5
        self.force_t = np.arange(0, end, 1 / FORCE_HZ)
        self.force = self.true_n(self.force_t) + self.noise_n * self.rng.standard_normal(len(self.force_t))
        ends = np.arange(0.2, end - 0.2, 1 / FRAME_HZ) + self.rng.uniform(0, 0.03)
        self.change = self.signal(ends) + self.blur * self.rng.standard_normal(len(ends))
        self.frame_t = ends + self.offset_s + self.jitter_s * self.rng.standard_normal(len(ends))

    def true_n(self, time_s: np.ndarray) -> np.ndarray:
        since = np.abs(time_s[:, None] - self.starts - 0.575)  # from the middle of each tap
        depth = np.clip((0.575 - since) / 0.5, 0, 1).max(axis=1)
        return 2.0 * depth**1.5

    def signal(self, ends: np.ndarray) -> np.ndarray:
        """Of the mean force over the exposure, by 50 instants of it."""
        inside = (np.arange(50) + 0.5) / 50 * EXPOSURE_S
        mean = np.mean([self.true_n(ends - before) for before in inside], axis=0)
        return 3.0 * mean**self.exponent

    def found(self) -> Offset:
        return offset_between(self.force_t, self.force, self.frame_t, self.change, exposure_s=EXPOSURE_S)


@pytest.mark.parametrize("offset_s", [-0.3, 0.0123])
def test_a_known_offset_is_recovered_within_a_millisecond(offset_s: float) -> None:
    assert Tapped(offset_s).found().seconds == pytest.approx(offset_s, abs=1e-3)


@pytest.mark.parametrize("exponent", [0.5, 2.0])
def test_the_law_from_force_to_signal_need_not_be_known(exponent: float) -> None:
    assert Tapped(0.05, exponent=exponent).found().seconds == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize("count", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_the_interval_covers_the_truth_as_often_as_it_says(count: int) -> None:
    offsets = np.random.default_rng(1).uniform(-0.1, 0.1, count)
    found = [Tapped(float(offset), seed).found() for seed, offset in enumerate(offsets)]
    covered = sum(one.low_s <= offset <= one.high_s for one, offset in zip(found, offsets, strict=True))
    assert covered >= binom.ppf(0.01, count, 0.95)
    width = np.mean([one.high_s - one.low_s for one in found])
    error = np.std([one.seconds - offset for one, offset in zip(found, offsets, strict=True)])
    assert 3.0 < width / error < 6.5, "as wide as it has to be, and not much wider: 3.9 if all is normal"


@pytest.mark.slow
def test_the_interval_narrows_with_the_taps() -> None:
    def width(taps: int) -> float:
        found = [Tapped(0.02, seed, taps).found() for seed in range(4)]
        return float(np.mean([one.high_s - one.low_s for one in found]))

    # As one over the root of their number.
    assert width(16) / width(4) == pytest.approx(0.5, rel=0.25)


@pytest.mark.parametrize("jitter_s", [pytest.param(3e-3, marks=pytest.mark.slow), 5e-3])
def test_the_jitter_of_stamps_is_told_once_noise_is_small(jitter_s: float) -> None:
    found = [Tapped(0.02, seed, 8, 1e-4, 1e-4, jitter_s).found().jitter_s for seed in range(4)]
    assert np.mean(found) == pytest.approx(jitter_s, rel=0.25)


def test_taps_and_the_frames_on_their_flanks_are_counted() -> None:
    found = Tapped(0.0, taps=6).found()
    assert found.taps == 6
    # Two flanks of 0.5 s in each tap, their gentle beginnings left out.
    assert 0.5 < found.frames / (6 * 2 * 0.5 * FRAME_HZ) < 1.1
    assert found.explained > 0.99


@pytest.mark.slow
def test_what_the_virtual_rig_delays_is_found_in_its_own_frames() -> None:
    from palpate.rig.virtual import virtual_rig
    from palpate.rig.virtual.disturbances import Variation
    from palpate.rig.virtual.virtual_sensors import LATENCY_S, TRANSPORT_S
    from palpate.sensors import palm
    from palpate.sensors.palm.palm_sensor import Palm

    spec = palm.cropped(palm.palm(), 16, "tiny")
    made = virtual_rig(Palm(spec), clock=ManualClock(10**11), variation=Variation(frame_jitter_s=0.0))
    samples, frames = [], []
    for z, wait_s in ((-1e-3, 1.4), (1.5e-3, 0.8), (-1e-3, 1.1), (1.5e-3, 0.9), (-1e-3, 1.2)):
        made.stage.move_to((0.0, 0.0, z), 4e-3)
        for _ in range(round(wait_s / 0.1)):
            made.clock.sleep(0.1)
            samples += made.force.drain()
            frames += made.camera.drain()
    force = np.array([one.force_n[2] for one in samples])
    pictures = np.array([frame.image for _, frame in frames], dtype=float)
    untouched = pictures[:20].mean(axis=0)
    found = offset_between(
        np.array([one.time_ns / 1e9 for one in samples]),
        force - np.median(force[:100]),
        np.array([time_ns / 1e9 for time_ns, _ in frames]),
        np.abs(pictures - untouched).reshape(len(frames), -1).mean(axis=1),
        exposure_s=0.0,  # the virtual camera shows the middle of its exposure, and stamps the arrival
    )
    true_s = TRANSPORT_S + spec.exposure_s / 2 - LATENCY_S
    assert found.seconds == pytest.approx(true_s, abs=1e-3)
    assert found.low_s <= true_s <= found.high_s


def test_taps_at_even_times_that_fit_several_offsets_are_refused() -> None:
    t = np.arange(0, 20, 1 / FORCE_HZ)
    frames = np.arange(1, 19, 1 / FRAME_HZ)
    rng = np.random.default_rng(0)
    noise = 0.01 * rng.standard_normal(len(frames))
    with pytest.raises(RangeError, match="alike"):
        offset_between(t, 1 - np.cos(10 * t), frames, 1 - np.cos(10 * frames) + noise, most_s=0.8)


def test_an_offset_beyond_what_was_looked_at_is_refused() -> None:
    tapped = Tapped(0.3)
    with pytest.raises(RangeError):
        offset_between(tapped.force_t, tapped.force, tapped.frame_t, tapped.change, most_s=0.1)


def test_frames_that_see_nothing_are_refused() -> None:
    tapped = Tapped(0.0)
    tapped.change = tapped.rng.standard_normal(len(tapped.change))
    with refused("taps-not-seen", RangeError):
        tapped.found()


def test_a_force_without_a_tap_is_refused() -> None:
    tapped = Tapped(0.0)
    tapped.force = 0.005 * tapped.rng.standard_normal(len(tapped.force))
    with refused("no-tap", RangeError):
        tapped.found()


@pytest.mark.parametrize("name", ["force_t", "force", "frame_t", "change"])
def test_what_is_not_finite_is_refused(name: str) -> None:
    tapped = Tapped(0.0)
    getattr(tapped, name)[7] = np.nan
    with pytest.raises(InputError, match="not finite"):
        tapped.found()


@pytest.mark.parametrize("name", ["force_t", "frame_t"])
def test_times_that_do_not_increase_are_refused(name: str) -> None:
    tapped = Tapped(0.0)
    times = getattr(tapped, name)
    times[7] = times[6]
    with refused("time-order", InputError):
        tapped.found()


def test_series_that_do_not_fit_and_senseless_times_are_refused() -> None:
    tapped = Tapped(0.0)
    with refused("lengths-differ", InputError):
        offset_between(tapped.force_t, tapped.force[:-1], tapped.frame_t, tapped.change)
    for options in ({"exposure_s": -0.01}, {"exposure_s": np.nan}, {"most_s": 0.0}):
        with pytest.raises(RangeError):
            offset_between(tapped.force_t, tapped.force, tapped.frame_t, tapped.change, **options)
