import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.mechanics.half_space import hertz
from palpate.mechanics.layers.influence import cells, normal_influence, tangential_influence
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.mechanics.layers.stack_friction import STRESSES, field_below

E, A, P0 = 0.3e6, 1e-3, 1e4
TWO = Stack((ElasticLayer(1.5e-3, 3 * E, 0.3), ElasticLayer(2.5e-3, E, 0.49)))
X = np.linspace(-4 * A, 4 * A, 97)
SMOOTH = P0 * np.exp(-(X**2 + X[:, None] ** 2) / A**2)
MIDDLE = len(X) // 2


def half_space(nu):
    return Stack((ElasticLayer(math.inf, E, nu),), "half-space")


def hertz_load(x):
    return hertz.pressure(np.hypot(x, x[:, None]), A, P0)


@pytest.mark.parametrize("nu", [0.3])
def test_below_the_centre_of_hertzs_contact_the_stress_is_hubers(nu):
    x = np.linspace(-3 * A, 3 * A, 97)
    z = np.array([0.1, 0.5, 1.0, 2.0])
    found = field_below(half_space(nu), hertz_load(x), x, x, z * A)
    at = (slice(None), 48, 48)
    np.testing.assert_allclose(found.stress("zz")[at], -P0 / (1 + z**2), atol=4e-4 * P0)
    across = -P0 * ((1 + nu) * (1 - z * np.arctan(1 / z)) - 0.5 / (1 + z**2))
    np.testing.assert_allclose(found.stress("xx")[at], across, atol=5e-4 * P0)
    np.testing.assert_allclose(found.stress("yy")[at], across, atol=5e-4 * P0)


@pytest.mark.parametrize("stack", [TWO, half_space(0.4)])
def test_the_surface_of_the_field_moves_as_the_influence_of_cells_says(stack):
    # two ways to the same: waves on a padded grid, and a sum over cells without images
    grid = cells(X, X)
    pressed = field_below(stack, SMOOTH, X, X, [0.0]).displacement_m[0]
    sheared = field_below(stack, 0 * SMOOTH, X, X, [0.0], shear_x_pa=SMOOTH).displacement_m[0]
    normal = normal_influence(stack, grid).apply(0, SMOOTH)
    along = tangential_influence(stack, grid).apply_pair(np.stack([SMOOTH, 0 * SMOOTH]))
    # cells of A/12 blur the load by 1e-3; images cost as much
    np.testing.assert_allclose(pressed[2], normal, atol=4e-3 * normal.max())
    np.testing.assert_allclose(sheared[:2], along, atol=4e-3 * along.max())


def test_the_load_on_the_surface_is_the_stress_there_and_the_floor_does_not_move():
    found = field_below(TWO, SMOOTH, X, X, [0.0, 4e-3], shear_x_pa=0.3 * SMOOTH, shear_y_pa=-0.2 * SMOOTH)
    for name, load in (("zz", SMOOTH), ("xz", 0.3 * SMOOTH), ("yz", -0.2 * SMOOTH)):
        np.testing.assert_allclose(found.stress(name)[0], -load, atol=1e-6 * P0)
    assert np.abs(found.displacement_m[1]).max() == 0.0


def test_displacement_and_load_pass_through_an_interface_and_stretching_stress_jumps():
    beside = np.array([-1e-9, 0.0, 1e-9]) + 1.5e-3
    found = field_below(TWO, SMOOTH, X, X, beside)
    np.testing.assert_allclose(found.displacement_m[2], found.displacement_m[0], atol=2e-11)
    passing = [STRESSES.index(name) for name in ("zz", "xz", "yz")]
    np.testing.assert_allclose(found.stress_pa[2, passing], found.stress_pa[0, passing], atol=1e-4 * P0)
    xx = found.stress("xx")[:, MIDDLE, MIDDLE]
    assert xx[1] == pytest.approx(xx[0], rel=1e-4)  # on the interface the upper layer is reported
    assert abs(xx[2] - xx[0]) > 0.05 * P0


def test_the_stress_follows_from_the_displacement_by_hookes_law():
    z = 0.8e-3
    step = 1e-5
    found = field_below(TWO, SMOOTH, X, X, [z - step, z, z + step], shear_y_pa=0.4 * SMOOTH)
    u, h = found.displacement_m, X[1] - X[0]
    E_top, nu = 3 * E, 0.3
    mu, lam = E_top / (2 * (1 + nu)), E_top * nu / ((1 + nu) * (1 - 2 * nu))
    d = [np.gradient(u[1], h, axis=2), np.gradient(u[1], h, axis=1), (u[2] - u[0]) / (2 * step)]
    strain = {
        a + b: (d["xyz".index(a)]["xyz".index(b)] + d["xyz".index(b)]["xyz".index(a)]) / 2
        for a in "xyz"
        for b in "xyz"
    }
    volume = strain["xx"] + strain["yy"] + strain["zz"]
    inner = (slice(2, -2), slice(2, -2))
    for name in STRESSES:
        hooke = 2 * mu * strain[name] + (lam * volume if name[0] == name[1] else 0.0)
        # central differences over A/12 are right to (h/A)^2
        np.testing.assert_allclose(found.stress(name)[1][inner], hooke[inner], atol=0.01 * P0)


def test_the_stress_is_in_equilibrium():
    z, step = 2.4e-3, 1e-5
    found = field_below(TWO, SMOOTH, X, X, [z - step, z, z + step], shear_x_pa=0.3 * SMOOTH)
    h, s = X[1] - X[0], found.stress
    inner = (slice(2, -2), slice(2, -2))
    for row in ("x", "y", "z"):
        x, y, down = ("".join(sorted(row + along)) for along in "xyz")
        sums = (
            np.gradient(s(x)[1], h, axis=1)
            + np.gradient(s(y)[1], h, axis=0)
            + (s(down)[2] - s(down)[0]) / (2 * step)
        )
        assert np.abs(sums[inner]).max() < 0.01 * P0 / A


def test_summed_along_a_ray_the_field_is_that_of_plane_strain(solved_at_once):
    # the line-integral theorem: for any nu the sum is the plane field of the summed load. In a bonded layer
    # the field fades along the ray; the plane field is summed here wave by wave from an independent solution.
    wide = np.linspace(-20e-3, 20e-3, 241)
    load = P0 * np.exp(-(wide**2 + wide[:, None] ** 2) / A**2)
    z, h = 1e-3, wide[1] - wide[0]
    found = field_below(TWO, load, wide, wide, [z])
    summed = {name: found.stress(name)[0].sum(axis=0) * h for name in ("xx", "zz", "xz")}
    k = np.linspace(0.0, 8 / A, 401)[1:]
    nu, mu = 0.3, 3 * E / 2.6
    plate, n = 2 * mu / (1 - nu), nu / (1 - nu)
    U, _, T, S = np.array([solved_at_once(TWO.layers, wave, z) for wave in k]).T
    per_wave = P0 * math.pi * A**2 * np.exp(-((k * A) ** 2) / 4) * (k[1] - k[0]) / math.pi
    for i in range(101, 141, 8):
        c, s = np.cos(k * wide[i]), np.sin(k * wide[i])
        plane = {"zz": S * c, "xz": -T * s, "xx": (-plate * k * U + n * S) * c}
        for name, waves in plane.items():
            assert summed[name][i] == pytest.approx((waves * per_wave).sum(), abs=0.01 * P0 * A)


def test_what_the_field_cannot_take_is_refused():
    for depths in ([-1e-4], [5e-3], [math.nan], [], [math.inf]):
        with refused("outside-stack", RangeError):
            field_below(TWO, SMOOTH, X, X, depths)
    with pytest.raises(InputError, match="finite"):
        field_below(TWO, np.where(SMOOTH > P0 / 2, np.nan, SMOOTH), X, X, [1e-3])
    with pytest.raises(RangeError, match="margin"):
        field_below(TWO, SMOOTH, X, X, [1e-3], margin_m=-1.0)
    with refused("unknown-name", InputError):
        field_below(TWO, SMOOTH, X, X, [1e-3]).stress("zx")
