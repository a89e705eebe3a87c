"""Orders read from the colours of a virtual palm's edge-on view, beside those summed through its stress."""

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from palpate.estimators.fringe_light import Polariscope
from palpate.estimators.fringe_map import ColourReader, table_of
from palpate.sensors.palm.fringe_orders import edge_on
from palpate.sensors.palm.fringe_view import columns, march_fringes, spectrum
from palpate.sensors.palm.palm_spec import small

DEPTH_M = 2e-3
DARK = 0.02  # of light: the ball and rays that the surface throws back


def orders_summed(spec):
    """N of each pixel, not a number where the ray passes no membrane, and its offset from the axis [m]."""
    known = edge_on(spec, DEPTH_M)
    offset, _, _ = columns(spec, spec.fringes).about(0.0, 0.0)
    both_sides = np.r_[-known.offset_m[:0:-1], known.offset_m]
    table = RegularGridInterpolator(
        (known.depth_m, both_sides), np.c_[known.order[:, :0:-1], known.order], bounds_error=False
    )
    z, s = np.meshgrid(spec.fringes.down_m, offset, indexing="ij")
    return table(np.stack([z, s], axis=-1)), np.abs(s)


def test_orders_under_a_ball_are_read_near_its_axis_where_the_stress_does_not_turn() -> None:
    spec = small()
    light = march_fringes(spec, DEPTH_M, 0.0, 0.0)
    noisy = light + 0.005 * np.random.default_rng(0).standard_normal(light.shape)
    lamp = Polariscope(spectrum(spec.bands), 550e-9, "the palm's own")
    found = ColourReader(table_of(lamp), noise=0.01, isoclinics=True).read(noisy)
    N, offset = orders_summed(spec)
    use = found.valid & (light.min(axis=2) > DARK) & (N > 0.25)
    near, far = (
        np.abs(found.order - N)[use & (offset >= a) & (offset < b)] for a, b in ((0, 1e-3), (3e-3, 5e-3))
    )
    assert N[use].max() > 1.2
    assert near.size > 50
    assert np.median(near) < 0.01
    assert np.mean(near > 0.1) < 0.03
    # Further out the axes turn along the ray, and there is no single order.
    assert np.median(far) > 5 * np.median(near)
