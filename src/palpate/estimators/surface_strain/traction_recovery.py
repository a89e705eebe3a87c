"""Traction on a layered skin from the motion of its pattern, and its integral, the force.

Loads at nodes about the contact, never pulling, move the marks by the layers' response
(`mechanics.layers.stack`); they are the least-squares fit with Tikhonov's penalty on neighbor differences. A
camera sees two components, into which depth enters by perspective, u_z X/D; a closure gives the third:

    frictionless    q = 0
    coulomb         |q| <= mu p at every node, as smooth as possible
    bonded          the surface under pressure moves as one

Moduli and layers are taken as known: an image alone identifies p/E, not p.

References: A. N. Tikhonov, Soviet Math. Dokl. 4, 1035 (1963); C. L. Lawson and R. J. Hanson, Solving Least
Squares Problems (1974), chapter 23, for loads that are never negative, doi:10.1137/1.9781611971217.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args, no_type_check

import numba
import numpy as np
from scipy import fft
from scipy.ndimage import label, spline_filter
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from palpate.core import Bool, Float, InputError, RangeError, ndarray
from palpate.estimators.surface_strain.ring_detection import (
    ContactPeak,
    contact_peaks,
    mark_pitch,
    stretch_over_noise,
)
from palpate.estimators.surface_strain.strain_fields import StrainFields
from palpate.mechanics.layers.influence import plane_response
from palpate.mechanics.layers.stack import Stack

Closure = Literal["frictionless", "coulomb", "bonded"]
Matrix = Float[ndarray, "_ _"]
Points = Float[ndarray, "_ 2"]

CELL_M, SIDE = 0.4e-3, 256  # of the periodic grid on which a node's motion is computed
NODE_M = {"frictionless": 0.8e-3, "coulomb": 1.2e-3, "bonded": 1.2e-3}
REACH_M = 1e-3  # of nodes beyond where the skin stretches
STRETCHED = 0.3  # of the greatest area strain
LOST_BESIDE = 3.0  # pitches from a peak, within which lost marks may lie under the contact
STEP_PA = 2e5  # of pressure between neighbours that weighs as one standard error of a mark
DIRECTIONS = 8  # of friction's polygon inside its circle
PRESSED = 0.05  # of the greatest pressure: where a bonded contact is
PRESSING = 2  # of the loads: pressure, after shear along x and y
MAX_NODES = 900
MAX_BOX = 4000  # nodes of the box around them


@dataclass(frozen=True, slots=True)
class PatternedSkin:
    """What recovery takes as known of a skin.

    Attributes:
        interface: Number of layers above the pattern.
        camera_m: Distance of the camera from the pattern; infinite for in-plane motion only [m].
        friction: Coulomb's coefficient.
    """

    stack: Stack
    interface: int
    camera_m: float = math.inf
    friction: float = 0.5

    def __post_init__(self) -> None:
        if not 0 <= self.interface <= len(self.stack.layers) - 1:
            raise InputError(
                f"{self.interface} layers above the pattern, of {len(self.stack.layers)}", code="layer-count"
            )
        if not (self.camera_m > 0 and 0 < self.friction < math.inf):
            raise RangeError("the camera's distance and friction are positive; give m, and a plain number")


@dataclass(frozen=True, slots=True, eq=False)
class RecoveredTraction:
    """Traction of the probe at nodes, and its integrals; errors are from the marks' noise alone.

    Attributes:
        nodes_m: (x, y) ``[n 2]`` [m].
        spacing_m: Distance of neighbors [m].
        pressure_pa: Pressure into the skin ``[n]`` [Pa].
        shear_pa: Shear along x and y ``[n 2]`` [Pa].
        centre_m: Center of pressure (x, y) [m].
        axis_rad: Principal axis of the pressure, from x towards y; its error is infinite for a round contact.
        elongation: Length over width of the pressure (standard deviations).
        moved: Shift of the pattern at the center along x and y [m], and its rotation from x to y [rad].
        torque_nm: Moment of the shear about the center of pressure, from x towards y [N m].
        unexplained_m: Residual shift of each mark ``[n 2]`` [m].
        misfit: RMS of the residuals over their standard error.
    """

    nodes_m: Points
    spacing_m: float
    pressure_pa: Float[ndarray, " n"]
    shear_pa: Points
    force_n: float
    force_error_n: float
    centre_m: tuple[float, float]
    centre_error_m: tuple[float, float]
    axis_rad: float
    axis_error_rad: float
    elongation: float
    moved: tuple[float, ...]
    moved_error: tuple[float, ...]
    lateral_n: tuple[float, float]
    torque_nm: float
    unexplained_m: Points
    misfit: float
    closure: str


def recover_traction(
    fields: StrainFields,
    skin: PatternedSkin,
    closure: str = "frictionless",
    step_pa: float = STEP_PA,
    peaks: list[ContactPeak] | None = None,
) -> RecoveredTraction | None:
    """Return the traction under a frame's marks; None without contact.

    Args:
        fields: Strain fields of marks in m, from the camera's axis.
        skin: Known mechanics.
        closure: Assumption about the third component.
        step_pa: Difference of neighboring pressures that counts as one standard error.
        peaks: The frame's `contact_peaks`, if known.
    """
    if fields.unit != "m":
        raise InputError("traction needs marks in m; use on_plane", code="unit-differs")
    if closure not in get_args(Closure):
        raise InputError(
            f"closure {closure!r}; there are {', '.join(get_args(Closure))}", code="unknown-name"
        )
    if not 0 < step_pa < math.inf:
        raise RangeError(f"a step of {step_pa} Pa; give a positive number of Pa", code="not-positive")
    variance = fields.variances.sum(axis=0)
    if not (variance > 0).all():
        raise InputError("standard errors of marks must be above 0", code="standard-errors")
    peaks = contact_peaks(fields) if peaks is None else peaks
    if not peaks:
        return None
    spacing = NODE_M[closure]
    nodes, neighbours = _nodes(fields, peaks, spacing)
    weight = 1 / np.sqrt(np.tile(variance, 2))
    first = PRESSING if closure == "frictionless" else 0  # of the loads that there can be
    G = [part * weight[:, None] for part in _motion(skin, skin.interface, fields.rest, nodes, spacing, first)]
    seen = fields.moved.T.ravel() * weight
    smooth = neighbours / step_pa
    to_loads, rows, sides = _closed(skin, closure, G, seen, smooth, nodes, spacing, float(weight.mean()))
    n = len(nodes)
    moving = sum(G[i] @ to_loads[i * n : (i + 1) * n] for i in range(first, 3))
    held = [smooth @ to_loads[i * n : (i + 1) * n] for i in range(first, 3)]
    M = np.concatenate([moving, *held, *rows])
    loads, _ = nnls(
        M, np.concatenate([seen, np.zeros(len(held) * len(smooth)), *sides]), maxiter=50 * M.shape[1]
    )
    qx, qy, p = (to_loads @ loads).reshape(3, n)
    area = spacing**2
    used = loads > 0
    inverse = np.linalg.pinv(M[:, used].T @ M[:, used], hermitian=True)
    to_force = area * to_loads[2 * n :, used].sum(axis=0)
    total = max(float(p.sum()), 1e-300)
    centre = (p @ nodes) / total
    arms = nodes - centre
    to_centre = arms.T @ to_loads[2 * n :, used] / total
    centre_error = np.sqrt(np.einsum("ij,jk,ik->i", to_centre, inverse, to_centre))
    return RecoveredTraction(
        nodes,
        spacing,
        p,
        np.column_stack([qx, qy]),
        area * float(p.sum()),
        math.sqrt(float(to_force @ inverse @ to_force)),
        (float(centre[0]), float(centre[1])),
        (float(centre_error[0]), float(centre_error[1])),
        *_principal_axis(arms, p, to_loads[2 * n :, used], inverse),
        *_amid(_middle_motion(skin, nodes - centre, spacing) @ to_loads, loads, used, inverse),
        (area * float(qx.sum()), area * float(qy.sum())),
        area * float((arms[:, 0] * qy - arms[:, 1] * qx).sum()),
        ((seen - moving @ loads) / weight).reshape(2, -1).T,
        math.sqrt(float(((moving @ loads - seen) ** 2).mean())),
        closure,
    )


def _middle_motion(skin: PatternedSkin, away: Points, spacing: float) -> Matrix:
    """Shift and rotation of the pattern amid nodes under unit loads q_x, q_y, and p."""
    h = spacing / 2
    at = 1 + h * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    flat = PatternedSkin(skin.stack, skin.interface)
    moved = np.concatenate(_motion(flat, skin.interface, at, away + 1, spacing), axis=1)
    x, y = moved[:5], moved[5:]
    return np.stack([x[0], y[0], (y[1] - y[2] - x[3] + x[4]) / (4 * h)])


def _principal_axis(
    arms: Points, p: Float[ndarray, " n"], to_pressure: Matrix, inverse: Matrix
) -> tuple[float, float, float]:
    """Principal axis of the pressure [rad], its standard error, and length over width."""
    total = max(float(p.sum()), 1e-300)
    (xx, xy), (_, yy) = (arms * p[:, None]).T @ arms / total
    half, middle = math.hypot((xx - yy) / 2, xy), (xx + yy) / 2
    angle = math.atan2(2 * xy, xx - yy) / 2
    along, across = arms @ [math.cos(angle), math.sin(angle)], arms @ [-math.sin(angle), math.cos(angle)]
    slope = (along * across) @ to_pressure / total
    error = math.sqrt(max(float(slope @ inverse @ slope), 0.0)) / (2 * half) if half > 0 else math.inf
    return angle, error, math.sqrt((middle + half) / max(middle - half, 1e-12 * middle + 1e-300))


def _amid(
    motion: Matrix, loads: Float[ndarray, " _"], used: ndarray, inverse: Matrix
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Shift and rotation of the center, with standard errors."""
    of_used = motion[:, used]
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", of_used, inverse, of_used), 0.0))
    return tuple((motion @ loads).tolist()), tuple(errors.tolist())


def _closed(
    skin: PatternedSkin, closure: str, G: list[Matrix], seen: Float[ndarray, " _"], smooth: Matrix,
    nodes: Points, spacing: float, weight: float,
) -> tuple[Matrix, list[Matrix], list[Float[ndarray, " _"]]]:  # fmt: skip
    """Loads (q_x, q_y, p) as a map of non-negative unknowns, and further equations."""
    n = len(nodes)
    one, zero = np.eye(n), np.zeros((n, n))
    if closure == "frictionless":
        return np.concatenate([zero, zero, one]), [], []
    if closure == "coulomb":  # every load within a cone is a sum of its edges
        angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        edges = [
            np.concatenate([skin.friction * f(a) * one for f in (np.cos, np.sin)] + [one]) for a in angles
        ]
        return np.concatenate([np.concatenate([zero, zero, one]), *edges], axis=1), [], []
    M = np.concatenate([G[2], smooth])
    pressure, _ = nnls(M, np.concatenate([seen, np.zeros(len(smooth))]))
    inside = pressure > PRESSED * pressure.max()
    signs = [np.concatenate([s * one if i == j else zero for i in range(3)]) for j in (0, 1) for s in (1, -1)]
    outside = np.tile(~inside, 4)
    to_loads = np.concatenate(
        [np.concatenate([zero, zero, one]), np.concatenate(signs, axis=1)[:, ~outside]], axis=1
    )
    flat = PatternedSkin(skin.stack, skin.interface)
    surface = _motion(flat, 0, nodes[inside], nodes, spacing)
    moves = sum(surface[i] @ to_loads[i * n : (i + 1) * n] for i in range(3)) * weight
    for half in np.split(np.arange(len(moves)), 2):
        moves[half] -= moves[half].mean(axis=0)  # all may move alike
    return to_loads, [moves], [np.zeros(len(moves))]


def _nodes(fields: StrainFields, peaks: list[ContactPeak], spacing: float) -> tuple[Points, Matrix]:
    """Nodes about stretched or lost marks near a peak, and differences of neighbors."""
    pitch = mark_pitch(fields)
    away = np.min([np.hypot(fields.at[0] - p.x, fields.at[1] - p.y) for p in peaks], axis=0)
    stretch = np.nan_to_num(fields.area_strain, nan=-np.inf)
    patches, _ = label(stretch > STRETCHED * stretch.max())
    coarse, smooth, least, _ = stretch_over_noise(fields, pitch)
    cell = np.ones([part.step for part in coarse], bool)  # of the samples about each coarse one
    stands_out = np.kron(smooth > least, cell)[: stretch.shape[0], : stretch.shape[1]]
    with_contact = np.unique(patches[stands_out | (away < pitch)])
    stretched = np.isin(patches, with_contact[with_contact > 0])
    high = stretched if stretched.any() else away < pitch
    high = fields.at[:, high | (~fields.basis.supported & (away < LOST_BESIDE * pitch))]
    low, top = high.min(axis=1) - REACH_M, high.max(axis=1) + REACH_M
    x, y = (np.arange(a, b + spacing, spacing) for a, b in zip(low, top, strict=True))
    if len(x) * len(y) > MAX_BOX:
        raise RangeError(
            f"the contact spans {1e3 * np.ptp(x):.0f} x {1e3 * np.ptp(y):.0f} mm; give a clearer frame"
        )
    X, Y = np.meshgrid(x, y)
    nodes = np.column_stack([X.ravel(), Y.ravel()])
    inside = np.ones(len(nodes), bool)
    if np.linalg.matrix_rank(high - high[:, :1], tol=spacing / 10) == 2:
        sides = ConvexHull(high.T).equations
        inside = (nodes @ sides[:, :2].T + sides[:, 2] <= REACH_M).all(axis=1)
    if inside.sum() > MAX_NODES:
        raise RangeError(
            f"the contact covers {1e6 * inside.sum() * spacing**2:.0f} mm2, over {MAX_NODES} nodes; give a "
            "clearer frame"
        )
    return nodes[inside], _differences(inside.reshape(len(y), len(x)))


def _differences(inside: Bool[ndarray, "ny nx"]) -> Matrix:
    """Differences of neighbors in a row, then in a column, and of edges to 0 beyond."""
    number = np.pad(np.where(inside, np.cumsum(inside).reshape(inside.shape) - 1, -1), 1, constant_values=-1)
    pairs = [
        np.stack([number[1:-1, :-1].ravel(), number[1:-1, 1:].ravel()]),
        np.stack([number[:-1, 1:-1].ravel(), number[1:, 1:-1].ravel()]),
    ]
    lower, upper = np.concatenate(pairs, axis=1)
    some = (lower >= 0) | (upper >= 0)
    lower, upper = lower[some], upper[some]
    differences = np.zeros((len(lower), int(inside.sum())))
    for which, sign in ((lower, -1.0), (upper, 1.0)):
        there = np.nonzero(which >= 0)[0]
        differences[there, which[there]] = sign
    return differences


def _motion(
    skin: PatternedSkin, interface: int, at: Points, nodes: Points, spacing: float, first: int = 0
) -> list[Matrix]:
    """Motion seen by a camera, x then y, under unit loads q_x, q_y, and p at nodes [m/Pa]."""
    tilt = np.zeros_like(at) if math.isinf(skin.camera_m) else at / skin.camera_m
    return list(_seen_motion(_node_motion(skin.stack, interface, spacing), at, nodes, tilt, CELL_M, first))


@numba.njit(cache=True, nogil=True)
@no_type_check
def _seen_motion(knots, at, nodes, tilt, cell, first_load):
    """Motion of positions by loads at nodes ``[load, 2 at, node]``, by nine cubic splines."""
    count, side = at.shape[0], knots.shape[0]
    seen = np.zeros((3, 2 * count, nodes.shape[0]))
    weight, cells = np.empty((2, 4)), np.empty(2, np.int64)
    for n in range(nodes.shape[0]):
        for k in range(count):
            inside = True
            for axis in range(2):
                place = (at[k, axis] - nodes[n, axis]) / cell + side / 2
                first = np.floor(place)
                t = place - first
                cells[axis] = np.int64(first) - 1
                inside = inside and cells[axis] >= 0 and cells[axis] + 3 < side
                weight[axis, 0] = (1 - t) ** 3 / 6
                weight[axis, 1] = (4 - 6 * t * t + 3 * t**3) / 6
                weight[axis, 3] = t**3 / 6
                weight[axis, 2] = 1 - weight[axis, 0] - weight[axis, 1] - weight[axis, 3]
            if not inside:
                continue
            for load in range(first_load, 3):
                x = y = z = 0.0
                for b in range(4):
                    for a in range(4):
                        share, knot = weight[1, b] * weight[0, a], knots[cells[1] + b, cells[0] + a, load]
                        x += share * knot[0]
                        y += share * knot[1]
                        z += share * knot[2]
                seen[load, k, n] = x + tilt[k, 0] * z
                seen[load, count + k, n] = y + tilt[k, 1] * z
    return seen


@lru_cache(maxsize=8)
def _node_motion(stack: Stack, interface: int, spacing: float) -> Float[ndarray, "side side load component"]:
    """Cubic splines of the motion about a node whose load falls to 0 at its neighbors."""
    plane = plane_response(stack, interface, SIDE, CELL_M)
    k_x, k_y = fft.rfftfreq(SIDE, CELL_M), fft.fftfreq(SIDE, CELL_M)[:, None]
    hat = (np.sinc(k_x * spacing) * np.sinc(k_y * spacing) * spacing / CELL_M) ** 2
    responses = (
        (plane.xx, plane.xy, 1j * plane.pressed_x),
        (plane.xy, plane.yy, 1j * plane.pressed_y),
        (-1j * plane.lifted_x, -1j * plane.lifted_y, plane.zz),
    )
    splines = [
        [
            spline_filter(fft.fftshift(fft.irfft2(responses[i][load] * hat, (SIDE, SIDE))), order=3)
            for i in range(3)
        ]
        for load in range(3)
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(splines), (0, 1), (2, 3)))
