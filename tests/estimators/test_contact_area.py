"""Contact area from measures of a frame: what can be followed comes back, what cannot be known is NaN."""

import numpy as np
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.estimators.compliance.contact_area import fit_area, fit_motions


def log_area(x: np.ndarray) -> np.ndarray:
    """Of two measures, with squares: what the fit holds."""
    a, b = x.T
    return np.log(2e-4) + 0.8 * a - 0.5 * b + 0.2 * a * b + 0.1 * a**2 - 0.05 * b**2


def trials(rng, references: int, each: int = 3, frames: int = 20):
    measures = [rng.uniform(-1, 1, (frames + k, 2)) for k in range(references * each)]
    which = [k // each for k in range(references * each)]
    return measures, [np.exp(log_area(x)) for x in measures], which


def test_a_log_area_that_the_fit_can_follow_comes_back(rng) -> None:
    """The ridge of 1e-4 pulls by about as much."""
    fit = fit_area(*trials(rng, 3))
    fresh = rng.uniform(-1, 1, (50, 2))
    area, low, high = fit.at(fresh).T
    assert_allclose(area, np.exp(log_area(fresh)), rtol=2e-3)
    assert (low <= area).all()
    assert (area <= high).all()
    assert fit.spread < 1e-3


def test_the_interval_is_as_wide_as_the_worst_references_error(rng) -> None:
    """Areas of one reference scatter by 5 %, which trials that are left out show."""
    measures, areas, which = trials(rng, 3, each=6)
    areas = [
        a * (np.exp(0.05 * rng.standard_normal()) if k == 1 else 1.0)
        for a, k in zip(areas, which, strict=True)
    ]
    fit = fit_area(measures, areas, which)
    assert 0.025 < fit.spread < 0.1
    area, low, high = fit.at(measures[0], coverage=0.9)[0]
    assert_allclose([np.log(high / area), np.log(area / low)], 1.645 * fit.spread, rtol=1e-3)


def test_two_references_cannot_say_how_far_they_are_off(rng) -> None:
    fit = fit_area(*trials(rng, 2))
    area, low, high = fit.at(rng.uniform(-1, 1, (5, 2))).T
    assert np.isfinite(area).all()
    assert np.isnan([low, high]).all()
    assert np.isnan(fit.at(np.array([[np.nan, 0.0]]))).all()


def test_too_few_frames_are_refused(rng) -> None:
    with refused("too-few-frames", InputError):
        fit_area([rng.uniform(-1, 1, (29, 2))], [np.ones(29)], [0])
    measures, areas, which = trials(rng, 3)
    with refused("too-few-frames", InputError, match="0 reference"):
        fit_area(measures, [np.full_like(a, np.nan) for a in areas], which)
    with refused("too-few-frames", InputError):
        fit_motions([np.zeros((29, 7, 2))])


def test_motion_along_few_directions_is_told_by_as_many_measures(rng) -> None:
    modes, pins = rng.standard_normal((3, 40, 2)), 40
    places = [rng.standard_normal((n, 3)) * [5.0, 2.0, 1.0] for n in (15, 20, 18)]
    moved = [np.einsum("fk,kpx->fpx", at, modes) for at in places]
    motions = fit_motions(moved, 3)
    assert_allclose(np.einsum("kpx,lpx->kl", motions.directions, motions.directions), np.eye(3), atol=1e-12)
    again = motions.middle + np.einsum("fk,kpx->fpx", motions.of(moved[1]), motions.directions)
    assert_allclose(again, moved[1], atol=1e-9)
    holes = moved[1].copy()
    holes[:, rng.choice(pins, 8, replace=False)] = np.nan
    assert_allclose(motions.of(holes), motions.of(moved[1]), atol=1e-9)
