import math

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from palpate.core import InputError, RangeError
from palpate.mechanics.layers.layer_stress import stress_under
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.mechanics.layers.stack_friction import field_below

H, NU, A = 10e-3, 0.49, 2.2e-3
X = (np.arange(120) - 59.5) * 1.5e-4
Z = H * np.linspace(0, 1, 12) ** 2
STACK = Stack((ElasticLayer(H, 0.3e6, NU),))


def hertzian(x, y, radius_m=A):
    return np.sqrt(np.maximum(1 - ((x[None] - 5e-4) ** 2 + (y[:, None] + 1e-3) ** 2) / radius_m**2, 0)) * 1e5


@pytest.fixture(scope="module")
def loads():
    p = hertzian(X, X)
    return p, np.stack([0.3 * p, -0.2 * p * X / A])  # pulled, and twisted a little


@pytest.fixture(scope="module")
def reference(loads):
    """The stresses of `RAY_STRESSES`, on the load's own grid, with a margin wide enough."""
    p, (qx, qy) = loads
    field = field_below(STACK, p, X, X, Z, shear_x_pa=qx, shear_y_pa=qy, margin_m=60e-3)
    s = {name: field.stress(name) for name in ("xx", "yy", "zz", "yz", "xz", "xy")}
    return np.stack([s["xx"] - s["zz"], s["yy"] - s["zz"], s["xy"], s["xz"], s["yz"]], axis=1)


def read(grid, x, y):
    """On the points of two axes."""
    _, _, ny, nx = grid.stress_pa.shape
    rows = grid.first_m[1] + np.arange(ny) * grid.cell_m[1]
    columns = grid.first_m[0] + np.arange(nx) * grid.cell_m[0]
    values = RegularGridInterpolator((rows, columns), np.moveaxis(grid.stress_pa, (0, 1), (2, 3)))
    at = np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1)
    return np.moveaxis(values(at), (2, 3), (0, 1))


def test_the_window_holds_the_stress_of_the_slower_way(loads, reference):
    p, q = loads
    near, _ = stress_under(H, NU, Z, p, X, X, q)
    inner = slice(35, 85)
    off = read(near, X[inner], X[inner]) - reference[:, :, inner, inner]
    found = np.abs(off).max(axis=(1, 2, 3)) / p.max()
    assert found[3:].max() < 1e-3  # from 0.7 mm on; 3e-4 is measured
    assert found[:3].max() < 6e-3  # shorter waves than the grid's are told apart by the cut between them


def test_the_wide_grid_holds_it_beyond(loads, reference):
    p, q = loads
    near, far = stress_under(H, NU, Z, p, X, X, q)
    ends = near.first_m[0] + near.cell_m[0] * near.stress_pa.shape[3]
    outside = np.flatnonzero(ends < X)
    assert len(outside) > 5
    off = read(far, X[outside], X[::5]) - reference[:, :, ::5][..., outside]
    assert np.abs(off).max() < 1e-3 * p.max()  # 3e-4 is measured, of which most is the straight line


def test_every_plane_carries_the_whole_shear_and_the_whole_pressure(loads):
    """Global equilibrium: what acts on the skin acts on each plane below it, whatever the depth.

    A traction along +x on the skin is a stress -q on planes whose normal points into it. Pressure leaves
    the mean of xx - zz that a bonded layer has under even pressure, where it cannot widen: xx = nu / (1 - nu)
    zz. Far from the load all of this is the sum over the wide grid; single precision leaves 1e-6.
    """
    p = loads[0]
    q = np.stack([0.3 * p, -0.1 * p])
    _, far = stress_under(H, NU, Z, p, X, X, q)
    cell = far.cell_m[0] * far.cell_m[1] / (X[1] - X[0]) ** 2
    carried = far.stress_pa.sum(axis=(2, 3), dtype=np.float64) * cell / p.sum()
    widened = 1 - NU / (1 - NU)
    np.testing.assert_allclose(carried, [[widened, widened, 0.0, -0.3, 0.1]] * len(Z), atol=2e-5)


def test_stress_depends_on_ratios_of_lengths_only(loads):
    """All lengths ten times as long; the tables' steps go with them, so only rounding differs."""
    p, q = loads
    for here, there in zip(
        stress_under(H, NU, Z, p, X, X, q),
        stress_under(10 * H, NU, 10 * Z, p, 10 * X, 10 * X, q),
        strict=True,
    ):
        np.testing.assert_allclose(np.multiply(there.cell_m, 0.1), here.cell_m)
        np.testing.assert_allclose(there.stress_pa, here.stress_pa, atol=1e-5 * np.abs(here.stress_pa).max())


def test_what_has_no_stress_is_refused(loads):
    p, q = loads
    with pytest.raises(InputError, match="not finite"):
        stress_under(H, NU, Z, p * math.nan, X, X)
    with pytest.raises(InputError, match="not finite"):
        stress_under(H, NU, Z, p, X, X, q + math.inf)
    with pytest.raises(RangeError, match=r"below 0\.5"):
        stress_under(H, 0.5, Z, p, X, X)
    for planes in (Z[::-1].copy(), Z + 1e-3):
        with pytest.raises(RangeError, match="rise within"):
            stress_under(H, NU, planes, p, X, X)
