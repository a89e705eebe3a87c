"""Modulus and radius by a surface through references: of bodies whose law is known."""

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError
from palpate.estimators.compliance.hertz_inversion import fit_shape_surface
from palpate.mechanics.half_space.hertz import Body

TIP = Body(0.06e6, 20e-3)
FORCES = np.linspace(1.0, 4.5, 40)
INF = np.inf
FLATS = [(INF, INF), (0.31e6, INF), (0.13e6, INF), (0.045e6, INF)]
RIGID = [(INF, 20e-3), (INF, 30e-3), (INF, 60e-3)]
SOFT = [(0.13e6, 20e-3), (0.13e6, 40e-3), (0.045e6, 20e-3), (0.045e6, 40e-3)]
NOISE = 2e-3


def row(modulus_pa: float, radius_m: float, rng: np.random.Generator) -> np.ndarray:
    """Approach and contact radius of two of Hertz's bodies, and noise."""
    both = TIP.against(Body(modulus_pa, radius_m)) if np.isfinite(modulus_pa) else None
    if both is None:
        together = 1 / (1 / TIP.radius_m + 1 / radius_m)
        both = Body(TIP.modulus_pa, together)
    y = np.concatenate([1e3 * both.approach_m(FORCES), 1e3 * np.sqrt(both.area_m2(FORCES) / np.pi)])
    return y + NOISE * rng.standard_normal(y.shape)


def surface(references, rng):
    trials = [np.stack([row(E, R, rng) for _ in range(5)]) for E, R in references]
    return fit_shape_surface([E for E, _ in references], [R for _, R in references], trials)


def test_modulus_and_radius_of_hertz_bodies_come_back_within_their_intervals(rng) -> None:
    by = surface(FLATS + RIGID + SOFT, rng)
    for E, R in ((0.08e6, 25e-3), (0.2e6, 35e-3), (0.1e6, INF)):
        found = by.of(np.stack([row(E, R, rng)]))
        assert found.modulus_pa[1] <= E <= found.modulus_pa[2]
        assert found.radius_m[1] <= R <= found.radius_m[2]
        assert abs(np.log(found.modulus_pa[0] / E)) < 0.12
        assert abs(20e-3 / found.radius_m[0] - 20e-3 / R) < 0.03


def test_a_flat_is_no_sphere_and_a_sphere_no_flat(rng) -> None:
    by = surface(FLATS + RIGID + SOFT, rng)
    flat, ball = (by.of(np.stack([row(0.1e6, R, rng)])).radius_m for R in (INF, 30e-3))
    assert np.isinf(flat[2])
    assert flat[1] > 0.1
    assert np.isfinite(ball[2])
    rigid = by.of(np.stack([row(INF, 30e-3, rng)])).modulus_pa
    assert rigid[1] > 0.5e6


def test_with_shuffled_radii_the_surface_tells_nothing_of_them(rng) -> None:
    good = surface(FLATS + RIGID + SOFT, rng)
    moduli = [E for E, _ in FLATS + RIGID + SOFT]
    wrong = [INF, INF, INF, INF, 60e-3, 20e-3, 30e-3, 40e-3, 20e-3, 40e-3, 20e-3]
    trials = [np.stack([row(E, R, rng) for _ in range(5)]) for E, R in FLATS + RIGID + SOFT]
    bad = fit_shape_surface(moduli, wrong, trials)
    assert bad.between[1] > 3 * good.between[1]
    assert 0 < len(good.misses) < len(moduli)
    assert np.linalg.norm(bad.misses, axis=1).max() > 2 * np.linalg.norm(good.misses, axis=1).max()


@pytest.mark.parametrize(
    "references", [FLATS + RIGID, FLATS + RIGID[:1] + SOFT, FLATS[1:] + RIGID + SOFT, RIGID + SOFT]
)
def test_too_few_references_are_refused_with_what_is_needed(rng, references) -> None:
    with refused("too-few-references", InputError):
        surface(references, rng)
