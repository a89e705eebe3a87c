"""Orders against load, recovered from light that the optics made."""

import numpy as np
import pytest
from scipy.stats import binom
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError, ScanEdgeError
from palpate.estimators import fringe_order
from palpate.estimators.fringe_light import Polariscope, one_line, tungsten, white_led
from palpate.estimators.fringe_order import fit_orders
from palpate.optics import single_retarder

UNEVEN = np.array([1.0, 2.0, 3.0, 3.7, 4.1, 5.0, 6.3, 7.0, 8.0, 9.2, 10.0])
EVEN = np.linspace(0.0, 10.0, 11)


def made(
    polariscope: Polariscope,
    load_n: np.ndarray,
    slope: float,
    *,
    offset: float = 0.0,
    uneven: float = 0.0,
    jitter: float = 0.0,
    patches: int = 3,
    seed: int = 0,
) -> np.ndarray:
    """Light ``[n p 3]``: a gain for each patch, a leak, and a lamp that flickers between photographs."""
    rng = np.random.default_rng(seed)
    share = 1 + uneven * np.linspace(-1, 1, patches)
    order = (slope * load_n[:, None] + offset) * share
    light = rng.uniform(0.5, 0.8, (1, patches, 1)) * polariscope.light(order) + 0.01
    return light * (1 + jitter * rng.standard_normal((len(load_n), 1, 1)))


def test_one_line_between_crossed_polarisers_is_a_single_retarder_at_45_degrees() -> None:
    order = np.linspace(0, 5, 101)
    expected = single_retarder(order, np.full_like(order, np.pi / 4), 0.0)
    for c in range(3):
        np.testing.assert_allclose(one_line(589e-9).light(order)[:, c], expected, atol=1e-12)


@pytest.mark.parametrize("light", [one_line(589e-9), one_line(589e-9, 10e-9), white_led(), tungsten()])
def test_crossed_and_parallel_polarisers_share_the_light(light) -> None:
    parallel = Polariscope(light.spectrum, light.wavelength_m, light.lamp, bright_field=True)
    order = np.linspace(0, 5, 51)
    np.testing.assert_allclose(light.light(order) + parallel.light(order), 1.0, atol=1e-12)
    step = 1e-6
    by_hand = (light.light(order + step) - light.light(order - step)) / (2 * step)
    np.testing.assert_allclose(light.light_and_slope(order)[1], by_hand, atol=1e-7)


@pytest.mark.parametrize("light", [one_line(589e-9), white_led()], ids=lambda p: p.lamp)
@pytest.mark.parametrize("slope", [0.09, 0.31])
def test_without_noise_the_slope_comes_back(light, slope) -> None:
    found = fit_orders(UNEVEN, made(light, UNEVEN, slope, offset=0.02), light)
    # No noise at all: what is left is that N0 is known to +-0.05 before the fit, which pulls at 0.02.
    assert found.slope_per_n == pytest.approx(slope, rel=1e-3)
    assert found.residual_order == pytest.approx(0.02, abs=5e-3)
    assert not found.ambiguous
    np.testing.assert_allclose(found.own_order, slope * UNEVEN + 0.02, atol=0.01)


@pytest.mark.slow
def test_the_interval_holds_the_slope_about_as_often_as_it_says() -> None:
    light, slope, runs = one_line(589e-9), 0.18, 120
    hits = 0
    for seed in range(runs):
        offset = 0.05 * np.random.default_rng(1000 + seed).standard_normal()
        v = made(light, UNEVEN, slope, offset=offset, jitter=0.04, patches=2, seed=seed)
        found = fit_orders(UNEVEN, v, light, greatest_order=3.0)
        hits += abs(found.slope_per_n - slope) <= found.half_width_per_n
    # Of 120 at 95 %, chance leaves fewer than 106 or all 120 once in 300 times.
    assert binom.ppf(0.003, runs, 0.95) <= hits < runs


def test_colour_tells_what_one_wavelength_cannot() -> None:
    light = white_led()
    found = fit_orders(EVEN, made(light, EVEN, 0.42, jitter=0.005), light, greatest_order=8.0)
    assert not found.ambiguous
    assert found.slope_per_n == pytest.approx(0.42, abs=found.half_width_per_n)


def test_uneven_stress_gives_the_mean_slope_and_is_told() -> None:
    light = one_line(589e-9)
    found = fit_orders(UNEVEN, made(light, UNEVEN, 0.18, uneven=0.08, patches=5), light)
    assert found.slope_per_n == pytest.approx(0.18, rel=0.005)
    assert found.spread == pytest.approx(0.08 * np.std(np.linspace(-1, 1, 5)), rel=0.05)


def test_a_part_of_a_fringe_needs_the_photograph_between_parallel_polarisers() -> None:
    light, load = white_led(), np.linspace(0, 10, 9)
    gain = np.full((2, 3), 0.7)
    order = 0.012 * load[:, None] * np.ones(2)
    v = gain * light.light(order) + 0.01
    v *= 1 + 0.01 * np.random.default_rng(0).standard_normal((9, 1, 1))
    try:
        without = fit_orders(load, v, light)
    except RangeError:
        pass
    else:
        assert without.ambiguous or without.half_width_per_n > 0.1 * without.slope_per_n
    found = fit_orders(load, v, light, open_light=gain + 0.01)
    assert not found.ambiguous
    assert found.half_width_per_n < 0.1 * found.slope_per_n
    assert found.slope_per_n == pytest.approx(0.012, abs=found.half_width_per_n)


def test_saturated_light_is_taken_as_at_least_what_it_says() -> None:
    light = one_line(589e-9)
    v = made(light, UNEVEN, 0.18)
    top = 0.8 * v.max()
    found = fit_orders(UNEVEN, np.minimum(v, top), light, clipped=v >= top)
    assert found.slope_per_n == pytest.approx(0.18, rel=2e-3)


def test_light_that_has_nothing_to_do_with_load_is_refused_or_ambiguous() -> None:
    light, load, silent = one_line(589e-9), 10.0 * np.arange(1, 10), 0
    for seed in range(5):
        rng = np.random.default_rng(seed)
        v = 0.3 + 0.05 * rng.standard_normal((9, 1, 1)) * np.ones((9, 2, 3))
        try:
            silent += not fit_orders(load, v, light).ambiguous
        except RangeError:
            continue
    # Nine numbers and a few hundred slopes: now and then one slope fits by chance (2 of 60 when measured).
    assert silent <= 1


@pytest.mark.parametrize(
    ("load", "said"),
    [
        (np.array([5.0]), "1 photograph"),
        (np.full(9, 3.0), "different loads"),
        (np.array([1.0, 2.0, 3.0, 4.0]), "4 photograph"),
        (np.array([1.0, 2.0, 3.0, 4.0, -5.0]), "negative"),
        (np.array([1.0, 2.0, 3.0, 4.0, np.nan]), "no number"),
    ],
)
def test_loads_that_tell_no_slope_are_refused(load, said) -> None:
    light = one_line(589e-9)
    with pytest.raises(InputError, match=said):
        fit_orders(load, made(light, np.nan_to_num(load), 0.2), light)


def test_light_that_is_no_light_is_refused() -> None:
    light, v = one_line(589e-9), made(one_line(589e-9), UNEVEN, 0.2)
    with refused("light-constant", InputError):
        fit_orders(UNEVEN, np.full_like(v, 0.5), light)
    for bad in (-0.1, np.nan, np.inf):
        w = v.copy()
        w[2, 0, 0] = bad
        with refused("light-range", InputError):
            fit_orders(UNEVEN, w, light)
    with refused("shape", InputError):
        fit_orders(UNEVEN, v[..., :2], light)
    with refused("white-image", InputError):
        fit_orders(UNEVEN, v, light, open_light=np.zeros((3, 3)))


def test_an_empty_search_is_refused_and_a_search_too_short_says_so() -> None:
    light = one_line(589e-9)
    v = made(light, UNEVEN, 0.31, jitter=0.01)
    for order in (0.1, -1.0, np.nan, np.inf):
        with pytest.raises(RangeError, match="greatest order"):
            fit_orders(UNEVEN, v, light, greatest_order=order)
    for residual in (0.0, 0.6, np.nan):
        with pytest.raises(RangeError, match="residual order"):
            fit_orders(UNEVEN, v, light, residual_order=residual)
    with refused("scan-edge", ScanEdgeError):
        fit_orders(UNEVEN, v, light, greatest_order=3.0)


def test_lamps_that_are_none_are_refused() -> None:
    for wavelength in (300e-9, 900e-9, 589.3, np.nan):
        with pytest.raises(RangeError, match="wavelength"):
            one_line(wavelength)
    with pytest.raises(RangeError, match="bandwidth"):
        one_line(589e-9, 100e-9)
    with pytest.raises(RangeError, match="K"):
        tungsten(300.0)


def test_the_deciding_load_decides() -> None:
    light, load = one_line(589e-9), np.arange(0.0, 8.0)
    alias = fit_orders(load, made(light, load, 0.18, jitter=0.005), light, greatest_order=7.0).rivals[0]
    more = np.append(load, alias.deciding_load_n)
    for truth in (0.18, 0.82):
        found = fit_orders(more, made(light, more, truth, jitter=0.005), light, greatest_order=7.0)
        assert found.slope_per_n == pytest.approx(truth, abs=0.01)
        assert not found.ambiguous


@pytest.mark.parametrize("slope", [1.17])
def test_every_slope_that_equal_steps_alias_is_reported_beyond_six_orders(slope) -> None:
    """Steps of 1 N that turn 1.17 orders look as those that turn 0.17: C would be wrong by 6.9 times."""
    load, light = np.arange(9.0), one_line(589e-9)
    found = fit_orders(load, made(light, load, slope, jitter=0.01), light)
    assert found.ambiguous
    told = [found.slope_per_n, *(r.slope_per_n for r in found.rivals if r.likelihood > fringe_order.RIVAL)]
    assert min(abs(one - slope) for one in told) < 0.01
    assert not fit_orders(load, made(light, load, 0.17, jitter=0.01), light, greatest_order=3.0).ambiguous
