"""Laws of plateaus: what is held counts with its force, what is not is refused by its name."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, Wrench
from palpate.sensing.collection.image_plateau import contact_place
from palpate.sensing.collection.plateau_finder import Plateau, PlateauFinder, Refused, Weighing

ZERO_N = 1.7


def hand(
    held_n: float = 5.0,
    hold_s: float = 1.0,
    *,
    rate_hz: float = 200.0,
    ramp_s: float = 0.4,
    creep: float = 0.0,
    tremor: float = 0.0,
    noise_n: float = 0.005,
    drift_n_s: float = 0.0,
    step_n: float = 0.0,
    delay_s: float = 0.0,
    presses: int = 1,
) -> list[Wrench]:
    """Samples of presses, 1 s of the untouched sensor before and after each."""
    period = 2.0 + 2 * ramp_s + hold_s
    t = np.arange(round((presses * period + 1.0) * rate_hz)) / rate_hz
    s = np.maximum(t - delay_s, 0.0) % period - 1.0
    shape = np.clip(np.minimum(s / ramp_s, (2 * ramp_s + hold_s - s) / ramp_s), 0, 1)
    along = np.clip((s - ramp_s) / hold_s, 0, 1) - 0.5
    force = held_n * shape * (1 + creep * along + tremor * np.sqrt(2) * np.sin(2 * np.pi * 10 * s))
    rng = np.random.default_rng(0)
    force = ZERO_N + force + drift_n_s * t + noise_n * rng.standard_normal(len(t))
    if step_n:
        force = np.round(force / step_n) * step_n
    # A scale's samples carry the time at which the force was, less its stated delay.
    return [Wrench(round(1e9 * (at - delay_s)), (0.0, 0.0, float(f))) for at, f in zip(t, force, strict=True)]


def verdicts(samples: list[Wrench], scale: Weighing | None = None) -> list[Plateau | Refused]:
    finder = PlateauFinder(scale or Weighing(200.0))
    return finder.take(samples) + finder.end()


@pytest.mark.parametrize("held_n", [0.3, 20.0])
def test_force_of_a_plateau_is_what_was_held_less_the_zero(held_n: float) -> None:
    (found,) = verdicts(hand(held_n))
    assert isinstance(found, Plateau)
    assert found.force_n == pytest.approx(held_n, rel=0.01)
    assert found.zero_n == pytest.approx(ZERO_N, abs=0.005)
    assert 1.3 < found.begins_ns / 1e9 < 1.55
    assert 2.2 < found.ends_ns / 1e9 < 2.55


@pytest.mark.parametrize(
    ("kind", "samples"),
    [
        ("too short", hand(hold_s=0.05, ramp_s=0.1)),
        ("still moving", hand(hold_s=1.0, creep=0.6, ramp_s=0.5)),
        ("trembling", hand(tremor=0.12)),
    ],
)
def test_press_that_was_not_held_is_refused_by_its_name(kind: str, samples: list[Wrench]) -> None:
    (found,) = verdicts(samples)
    assert isinstance(found, Refused)
    assert found.kind == kind


def test_force_that_is_beyond_the_range_or_stays_away_is_refused() -> None:
    (beyond,) = verdicts(hand(20.0), Weighing(200.0, range_n=15.0))
    assert isinstance(beyond, Refused)
    assert (beyond.kind, "15 N" in beyond.why) == ("beyond range", True)
    late = [one for one in hand() if not 1.5e9 < one.time_ns < 2.2e9]
    (late_one,) = verdicts(late)
    assert isinstance(late_one, Refused)
    assert late_one.kind == "late"
    told = [
        Wrench(one.time_ns, (np.nan,) * 3, fault="its unit changed from g to oz") if i == 300 else one
        for i, one in enumerate(hand())
    ]
    (changed,) = verdicts(told)
    assert isinstance(changed, Refused)
    assert "to oz" in changed.why


def test_plateau_outlasts_the_scales_delay() -> None:
    kitchen = Weighing(10.0, delay_s=0.4)
    (held,) = verdicts(hand(5.0, 1.2, rate_hz=10.0, delay_s=0.4, step_n=0.0098), kitchen)
    assert isinstance(held, Plateau)
    assert held.force_n == pytest.approx(5.0, rel=0.02)
    # Half of the delay is cut from either end of what was held from 1.4 to 2.6 s.
    assert held.begins_ns / 1e9 >= 1.35 + 0.2
    assert held.ends_ns / 1e9 <= 2.65 - 0.2
    (short,) = verdicts(hand(5.0, 0.45, rate_hz=10.0, delay_s=0.4), kitchen)
    assert isinstance(short, Refused)


def test_slow_drift_of_the_zero_is_taken_off_and_said() -> None:
    finder = PlateauFinder(Weighing(200.0))
    found = finder.take(hand(5.0, drift_n_s=0.01, presses=8))
    forces = [one.force_n for one in found if isinstance(one, Plateau)]
    assert len(forces) >= 7
    assert np.abs(np.array(forces) - 5.0).max() < 0.05
    assert finder.drift_n_min == pytest.approx(0.6, rel=0.1)


def test_zero_that_jumps_over_a_press_is_refused() -> None:
    moved = [
        Wrench(one.time_ns, (0.0, 0.0, one.force_n[2] + (0.05 if one.time_ns > 2e9 else 0.0)))
        for one in hand(1.0, noise_n=0.01)
    ]
    found = verdicts(moved)
    assert isinstance(found[0], Refused)
    assert found[0].kind == "zero moved"
    assert not any(isinstance(one, Plateau) for one in found)


def test_a_zero_taken_under_a_weight_is_told_when_the_weight_goes() -> None:
    resting = [Wrench(round(1e9 * k / 200), (0.0, 0.0, 5.0 if k < 400 else 0.0)) for k in range(1000)]
    again = [Wrench(one.time_ns + 5 * 10**9, one.force_n) for one in resting]
    found = [one for one in verdicts(resting + again) if isinstance(one, Refused)]
    assert found
    assert {one.kind for one in found} == {"zero moved"}
    assert "than untouched" in found[0].why


def test_a_contact_s_place_is_where_the_image_differs_and_none_is_given_where_nothing_does() -> None:
    rng = np.random.default_rng(21)
    rows, columns = np.mgrid[:120, :160]

    def image(level: float) -> np.ndarray:
        made = 100 + level * (np.hypot(columns - 100, rows - 50) < 12) + rng.normal(0, 1.5, (120, 160))
        return np.clip(np.rint(made), 0, 255).astype(np.uint8)

    rests = [image(0) for _ in range(3)]
    assert contact_place(image(25), rests, (20, 10, 130, 100)) == pytest.approx((100, 50), abs=1.0)
    assert contact_place(image(0), rests, (20, 10, 130, 100)) is None
    assert contact_place(image(25), rests, (0, 0, 60, 60)) is None
    assert contact_place(image(25)[:80], rests, (0, 0, 160, 120)) is None
    assert contact_place(image(25), [], (0, 0, 160, 120)) is None


def slowly_weighed(
    hold_s: float, lag_s: float | None, seed: int = 4
) -> tuple[list[Plateau], list[Refused], float]:
    """Presses on a scale whose filter is of first order, 0.4 s; and the worst label of a first instant."""
    rng, step_s, filter_s = np.random.default_rng(seed), 0.005, 0.4
    pressed: list[np.ndarray] = [np.zeros(600)]
    for force in rng.uniform(0.5, 4.0, 12):
        up, down = (np.linspace(0, 1, round(s / step_s)) for s in rng.uniform(0.3, 0.8, 2))
        held = np.ones(round(hold_s / step_s))
        pressed.append(np.concatenate([force * up, force * held, force * down[::-1], np.zeros(500)]))
    true = np.concatenate(pressed)
    read = np.zeros_like(true)
    for i in range(1, len(true)):
        read[i] = read[i - 1] + (1 - np.exp(-step_s / filter_s)) * (true[i] - read[i - 1])
    told = np.round((read + rng.normal(0, 0.002, len(read))) / 0.01) * 0.01
    finder = PlateauFinder(Weighing(10.0, 0.4, lag_s=lag_s))
    samples = [  # stamped by the delay before they come
        Wrench(round((i * step_s + 9.6) * 1e9), (0.0, 0.0, float(told[i]))) for i in range(0, len(told), 20)
    ]
    found = finder.take(samples)
    plateaus = [one for one in found if isinstance(one, Plateau)]
    first = [true[round((one.begins_ns / 1e9 - 10) / step_s)] for one in plateaus]
    off = [abs(one.force_n / f - 1) if f > 0 else 1.0 for one, f in zip(plateaus, first, strict=True)]
    return plateaus, [one for one in found if isinstance(one, Refused)], max(off, default=0.0)


@pytest.mark.parametrize("lag_s", [pytest.param(None, marks=pytest.mark.slow), 0.4])
def test_a_plateau_of_a_slow_scale_begins_once_force_and_its_rate_stand_still(lag_s: float | None) -> None:
    plateaus, _, off = slowly_weighed(2.6, lag_s)
    assert len(plateaus) >= 10
    assert off < 0.04
    plateaus, refused, _ = slowly_weighed(1.4, lag_s)
    assert plateaus == []
    assert sum("2.0 s" in one.why for one in refused) >= 10
    assert slowly_weighed(1.4, 0.0)[2] > 0.06  # taken for a scale without a filter


@pytest.mark.parametrize("lag_s", [float("nan")])
def test_a_lag_that_is_none_is_refused(lag_s: float) -> None:
    with refused("lag-range", InputError):
        PlateauFinder(Weighing(10.0, 0.4, lag_s=lag_s))
