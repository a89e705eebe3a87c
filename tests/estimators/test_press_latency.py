"""Latency of a camera from presses that come back: synthetic tips that answer at once, or creep."""

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.estimators.compliance.press_latency import (
    disagreement,
    joined_latency,
    pin_course,
    press_latency,
)

RATE_HZ, STEP_N, FINE_S = 200.0, 1 / 16, 1e-3


def press(seed, late_s, way_s=1.0, *, frames_hz=20.0, back=True, creep=None, noise_n=0.02, jitter_s=0.002):
    """Times, force by a noisy sensor of 1/16 N, samples of frames, and motion as late frames show it.

    With ``creep`` = (time, share) the force relaxes by that share of it, so that motion lags behind it.
    """
    rng = np.random.default_rng(seed)
    begins = 0.4 + rng.uniform(0, 0.1)
    fine = np.arange(-1, 2 * way_s + 2.2, FINE_S)
    depth = np.clip(1 - np.abs(fine - begins - way_s) / way_s, 0, None)
    depth = depth if back else np.where(fine > begins + way_s, 1, depth)
    force = 5 * depth**1.7
    if creep is not None:
        force = relaxing(force, *creep)
    ends = begins + (2 * way_s + 0.6 if back else way_s)
    time = np.arange(0, ends, 1 / RATE_HZ)
    measured = np.interp(time, fine, force) + noise_n * rng.standard_normal(len(time))
    sample = np.searchsorted(time, np.arange(1, int(time[-1] * frames_hz)) / frames_hz - 1e-9)
    shown = time[sample] - late_s - jitter_s * rng.standard_normal(len(sample))
    motion = np.interp(shown, fine, 12 * depth**1.2 * (1 + 0.3 * depth))
    motion = motion + 0.02 * rng.standard_normal(len(sample))
    return time, np.round(measured / STEP_N) * STEP_N, sample, motion


def relaxing(force, time_s, share):
    """Standard linear solid: beside a spring, one behind a dashpot, that a step of force leaves slowly."""
    kept, branch = np.exp(-FINE_S / time_s), np.zeros_like(force)
    for i in range(1, len(force)):
        branch[i] = kept * branch[i - 1] + force[i] - force[i - 1]
    return (force + share * branch) / (1 + share)


@pytest.mark.parametrize("late_s", [-0.02, 0.1])
def test_a_known_latency_comes_back_with_its_sign_within_five_standard_uncertainties(late_s) -> None:
    found = press_latency(*press(1, late_s))
    assert abs(found.seconds - late_s) < 5 * found.sd_s
    assert found.low_s < found.seconds < found.high_s
    assert 0 < found.sd_s < 2e-3
    # Of a step of 1/16 N over a rise of 6 N/s: a wrong sign would be off by 80 ms, a sample by 5 ms.


def test_the_law_of_force_over_motion_does_not_matter_as_long_as_it_rises() -> None:
    time, force, sample, motion = press(3, 0.06)
    for law in (np.cbrt, lambda x: -np.square(x)):
        bent = press_latency(time, force, sample, 12 * law(motion / 6))
        assert bent.seconds == pytest.approx(0.06, abs=4e-3)


def test_a_press_that_only_loads_tells_nothing_and_is_refused() -> None:
    with refused("no-unloading", RangeError):
        press_latency(*press(4, 0.04, 1.5, back=False))


def test_nothing_that_presses_or_moves_is_refused() -> None:
    time, force, sample, motion = press(5, 0.04)
    noise = 0.02 * np.random.default_rng(5).standard_normal(len(time))
    with refused("nothing-pressed", RangeError):
        press_latency(time, 3 + noise, sample, motion)
    with refused("no-motion", RangeError):
        press_latency(time, force, sample, noise[: len(sample)])


def test_a_force_of_another_press_is_refused_or_has_no_one_latency() -> None:
    alone, swapped = [], []
    for seed in range(3):
        time, force, sample, motion = press(seed, 0.04)
        n, other = len(time), press(seed + 50, 0.04)[1]
        other = np.pad(other, (0, max(n - len(other), 0)))[:n]
        alone.append(press_latency(time, force, sample, motion))
        swapped.append(press_latency(time, other, sample, motion))
    own, wrong = joined_latency(alone), joined_latency(swapped)
    assert not disagreement(own)
    assert disagreement(wrong).code == "differ"
    assert wrong.high_s - wrong.low_s > 10 * (own.high_s - own.low_s)
    time, force, sample, motion = press(1, 0.04)
    slow = press(2, 0.04, 1.6)[1][: len(time)]
    with refused("latency-not-found", RangeError):
        press_latency(time, slow, sample, motion)


def test_two_speeds_agree_on_a_delay_and_disagree_on_creep() -> None:
    def joined(creep, ways_s=(0.5, 0.5, 0.5, 2.0, 2.0, 2.0)):
        return joined_latency(
            [press_latency(*press(k, 0.04, way, frames_hz=30, creep=creep)) for k, way in enumerate(ways_s)]
        )

    delay, creeping, one_speed = joined(None), joined((0.3, 0.2)), joined((0.3, 0.2), (2.0, 2.0))
    assert delay.speeds == 2
    assert not disagreement(delay)
    assert delay.low_s < 0.04 < delay.high_s
    assert disagreement(creeping).code == "creep"
    assert creeping.slow_s[0] > creeping.fast_s[0] > 0.04  # as motion behind force, on top of the delay
    assert one_speed.speeds == 1
    assert not disagreement(one_speed)  # one speed does not tell
    assert one_speed.seconds > 0.07


def test_presses_of_a_camera_that_changes_are_joined_with_the_scatter_between_them() -> None:
    steady = joined_latency([press_latency(*press(k, 0.04)) for k in range(3)])
    changing = [press_latency(*press(k, late)) for k, late in enumerate((0.02, 0.06, 0.1))]
    found = joined_latency(changing)
    assert steady.sd_s < 1e-3
    assert found.between_s == pytest.approx(0.04, rel=0.2)  # standard deviation of the three
    assert found.low_s < 0.02 < 0.1 < found.high_s
    assert disagreement(found).code == "differ"
    alone = joined_latency(changing[:1])
    assert (alone.seconds, alone.low_s) == (changing[0].seconds, changing[0].low_s)
    with pytest.raises(InputError, match="no press"):
        joined_latency([])


def test_the_course_is_how_far_pins_go_together_and_lost_ones_do_not_count() -> None:
    ways = np.random.default_rng(7).standard_normal((30, 2))
    ways *= np.sqrt(30 / np.sum(ways**2))
    moved = np.linspace(0, 5, 12)[:, None, None] * ways
    assert np.abs(pin_course(moved)) == pytest.approx(np.linspace(0, 5, 12))
    moved[4:, :10] = np.nan
    left = np.sqrt(np.sum(ways[10:] ** 2) / 20)
    assert np.abs(pin_course(moved)) == pytest.approx(left * np.linspace(0, 5, 12))
    moved[4:, :20] = np.nan
    with refused("pins-lost", InputError):
        pin_course(moved)


@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        (lambda t, f, s, m: (t, f[:-1], s, m), "lengths-differ"),
        (lambda t, f, s, m: (t, f, s[:-1], m), "too-few-frames"),
        (lambda t, f, s, m: (t, f, s[:12], m[:12]), "too-few-frames"),
        (lambda t, f, s, m: (t, f * np.nan, s, m), "not-finite"),
        (lambda t, f, s, m: (t[::-1], f, s, m), "time-order"),
    ],
)
def test_series_that_are_none_are_refused(wrong, code) -> None:
    with refused(code):
        press_latency(*wrong(*press(8, 0.0)))


@pytest.mark.slow
def test_intervals_cover_at_their_rate() -> None:
    """Of 95 %, in presses of three kinds; 200 of a kind show 90 to 100 by chance."""
    kinds = {"slow": {}, "fast": {"way_s": 0.5, "frames_hz": 30}, "jitter": {"jitter_s": 0.01}}
    truths, seeds = (-0.02, 0.0, 0.04, 0.1), range(50)
    for name, kind in kinds.items():
        held, joint = [], []
        for late in truths:
            found = [press_latency(*press(1000 + k, late, **kind)) for k in seeds]
            held += [one.low_s <= late <= one.high_s for one in found]
            five = [joined_latency(found[i : i + 5]) for i in range(0, len(found), 5)]
            joint += [one.low_s <= late <= one.high_s for one in five]
        print(f"{name}: {np.mean(held):.3f} of presses, {np.mean(joint):.3f} of five joined")
        assert np.mean(held) >= 0.90
        assert np.mean(joint) >= 0.85
