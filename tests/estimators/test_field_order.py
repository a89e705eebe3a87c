"""Order against load from a whole field, recovered from light that the optics made."""

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.estimators.field_order import fit_field
from palpate.estimators.fringe_light import one_line, white_led
from palpate.mechanics.probe_contact import disc_difference

LOADS = np.array([0.0, 40.0, 90.0, 130.0, 150.0, 200.0, 260.0, 300.0, 340.0])
GRID = np.linspace(-0.9, 0.9, 21)
SODIUM = one_line(589.3e-9)


def face(shift=0.0):
    """u, axis and places of the disc's points, the disc shifted to one side by some radii."""
    x, y = (v.ravel() for v in np.meshgrid(GRID, GRID))
    u, axis = disc_difference(x, y)
    keep = np.isfinite(u) & (u < 2.5) & (np.hypot(x, y) < 0.85)
    seen = disc_difference(x[keep] + shift, y[keep])[0]
    return seen, axis[keep]


def photographs(k, light, seed, *, u=None, visibility=1.0, loads=LOADS, load_error=0.02):
    rng = np.random.default_rng(seed)
    u = face()[0] if u is None else u
    order = k * loads * (1 + load_error * rng.standard_normal(len(loads)))
    v = 0.7 * np.reshape(visibility, (-1, 1)) * light.light(order[:, None] * u) + 0.01
    v *= 1 + 0.05 * rng.standard_normal((len(loads), 1, 1))
    return np.maximum(v + 0.01 * rng.standard_normal(v.shape), 0)


@pytest.mark.parametrize(("light", "k"), [(SODIUM, 0.004), (white_led(), 0.012)], ids=["sodium", "led"])
def test_a_whole_face_gives_the_slope_inside_its_interval(k, light) -> None:
    found = fit_field(LOADS, photographs(k, light, 3), face()[0], light)
    assert found.slope_per_n == pytest.approx(k, abs=found.half_width_per_n)
    assert found.half_width_per_n < 0.06 * k
    assert not found.ambiguous
    assert found.rms < 0.1


def test_evenly_spaced_loads_do_not_alias_on_a_whole_face() -> None:
    loads = 80.0 * np.arange(9)
    for k in (0.2 / 80, 0.8 / 80):
        found = fit_field(
            loads, photographs(k, SODIUM, 1, loads=loads), face()[0], SODIUM, greatest_order=8.0
        )
        assert found.slope_per_n == pytest.approx(k, rel=0.03)
        assert not found.ambiguous


def test_a_plane_polariscope_s_isoclinics_are_taken_out() -> None:
    u, axis = face()
    visible = np.sin(2 * (axis - np.pi / 8)) ** 2
    v = photographs(0.009, SODIUM, 2, visibility=visible)
    with_them = fit_field(LOADS, v, u, SODIUM, visibility=visible)
    assert with_them.slope_per_n == pytest.approx(0.009, abs=with_them.half_width_per_n)
    assert with_them.rms < 0.5 * fit_field(LOADS, v, u, SODIUM).rms


def test_a_disc_that_stands_elsewhere_and_a_lamp_of_another_kind_show() -> None:
    right = fit_field(LOADS, photographs(0.012, white_led(), 4), face()[0], white_led())
    moved = fit_field(LOADS, photographs(0.012, white_led(), 4, u=face(0.03)[0]), face()[0], white_led())
    assert moved.rms > 3 * right.rms
    with refused("order-not-found", RangeError):
        fit_field(LOADS, photographs(0.012, white_led(), 4, u=face(0.12)[0]), face()[0], white_led())
    lamp = fit_field(LOADS, photographs(0.012, white_led(), 4), face()[0], SODIUM)
    assert lamp.rms > 3 * right.rms


def test_what_tells_no_order_is_refused() -> None:
    u = face()[0]
    v = photographs(0.009, SODIUM, 5)
    with refused("too-few-loads", InputError, match="1 load"):
        fit_field(np.full(9, 50.0), v, u, SODIUM)
    with refused("stress-uniform", InputError):
        fit_field(LOADS, v, np.ones_like(u), SODIUM)
    with refused("order-not-found", RangeError):
        fit_field(LOADS, np.random.default_rng(0).uniform(0.2, 0.8, v.shape), u, SODIUM)


@pytest.mark.slow
def test_intervals_of_a_whole_face_hold_the_slope_at_their_rate() -> None:
    # 200 draws, 2 % error of each load: chance leaves 95 % of 200 outside 178 to 199 once in 300 times.
    hits = 0
    for seed in range(200):
        found = fit_field(LOADS, photographs(0.009, SODIUM, seed), face()[0], SODIUM, greatest_order=4.0)
        hits += abs(found.slope_per_n - 0.009) < found.half_width_per_n
    assert 178 <= hits <= 199
