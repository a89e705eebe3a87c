"""Laws of the spline surface through a lattice's marks."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from palpate.core import InputError, RangeError
from palpate.estimators.surface_strain import surface_basis

COLUMNS, ROWS = 9, 7


def lattice(first=(3, -2)):
    column, row = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    return np.column_stack([column.ravel() + first[0], row.ravel() + first[1]])


def bent(cells):
    c, r = cells.T.astype(float)
    return np.column_stack([2.4 * c + 0.3 * np.sin(0.7 * r), -2.1 * r + 0.2 * np.cos(0.5 * c) + 0.1 * c])


def test_degree_one_is_bilinear_between_the_marks():
    cells = lattice()
    basis = surface_basis(cells, samples=(33, 29))
    surface = basis.sampled(basis.net(bent(cells)))
    axes = np.linspace(0, 1, ROWS), np.linspace(0, 1, COLUMNS)
    v, u = np.meshgrid(basis.v, basis.u, indexing="ij")
    for part, values in zip(surface, bent(cells).T, strict=True):
        np.testing.assert_allclose(
            part, RegularGridInterpolator(axes, values.reshape(ROWS, COLUMNS))((v, u)), atol=1e-5
        )


@pytest.mark.parametrize("degree", [1, 3])
def test_an_affine_lattice_stays_affine_where_marks_are_missing(degree):
    rng = np.random.default_rng(degree)
    cells = lattice()[np.sort(rng.permutation(COLUMNS * ROWS)[:45])]
    A, b = np.array([[2.1, 0.4], [-0.3, 1.7]]), np.array([11.0, -5.0])
    basis = surface_basis(cells, degree, (21, 17))
    net = basis.net(cells @ A.T + b)
    low, length = cells.min(axis=0), np.ptp(cells, axis=0)
    u, v = np.meshgrid(basis.u, basis.v)
    at = low[:, None, None] + length[:, None, None] * np.stack([u, v])
    expected = np.einsum("ab,bij->aij", A, at) + b[:, None, None]
    np.testing.assert_allclose(basis.sampled(net), expected, atol=1e-6)
    for operator, axis in (("u", 0), ("v", 1)):
        slope = np.broadcast_to((A[:, axis] * length[axis])[:, None, None], expected.shape)
        np.testing.assert_allclose(basis.sampled(net, operator), slope, atol=1e-5)


def test_derivatives_are_those_of_the_surface():
    cells, degree = lattice(), 3
    fine = surface_basis(cells, degree, (1601, 5)), surface_basis(cells, degree, (5, 1601))
    for basis, operator, axis in ((fine[0], "u", 2), (fine[1], "v", 1)):
        net = basis.net(bent(cells))
        numeric = np.gradient(basis.sampled(net), 1 / 1600, axis=axis)
        inside = [slice(None)] * 3
        inside[axis] = slice(2, -2)
        np.testing.assert_allclose(
            basis.sampled(net, operator)[tuple(inside)], numeric[tuple(inside)], rtol=2e-3, atol=5e-3
        )


def test_one_missing_mark_is_bridged_and_two_neighbours_leave_their_square_out():
    cells = lattice((0, 0))
    gone = [4 + COLUMNS * 3, 5 + COLUMNS * 3]
    one = surface_basis(np.delete(cells, gone[:1], axis=0), samples=(81, 61))
    two = surface_basis(np.delete(cells, gone, axis=0), samples=(81, 61))
    assert one.supported.all()
    row, column = np.nonzero(~two.supported)
    at = np.column_stack([two.u[column] * (COLUMNS - 1), two.v[row] * (ROWS - 1)])
    assert len(at)
    assert (at >= np.array([4, 2]) - 1e-9).all()
    assert (at <= np.array([5, 4]) + 1e-9).all()


def test_what_is_no_surface_is_refused():
    cells = lattice()
    with pytest.raises(InputError, match="degree"):
        surface_basis(cells, 0)
    with pytest.raises(InputError, match="samples"):
        surface_basis(cells, samples=(1, 5))
    with pytest.raises(InputError, match="knots"):
        surface_basis(cells, cells_per_knot=0.5)
    with pytest.raises(RangeError, match="single row"):
        surface_basis(cells[:COLUMNS])
    with pytest.raises(RangeError, match="three around"):
        surface_basis(np.array([[0, 0], [2, 2], [4, 4], [0, 4]]))
    with pytest.raises(InputError, match="places"):
        surface_basis(cells).net(np.zeros((3, 2)))
