"""Bodies of revolution by Fourier modes: reciprocity, scaling, and loads that are known otherwise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.core.errors import InputError, RangeError
from palpate.mechanics.axisymmetric.axisymmetric_fem import RevolvedBody, tensor_mesh
from palpate.mechanics.axisymmetric.tilted_tip import tip_modes, top_modes


def block(E=1e5, nu=0.3, cells=(12, 10), radius=0.02, height=0.03) -> RevolvedBody:
    mesh = tensor_mesh(np.linspace(0, radius, cells[0] + 1), np.linspace(-height, 0, cells[1] + 1))
    held = np.flatnonzero(np.isclose(mesh.doflocs[1], -height))
    return RevolvedBody(mesh, np.full(mesh.t.shape[1], E), nu, held)


def top_of(body: RevolvedBody) -> np.ndarray:
    r, z = body.places_m.T
    nodes = np.flatnonzero(np.isclose(z, 0.0, atol=1e-12))
    return nodes[np.argsort(r[nodes])]


@pytest.mark.parametrize("mode", [0, 1, 2, 7])
def test_what_a_moves_at_b_is_what_b_moves_at_a(mode) -> None:
    body = block()
    top = top_of(body)[1:]
    C = body.compliance(mode, top, top).reshape(3 * len(top), -1)
    assert_allclose(C, C.T, atol=1e-9 * abs(C).max())
    assert np.linalg.eigvalsh((C + C.T) / 2).min() > -1e-9 * abs(C).max()


def test_a_slender_column_shortens_and_bends_as_beams_do() -> None:
    """Bonded base, length 12 radii: P L / E A in mode 0, F L^3 / 3 E I (and a little shear) in mode 1."""
    a, L, E, nu = 0.01, 0.12, 1e6, 0.3
    body = block(E, nu, (4, 48), a, L)
    top = top_of(body)
    weights = _ring_weights(body, top)
    C0, C1 = (body.compliance(m, top, top) for m in (0, 1))
    shortened = np.einsum("i,ij,j->", weights, C0[:, 2, :, 2], weights) / (2 * np.pi)
    assert_allclose(shortened, L / (E * np.pi * a**2), rtol=0.02)
    # a unit force along x: amplitude 1/pi along r and -1/pi around, weighed over the face
    push = np.stack([weights, -weights, 0 * weights], axis=1) / (2 * np.pi)
    moved = np.einsum("iajb,jb->ia", C1, push)
    bent = float(weights @ (moved[:, 0] - moved[:, 1]) / 2)
    beam = L**3 / (3 * E * np.pi * a**4 / 4)
    assert_allclose(bent, beam, rtol=0.05)


def _ring_weights(body: RevolvedBody, top: np.ndarray) -> np.ndarray:
    """Shares of an even load on the face, by ring of nodes (Simpson's rule a cell)."""
    r = body.places_m[top, 0]
    w = np.zeros(len(top))
    for i in range(0, len(top) - 2, 2):
        h = r[i + 2] - r[i]
        w[i : i + 3] += np.array([1, 4, 1]) / 6 * h * r[i : i + 3]
    return w / w.sum()


def test_a_point_load_on_a_wide_block_moves_its_top_as_boussinesq_says() -> None:
    """Between 2 and 4 mm from the load the finite block adds the same to both, so differences are his."""
    E, nu, P = 1e5, 0.45, 1.0
    body = block(E, nu, (40, 24), 0.04, 0.08)
    top = top_of(body)
    r = body.places_m[top, 0]
    w = body.compliance(0, top[:1], top)[:, 2, 0, 2] * P / (2 * np.pi)
    near, far = (int(np.argmin(abs(r - at))) for at in (0.004, 0.008))
    want = (1 - nu**2) * P / (np.pi * E) * (1 / r[near] - 1 / r[far])
    assert_allclose(w[near] - w[far], want, rtol=0.06)


def test_nonsense_is_refused() -> None:
    body = block()
    with pytest.raises(InputError, match="mode"):
        body.compliance(-1, top_of(body), top_of(body))
    with pytest.raises(RangeError, match="thinner"):
        tip_modes(0.02, 0.02, 1e5, 1e5, 0.48)
    with pytest.raises(RangeError, match="positive"):
        top_modes(0.02, 0.04, -1.0, 0.48)
