"""Contact and friction on small systems that can be solved by hand or by another code."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import nnls

from palpate.core.errors import RangeError
from palpate.mechanics.axisymmetric.tilted_tip import solve_friction


def springs(n: int, rng=None) -> np.ndarray:
    """Compliance of n cells: a positive definite matrix, or unit springs."""
    if rng is None:
        return np.eye(3 * n).reshape(n, 3, n, 3)
    a = rng.normal(size=(3 * n, 3 * n))
    return (a @ a.T / (3 * n) + np.eye(3 * n)).reshape(n, 3, n, 3)


def solved(C, gap, slid, friction):
    return solve_friction(C, np.array(gap), np.array(slid), friction, np.zeros((len(gap), 3)))


def test_without_friction_it_is_the_least_energy_with_forces_that_push(rng) -> None:
    """min 1/2 f C f + g f over f >= 0, which non-negative least squares finds too."""
    n = 12
    C = springs(n, rng)
    gap = rng.normal(size=n)
    found = solved(C, gap, np.zeros((n, 2)), 0.0)[:, 0]
    L = np.linalg.cholesky(C[:, 0, :, 0])
    other, _ = nnls(L.T, -np.linalg.solve(L, gap))
    assert_allclose(found, other, atol=1e-5)


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0])
def test_every_cell_obeys_contact_and_coulomb(rng, friction) -> None:
    n = 15
    C, gap, slid = springs(n, rng), rng.normal(size=n), rng.normal(size=(n, 2))
    f = solved(C, gap, slid, friction)
    moved = np.einsum("iajb,jb->ia", C, f)
    g, v = gap + moved[:, 0], slid + moved[:, 1:]
    tangential = np.hypot(*f[:, 1:].T)
    assert f[:, 0].min() >= 0
    assert g.min() > -1e-4
    assert_allclose(f[:, 0] * g, 0, atol=1e-4)
    assert (tangential <= friction * f[:, 0] + 1e-9).all()
    stuck = tangential < friction * f[:, 0] * 0.999
    assert_allclose(v[stuck], 0, atol=1e-3)
    slips = (tangential > 1e-6) & ~stuck
    assert ((f[slips, 1:] * v[slips]).sum(axis=1) <= 1e-6).all()


def test_limits_are_named() -> None:
    with pytest.raises(RangeError, match="friction"):
        solved(springs(1), [0.0], [[0.0, 0.0]], -0.1)
