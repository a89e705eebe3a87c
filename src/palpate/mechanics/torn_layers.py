"""Displacement jump on a cut of finite length under a surface load, and the motion it adds to a plane.

The cut is the plane x = 0 from the surface to a depth. A jump b = u(0+) - u(0-) makes a balanced field R b;
motions are odd or even in x. K b is the traction on the faces, and by reciprocity K b = R^T p under a surface
load p on stress-free faces. Along the cut the stiffness between points is the transform of
`CutResponse.stiffness`.

At rest the faces have an elliptic gap. Faces in contact push without friction and never pull,

    w = jump across + gap >= 0,    p >= 0,    w p = 0,

by active sets (M. Hintermueller, K. Ito and K. Kunisch, SIAM J. Optim. 13, 865 (2002),
doi:10.1137/S1052623401383558).

Finite elements across a stack of layers for motion that is a wave along it.

A motion (U, i V, W)(x, z) exp(i k y) on the half strip x > 0 has strains

    xx = U,x    yy = -k V    zz = W,z    xy = k U + V,x    yz = k W + V,z    xz = U,z + W,x,

so the stiffness is real and K0 + k K1 + k^2 K2. Elements are Q2-P1 against volumetric locking (D. Boffi, F.
Brezzi and M. Fortin, Mixed Finite Element Methods and Applications, 2013, section 8.6.3,
doi:10.1007/978-3-642-36519-5).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy import fft, sparse
from scipy.interpolate import CubicSpline
from scipy.linalg import inv
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import splu

from palpate.core import Bool, Float, InputError, Int, RangeError, ndarray
from palpate.mechanics.layers.stack import Stack

NODES = 3  # along each side of an element
GAUSS_AT = (-(0.6**0.5), 0.0, 0.6**0.5)
GAUSS_WEIGHT = (5 / 9, 8 / 9, 5 / 9)

Columns = Float[ndarray, " x"]
Rows = Float[ndarray, " z"]
Matrix = Any  # of scipy.sparse, by columns


@dataclass(frozen=True, slots=True, eq=False)
class StripMesh:
    """Rectangles of nine nodes; node (column, row) has the number column * rows + row.

    Attributes:
        sides_m: Element sides along x, from 0 [m].
        levels_m: Element sides along z, from the surface to the rigid floor [m].
        mu_pa, lambda_pa: Lamé constants of each row [Pa].
    """

    sides_m: Columns
    levels_m: Rows
    mu_pa: Float[ndarray, " rows"]
    lambda_pa: Float[ndarray, " rows"]

    @property
    def x_m(self) -> Columns:
        return _with_middles(self.sides_m)

    @property
    def z_m(self) -> Rows:
        return _with_middles(self.levels_m)

    @property
    def count(self) -> int:
        """Number of unknowns: U, V, W of each node."""
        return 3 * len(self.x_m) * len(self.z_m)

    def unknowns(self, column: int, part: int) -> Int[ndarray, " z"]:
        """U (0), V (1), or W (2) of a column of nodes, from the surface down."""
        rows = len(self.z_m)
        return 3 * (column * rows + np.arange(rows)) + part

    def row(self, row: int) -> Int[ndarray, "3 x"]:
        """U, V, W of a row of nodes."""
        nodes = np.arange(len(self.x_m)) * len(self.z_m) + row
        return 3 * nodes + np.arange(3)[:, None]

    @property
    def held(self) -> Bool[ndarray, " n"]:
        """Unknowns that are 0: on the floor and at the far end."""
        fixed = np.zeros((len(self.x_m), len(self.z_m), 3), bool)
        fixed[:, -1] = fixed[-1] = True
        return fixed.ravel()


def _with_middles(edges: ndarray) -> ndarray:
    nodes = np.empty(2 * len(edges) - 1)
    nodes[::2], nodes[1::2] = edges, (edges[1:] + edges[:-1]) / 2
    return nodes


def graded(first_m: float, growth: float, last_m: float, end_m: float) -> Columns:
    """Return element sides from 0 to an end that grow from a first to a last size [m]."""
    if not (0 < first_m <= last_m <= end_m and growth >= 1):
        raise InputError(
            f"elements from {first_m:g} to {last_m:g} m, growing by {growth:g}, up to {end_m:g} m; give "
            "sizes above 0 that rise and a growth of 1 or more"
        )
    sides, size = [0.0], first_m
    while sides[-1] < end_m:
        sides.append(sides[-1] + size)
        size = min(size * growth, last_m)
    return np.array(sides) * (end_m / sides[-1])


class StripStiffness:
    """Stiffness of a mesh at any wavenumber along the strip."""

    def __init__(self, mesh: StripMesh) -> None:
        self.mesh = mesh

    def at(self, k: float) -> Matrix:
        """Stiffness per length along y at a wavenumber [1/m]."""
        constant, linear, square = self._powers
        return sparse.csc_matrix(constant + k * linear + k**2 * square)

    @cached_property
    def _powers(self) -> tuple[Matrix, Matrix, Matrix]:
        mesh = self.mesh
        nx, nz = len(mesh.sides_m) - 1, len(mesh.levels_m) - 1
        wide, high = np.diff(mesh.sides_m), np.diff(mesh.levels_m)
        stiff = [np.zeros((nx, nz, 27, 27)) for _ in range(3)]
        for i, size_x in enumerate(wide):
            for j, size_z in enumerate(high):
                for part, element in zip(
                    stiff, _element(size_x, size_z, mesh.mu_pa[j], mesh.lambda_pa[j]), strict=True
                ):
                    part[i, j] = element
        rows = len(mesh.z_m)
        corner = (2 * np.arange(nx)[:, None] * rows + 2 * np.arange(nz))[..., None]
        inside = (np.arange(NODES)[:, None] * rows + np.arange(NODES)).ravel()
        of = (3 * (corner + inside)[..., None] + np.arange(3)).reshape(nx, nz, 27)
        down = np.broadcast_to(of[..., :, None], stiff[0].shape).ravel()
        across = np.broadcast_to(of[..., None, :], stiff[0].shape).ravel()
        shape = (mesh.count, mesh.count)
        constant, linear, square = (
            sparse.csc_matrix((part.ravel(), (down, across)), shape=shape) for part in stiff
        )
        return constant, linear, square


def _shapes(at: float) -> tuple[ndarray, ndarray]:
    """Three quadratic shapes and their slopes on -1 to 1."""
    return (
        np.array([at * (at - 1) / 2, 1 - at**2, at * (at + 1) / 2]),
        np.array([at - 0.5, -2 * at, at + 0.5]),
    )


def _element(wide: float, high: float, mu: float, lam: float) -> Sequence[ndarray]:
    """Stiffness of one rectangle, for the powers 0, 1, and 2 of k."""
    weights = mu * np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    stiff = [np.zeros((27, 27)) for _ in range(3)]
    grown, mass = [np.zeros((3, 27)), np.zeros((3, 27))], np.zeros((3, 3))
    for a, weight_a in zip(GAUSS_AT, GAUSS_WEIGHT, strict=True):
        for b, weight_b in zip(GAUSS_AT, GAUSS_WEIGHT, strict=True):
            area = weight_a * weight_b * wide * high / 4
            (along, slope), (down, steep) = _shapes(a), _shapes(b)
            N = np.outer(along, down).ravel()
            N_x, N_z = np.outer(slope, down).ravel() * 2 / wide, np.outer(along, steep).ravel() * 2 / high
            still, waved = np.zeros((6, 27)), np.zeros((6, 27))
            still[0, 0::3], still[2, 2::3] = N_x, N_z
            still[3, 1::3], still[4, 1::3] = N_x, N_z
            still[5, 0::3], still[5, 2::3] = N_z, N_x
            waved[1, 1::3], waved[3, 0::3], waved[4, 2::3] = -N, N, N
            once = still.T @ (weights[:, None] * waved)
            stiff[0] += area * still.T @ (weights[:, None] * still)
            stiff[1] += area * (once + once.T)
            stiff[2] += area * waved.T @ (weights[:, None] * waved)
            linear = np.array([1.0, a, b])
            mass += area * np.outer(linear, linear)
            for sum_of, strain in zip(grown, (still, waved), strict=True):
                sum_of += area * np.outer(linear, strain[:3].sum(axis=0))
    inverse = lam * np.linalg.inv(mass)
    still, waved = grown
    once = still.T @ inverse @ waved
    return (
        stiff[0] + still.T @ inverse @ still,
        stiff[1] + once + once.T,
        stiff[2] + waved.T @ inverse @ waved,
    )


ALONG_CELL_M = 0.6e-3  # spacing of points along the cut
ALONG_CELLS = 128  # points of the period along it (77 mm)
SOLVED_WAVES = 18  # solved wavenumbers; others are interpolated
FIRST_M, GROWTH, LAST_M = 0.12e-3, 1.14, 6e-3  # widths of elements from the cut outwards
END_M = 90e-3  # far end of the mesh
ROW_M = 0.27e-3  # element height at the cut; three times that below
MIN_CUT_SHARE = 0.05  # minimum depth over the stack's thickness


@dataclass(frozen=True, slots=True, eq=False)
class CutResponse:
    """Response to a jump, by wavenumber along the cut.

    Attributes:
        x_m: Distances from the cut [m].
        cut_z_m: Depths of the jump, 0 at the cut's end [m].
        stiffness: Hermitian stiffness between jumps (component, depth), per length along the cut [Pa].
        surface, plane: Motion x, y, z of the surface and of a plane per jump.
    """

    k: Float[ndarray, " k"]
    x_m: Float[ndarray, " x"]
    cut_z_m: Float[ndarray, " z"]
    stiffness: ndarray
    surface: ndarray
    plane: ndarray


def strip_mesh(stack: Stack, cut_m: float, finer: float = 1.0) -> StripMesh:
    """Return the mesh of a stack with an edge at a cut's end; `finer` divides the element sizes."""
    total = stack.thickness_m
    if not (total < np.inf and MIN_CUT_SHARE * total <= cut_m < total):
        raise InputError(
            f"a cut of {1e3 * cut_m:g} mm in a stack of {1e3 * total:g} mm; a cut is "
            f"{MIN_CUT_SHARE:.0%} of the stack's thickness or more and ends above its floor",
            code="cut-depth",
        )
    faces = np.concatenate([[0.0], np.cumsum([slab.thickness_m for slab in stack.slabs])])
    edges = np.unique(np.append(faces, cut_m))
    edges = edges[np.append(True, np.diff(edges) > 1e-9 * total)]
    levels = [0.0]
    for top, bottom in pairwise(edges):
        size = (ROW_M if top < cut_m * (1 - 1e-9) else 3 * ROW_M) / finer
        parts = int(np.ceil((bottom - top) / size - 1e-9))
        levels.extend(np.linspace(top, bottom, parts + 1)[1:])
    middles = (np.array(levels[1:]) + np.array(levels[:-1])) / 2
    of = np.searchsorted(faces, middles) - 1
    mu = np.array([stack.layers[i].material.mu for i in of])
    nu = np.array([stack.layers[i].material.nu for i in of])
    sides = graded(FIRST_M / finer, GROWTH ** (1 / finer), LAST_M / finer, END_M)
    return StripMesh(sides, np.array(levels), mu, 2 * mu * nu / (1 - 2 * nu))


def wave_response(
    strip: StripStiffness, k: float, cut_m: float, plane_m: float
) -> tuple[ndarray, ndarray, ndarray]:
    """Return stiffness ``[3z 3z]`` [Pa] and motion of surface and plane ``[3 x 3z]``, V for
    u_y, of one wave.
    """
    mesh = strip.mesh
    z = mesh.z_m
    cut = z < cut_m * (1 - 1e-9)
    count, K = int(cut.sum()), strip.at(k)
    level = int(np.abs(z - plane_m).argmin())
    stiffness = np.zeros((3 * count, 3 * count))
    surface, plane = (np.zeros((3, len(mesh.x_m), 3 * count)) for _ in range(2))
    for parts in ((0,), (1, 2)):
        given = np.concatenate([mesh.unknowns(0, part)[:-1][cut[:-1]] for part in parts])
        held = mesh.held
        held[np.concatenate([mesh.unknowns(0, part) for part in parts])] = True
        free = np.flatnonzero(~held)
        to_given = K[:, given]
        solved = splu(K[free][:, free]).solve(-to_given[free].toarray())
        moved = np.zeros((mesh.count, len(given)))
        moved[free], moved[given] = solved, np.eye(len(given))
        mine = np.concatenate([np.arange(count) + part * count for part in parts])
        stiffness[np.ix_(mine, mine)] = (K[given] @ moved) / 2
        surface[:, :, mine] = moved[mesh.row(0)] / 2
        plane[:, :, mine] = moved[mesh.row(level)] / 2
    return (stiffness + stiffness.T) / 2, surface, plane


@lru_cache(maxsize=4)
def cut_response(stack: Stack, cut_m: float, plane_m: float, finer: float = 1.0) -> CutResponse:
    """Return the response of a stack to jumps on a cut at every wave of its period (cached); `plane_m` is an
    interface.
    """
    mesh = strip_mesh(stack, cut_m, finer)
    strip = StripStiffness(mesh)
    k = 2 * np.pi * np.fft.rfftfreq(ALONG_CELLS, ALONG_CELL_M)
    t = np.linspace(0.0, 1.0, SOLVED_WAVES)
    rows = [wave_response(strip, float(one), cut_m, plane_m) for one in k[-1] * t**2]
    at = np.sqrt(k / k[-1])
    stiffness, surface, plane = (CubicSpline(t, np.stack(part))(at) for part in zip(*rows, strict=True))
    z = mesh.z_m[mesh.z_m < cut_m * (1 - 1e-9)]
    turn = np.repeat([1.0, -1.0j, 1.0], len(z))  # V = -i u_y, of jumps
    back = np.array([1.0, 1.0j, 1.0])[:, None, None]  # u_y = i V, of motions
    return CutResponse(
        k,
        mesh.x_m,
        z,
        turn.conj()[:, None] * stiffness * turn,
        back * surface * turn,
        back * plane * turn,
    )


STEP_M = (0.1e-3, 0.15e-3)  # steps of the plane's grid from the cut and along it
REACH_M = 30e-3  # extent of that grid from the cut
SETS = 40  # maximum active-set iterations
FINER = round(ALONG_CELL_M / STEP_M[1])

Points = Float[ndarray, "n 2"]


class SurfaceCut(NamedTuple):
    """A straight cut from the surface down.

    Attributes:
        x_m, y_m: Middle [m].
        turn_rad: Direction from x towards y [rad].
        gap_m: Opening at rest in the middle [m]; infinite for faces that never touch.
    """

    x_m: float
    y_m: float
    turn_rad: float
    length_m: float
    depth_m: float
    gap_m: float = math.inf

    @property
    def turn(self) -> Float[ndarray, "2 2"]:
        """Unit vectors across and along the cut, as rows."""
        c, s = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return np.array([[-s, c], [c, s]])

    def local(self, x_m: ndarray, y_m: ndarray) -> tuple[ndarray, ndarray]:
        """Coordinates across and along the cut [m]."""
        (a, b), (c, d) = self.turn
        x, y = np.asarray(x_m) - self.x_m, np.asarray(y_m) - self.y_m
        return a * x + b * y, c * x + d * y


@dataclass(frozen=True, slots=True, eq=False)
class CutOpening:
    """Jump on a cut under a load.

    Attributes:
        along_m, depths_m: Points on the cut from its middle, and depths [m].
        jump_m: Displacement jump across, along, and into the layer [m].
        closed: Where the faces touch.
        work_j, pressing_j: Work of the load on the added surface motion, and its part by normal forces [J].
        added_m: Motion added to the plane (across, along, into the layer) on both sides, in steps of
            ``STEP_M`` [m].
    """

    cut: SurfaceCut
    along_m: Float[ndarray, " n"]
    depths_m: Float[ndarray, " z"]
    jump_m: Float[ndarray, "3 z n"]
    closed: Bool[ndarray, "z n"]
    work_j: float
    pressing_j: float
    added_m: ndarray

    def at(self, x_m: ndarray, y_m: ndarray, side: int = 0) -> Float[ndarray, "3 n"]:
        """Motion added to the plane at points [m]; `side` (1 or -1) forces one side of the cut."""
        across, along = self.cut.local(x_m, y_m)
        before = across >= 0 if side == 0 else np.full(across.shape, side > 0)
        from_cut = np.where(before, np.maximum(across, 0.0), np.maximum(-across, 0.0)) / STEP_M[0]
        row = along / STEP_M[1] + self.added_m.shape[-1] // 2
        parts = [
            np.where(before, *(map_coordinates(field, [from_cut, row], order=1) for field in sides))
            for sides in zip(self.added_m[1], self.added_m[0], strict=True)
        ]
        n, s, z = parts
        (a, b), (c, d) = self.cut.turn
        return np.stack([a * n + c * s, b * n + d * s, z])


class _Solved(NamedTuple):
    """Compliance of a cut between its points and depths, and their positions."""

    compliance: Float[ndarray, "n n"]
    along: Float[ndarray, " n"]
    which: ndarray


@lru_cache(maxsize=8)
def _compliance(stack: Stack, plane_m: float, length_m: float, depth_m: float) -> _Solved:
    response = cut_response(stack, depth_m, plane_m)
    half = math.ceil(length_m / 2 / ALONG_CELL_M - 1e-9) - 1
    if not 1 <= half < ALONG_CELLS // 4:
        raise InputError(
            f"a cut of {1e3 * length_m:g} mm; give {4e3 * ALONG_CELL_M:g} to "
            f"{1e3 * ALONG_CELL_M * ALONG_CELLS / 2:g} mm"
        )
    which = np.arange(-half, half + 1)
    between = ALONG_CELL_M * fft.irfft(response.stiffness, ALONG_CELLS, axis=0)
    blocks = between[(which[:, None] - which) % ALONG_CELLS]  # [n n 3z 3z]
    count = len(which) * blocks.shape[-1]
    matrix = blocks.transpose(0, 2, 1, 3).reshape(count, count)
    return _Solved(inv(matrix, overwrite_a=True), which * ALONG_CELL_M, which)


def cut_opening(
    stack: Stack, cut: SurfaceCut, plane_m: float, places_m: Points, forces_n: Float[ndarray, "3 n"]
) -> CutOpening:
    """Return jump and added motion under forces on the surface.

    Args:
        stack: Stack on a rigid floor.
        cut: Cut in it.
        plane_m: Depth of the plane, an interface [m].
        places_m: Positions of the forces [m].
        forces_n: Forces along x, y, and into the layer [N].
    """
    response = cut_response(stack, cut.depth_m, plane_m)
    solved = _compliance(stack, plane_m, cut.length_m, cut.depth_m)
    driving = _driving(response, cut, places_m, forces_n)[solved.which]
    count = len(response.cut_z_m)
    gap = np.repeat(rest_gap_m(cut, solved.along), count)
    flat, closed = _with_faces_apart(solved.compliance, driving, gap, count)
    jump = flat.reshape(driving.shape)
    whole = np.zeros((ALONG_CELLS, jump.shape[1]))
    whole[solved.which] = jump
    added = _added(response, fft.rfft(whole, axis=0))
    parts = jump.T.reshape(3, count, len(solved.along))
    closed = closed.reshape(len(solved.along), count).T
    pressing = _driving(response, cut, places_m, forces_n * np.array([[0.0], [0.0], [1.0]]))[solved.which]
    work = (float((driving * jump).sum()), float((pressing * jump).sum()))
    return CutOpening(cut, solved.along, response.cut_z_m, parts, closed, *work, added)


def rest_gap_m(cut: SurfaceCut, along_m: ndarray) -> ndarray:
    """Return the gap at rest at positions along a cut; 0 beyond its ends [m]."""
    if math.isinf(cut.gap_m):
        return np.full(np.shape(along_m), math.inf)
    share = 1 - (2 * np.asarray(along_m) / cut.length_m) ** 2
    return np.asarray(cut.gap_m * np.sqrt(np.maximum(share, 0.0)))


def _with_faces_apart(
    compliance: Float[ndarray, "m m"], driving: Float[ndarray, "points jumps"], gap: ndarray, count: int
) -> tuple[Float[ndarray, " m"], Bool[ndarray, " w"]]:
    """Jump, and where faces touch."""
    free = compliance @ driving.ravel()
    normal = (np.arange(len(driving))[:, None] * driving.shape[1] + np.arange(count)).ravel()
    closed = free[normal] + gap < 0
    stiff = 1.0 / compliance[normal, normal].mean()
    for _ in range(SETS):
        on = normal[closed]
        force = np.zeros(len(normal))
        force[closed] = np.linalg.solve(compliance[np.ix_(on, on)], -(free[on] + gap[closed]))
        jump = free + compliance[:, normal[closed]] @ force[closed]
        apart = np.where(closed, 0.0, jump[normal] + gap)
        meets = np.where(closed, force > 0, stiff * apart < 0)
        if np.array_equal(meets, closed):
            return jump, closed
        closed = meets
    raise RangeError(f"which parts of the cut's faces meet did not settle in {SETS} steps; give another load")


def _parity(count: int) -> Float[ndarray, "3 jumps"]:
    """Sign of each motion behind the cut over that before it, per jump."""
    even = np.repeat([[-1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [1.0, -1.0, -1.0]], count, axis=1)
    return np.asarray(even)


def _driving(
    response: CutResponse, cut: SurfaceCut, places_m: Points, forces_n: Float[ndarray, "3 n"]
) -> Float[ndarray, "points jumps"]:
    """Work of the forces on the motion by a unit jump at each point [N]."""
    across, along = cut.local(*np.asarray(places_m).T)
    (a, b), (c, d) = cut.turn
    x, y, z = forces_n
    local = np.stack([a * x + b * y, c * x + d * y, z])
    waves = np.exp(-1j * response.k[:, None] * along)
    total = np.zeros((len(response.k), response.stiffness.shape[-1]), complex)
    for sign in (1, -1):
        mine = across * sign >= 0 if sign > 0 else across < 0
        parity = 1.0 if sign > 0 else _parity(len(response.cut_z_m))
        if mine.any():
            at = _shapes_at(response.x_m, np.abs(across[mine]))
            for part in range(3):
                load = (waves[:, mine] * local[part, mine]) @ at
                moved = response.surface[:, part] * (1.0 if sign > 0 else parity[part])  # type: ignore[index]
                total += np.einsum("kx,kxj->kj", load, moved.conj())
    return np.asarray(fft.irfft(total, ALONG_CELLS, axis=0))


def _shapes_at(nodes_m: Float[ndarray, " x"], at_m: Float[ndarray, " n"]) -> Float[ndarray, "n x"]:
    """Values of the elements' quadratic shapes; 0 beyond the last node."""
    sides = nodes_m[::2]
    element = np.clip(np.searchsorted(sides, at_m, side="right") - 1, 0, len(sides) - 2)
    t = 2 * (at_m - sides[element]) / (sides[element + 1] - sides[element]) - 1
    weights = np.zeros((len(at_m), len(nodes_m)))
    row = np.arange(len(at_m))
    for k, shape in enumerate((t * (t - 1) / 2, 1 - t**2, t * (t + 1) / 2)):
        weights[row, 2 * element + k] = np.where(at_m <= nodes_m[-1], shape, 0.0)
    return weights


@lru_cache(maxsize=4)
def _grid_shapes(nodes: tuple[float, ...]) -> Float[ndarray, "n x"]:
    return _shapes_at(np.array(nodes), np.arange(0.0, REACH_M, STEP_M[0]))


def _added(response: CutResponse, jump: ndarray) -> ndarray:
    """Motion on the plane's grid behind and before the cut."""
    at = _grid_shapes(tuple(response.x_m.tolist()))
    sides = []
    for parity in (_parity(len(response.cut_z_m)), np.ones((3, jump.shape[1]))):
        wave = np.einsum("kpxj,pj,kj->pxk", response.plane, parity, jump)
        fine = fft.irfft(wave, ALONG_CELLS * FINER, axis=-1) * FINER
        sides.append(np.einsum("nx,pxs->pns", at, np.roll(fine, ALONG_CELLS * FINER // 2, axis=-1)))
    return np.stack(sides)
