"""The literature's baseline, I = sin^2(2 theta) sin^2(pi d (s1 - s2) C / lambda), which is wrong here.

It takes one stress difference, that of the mid-plane, for the whole path d, and one direction theta for its
axes. Under a contact the stress lives within about two contact radii of it, not along the whole skin, and its
axes turn along the ray. It is kept as a named baseline, so that what the march changes is a number; nothing
renders with it.
"""

from __future__ import annotations

import numpy as np

from palpate.core import Float, ndarray
from palpate.optics.polariscope import single_retarder
from palpate.optics.stress_optic import fringe_order, stress_axis

Stress = Float[ndarray, "*n"]


def single_slice(
    difference_pa: Stress,
    shear_pa: Stress,
    path_m: float,
    coefficient_per_pa: float,
    wavelength_m: float,
    polariser_rad: float,
) -> Stress:
    """Transmitted fraction as if the mid-plane's stress filled the whole path: the literature's baseline.

    Args:
        difference_pa: s_xx - s_zz in the mid-plane y = 0 [Pa].
        path_m: d, the path that is assumed [m]; the skin's width is what is usually taken.
        polariser_rad: from x towards z [rad].
    """
    order = fringe_order(difference_pa * path_m, shear_pa * path_m, coefficient_per_pa, wavelength_m)
    return single_retarder(order, stress_axis(difference_pa, shear_pa), polariser_rad)


def best_path(
    difference_pa: Stress, shear_pa: Stress, summed_difference: Stress, summed_shear: Stress
) -> float:
    """The one path d [m] that makes the baseline's retardance nearest to the summed one, by least squares.

    Args:
        difference_pa: s_xx - s_zz in the mid-plane [Pa].
        summed_difference: int (s_xx - s_zz) dy [Pa m].
        summed_shear: int 2 s_xz dy [Pa m].
    """
    square = float(np.sum(difference_pa**2 + shear_pa**2))
    return float(np.sum(difference_pa * summed_difference + shear_pa * summed_shear)) / square


def single_slice_error(baseline: Stress, marched: Stress) -> tuple[float, float]:
    """Root mean square and greatest error of the baseline, in transmitted fraction."""
    off = abs(np.asarray(baseline, float) - marched)
    return float(np.sqrt(np.mean(off**2))), float(off.max())
