"""Contact of points of one surface with the deformed top of another, in three dimensions, without friction.

Points look down along z at the top, whose facets have eight nodes: with h(x, y) its height at the point's own
place, the gap is g = z - h, and the energy is the integral of a penalty that rises where g < 0. It depends on
the gap alone, so the force is along (-dh/dx, -dh/dy, 1), the normal of the top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from .bricks import AT, OUTSIDE

NEWTON = 8
INSIDE = 1.0 + 1e-9
MARGIN = 0.1  # of a facet's extent, by which its curved sides may leave the box around its nodes


def _powers(x: Float[ndarray, " p"], y: Float[ndarray, " p"]) -> Float[ndarray, "6 p 8"]:
    """The powers an eight-node facet is made of, and their derivatives by x, y, xx, xy, yy."""
    o, i = np.zeros_like(x), np.ones_like(x)
    rows = (
        (i, x, y, x * x, x * y, y * y, x * x * y, x * y * y),
        (o, i, o, 2 * x, y, o, 2 * x * y, y * y),
        (o, o, i, o, x, 2 * y, x * x, 2 * x * y),
        (o, o, o, 2 * i, o, o, 2 * y, o),
        (o, o, o, o, i, o, 2 * x, 2 * y),
        (o, o, o, o, o, 2 * i, o, 2 * x),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows])


_SHAPES = np.linalg.inv(_powers(*AT[OUTSIDE, :2].astype(float).T)[0])


def facet_shapes(xi: Float[ndarray, "p 2"]) -> Float[ndarray, "6 p 8"]:
    """Shape functions of the nodes `AT[OUTSIDE]`, and their derivatives by x, y, xx, xy, yy."""
    return _powers(*xi.T) @ _SHAPES


@dataclass(frozen=True)
class Below:
    """What is below points.

    Attributes:
        facet: of the top; -1 beside it.
        gap: inf there [mm].
        skewed: derivatives of the place on the facet by the point's x and y.
        shapes: of the facet's nodes there, see `facet_shapes`.
        bend: second derivatives along the facet of z - slope . (x, y).
    """

    facet: Int[ndarray, " p"]
    gap: Float[ndarray, " p"]
    normal: Float[ndarray, "p 3"]
    skewed: Float[ndarray, "p 2 2"]
    shapes: Float[ndarray, "6 p 8"]
    bend: Float[ndarray, "p 2 2"]

    def taken(self, which: Int[ndarray, " k"]) -> Below:
        """Some of the points."""
        return Below(
            self.facet[which], self.gap[which], self.normal[which], self.skewed[which],
            self.shapes[:, which], self.bend[which],
        )  # fmt: skip


def below(points: Float[ndarray, "p 3"], top: Float[ndarray, "t 8 3"]) -> Below:
    """The top below points, by the deformed places of its facets' nodes."""
    facet, xi = _looked_up(points[:, :2], top[..., :2])
    nodes, shapes = top[facet], facet_shapes(xi)
    z = np.einsum("pa,pa->p", shapes[0], nodes[..., 2])
    along = np.einsum("dpa,pai->pdi", shapes[1:3], nodes)
    skewed = np.swapaxes(np.linalg.inv(along[..., :2]), 1, 2)  # d xi_a / d x_i
    slope = np.einsum("pai,pa->pi", skewed, along[..., 2])
    normal = np.concatenate([-slope, np.ones((len(points), 1))], axis=1)
    xx, xy, yy = np.einsum("dpa,pai,pi->dp", shapes[3:], nodes, normal)
    bend = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    return Below(facet, np.where(facet < 0, np.inf, points[:, 2] - z), normal, skewed, shapes, bend)


def _looked_up(
    points: Float[ndarray, "p 2"], facets: Float[ndarray, "t 8 2"]
) -> tuple[Int[ndarray, " p"], Float[ndarray, "p 2"]]:
    """Which facet a point is over, -1 for none, and where on it."""
    low, high = facets.min(axis=1), facets.max(axis=1)
    room = MARGIN * (high - low)
    near = ((points[:, None] >= low - room) & (points[:, None] <= high + room)).all(axis=-1)
    p, t = np.nonzero(near)
    xi, nodes = np.zeros((len(p), 2)), facets[t]
    for _ in range(NEWTON):
        shapes = facet_shapes(xi)
        off = points[p] - np.einsum("pa,pai->pi", shapes[0], nodes)
        along = np.einsum("dpa,pai->pdi", shapes[1:3], nodes)
        det = along[:, 0, 0] * along[:, 1, 1] - along[:, 0, 1] * along[:, 1, 0]
        det = np.where(np.abs(det) < 1e-9, np.inf, det)
        move = (
            np.stack(
                [
                    off[:, 0] * along[:, 1, 1] - off[:, 1] * along[:, 1, 0],
                    off[:, 1] * along[:, 0, 0] - off[:, 0] * along[:, 0, 1],
                ],
                axis=1,
            )
            / det[:, None]
        )
        xi = np.clip(xi + move, -1.5, 1.5)
    inside = (np.abs(xi) <= INSIDE).all(axis=1) & (np.abs(off) < 1e-6).all(axis=1)
    facet, where = np.full(len(points), -1), np.zeros((len(points), 2))
    facet[p[inside]], where[p[inside]] = t[inside], xi[inside]
    return facet, where


def pressed(
    found: Below,
    shapes: Float[ndarray, "p 8"],
    axes: Float[ndarray, "3 3"],
    load: Float[ndarray, " p"],
    stiff: Float[ndarray, " p"],
    turning: bool = True,
) -> tuple[Float[ndarray, "p 48"], Float[ndarray, "p 48 48"]]:
    """Forces out of balance, and their stiffness, on a point's eight nodes and then those of its facet.

    Args:
        found: below the points.
        shapes: of the nodes that carry each point.
        axes: x, y, z here, in the axes along which these nodes move.
        load: pressure times area [N].
        stiff: how this rises with overlap [N/mm].
        turning: whether the stiffness is exact; else it leaves out that the top's normal turns.
    """
    p, N, D = len(load), found.shapes[0], found.shapes[1:3]
    first = np.zeros((p, 16, 3))
    first[:, :8] = shapes[..., None] * (found.normal @ axes)[:, None]
    first[:, 8:] = -N[..., None] * found.normal[:, None]
    moved, tilted = np.zeros((2, p, 2, 16, 3))
    moved[:, :, :8] = shapes[:, None, :, None] * (found.skewed @ axes[:2])[:, :, None]
    moved[:, :, 8:, :2] = -N[:, None, :, None] * found.skewed[:, :, None]
    tilted[:, :, 8:] = np.swapaxes(D, 0, 1)[..., None] * found.normal[:, None, None]
    rows = np.concatenate([first[:, None], moved, tilted], axis=1).reshape(p, 5, 48)
    how = np.zeros((p, 5, 5))
    how[:, 0, 0] = stiff
    if turning:
        how[:, 1:3, 1:3] = load[:, None, None] * found.bend
        for a in (1, 2):
            how[:, a, a + 2] = how[:, a + 2, a] = load
    return -load[:, None] * rows[:, 0], np.swapaxes(rows, 1, 2) @ (how @ rows)
