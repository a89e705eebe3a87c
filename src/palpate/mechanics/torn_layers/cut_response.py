"""What a jump of displacement on a cut does to a stack: its stiffness, motion of the surface and of a plane.

The cut is the plane x = 0 from the surface to a depth. A jump b across it, u(0+) - u(0-), makes a field R b
that is in balance without load. The stack is alike on both sides, so that for a jump along x the motion along
x is odd and the others are even; for jumps along y and z the other way round. Each is a motion of half the
stack that is given b/2 on the cut and 0 below it. Its stiffness is K, K b the traction on the faces, and by
reciprocity the jump under a load p on the surface of the cut stack, whose faces are free of stress, follows
from

    K b = R^T p

with R at the surface: no stress of the whole stack is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import splu

from palpate.core import Float, InputError, ndarray
from palpate.mechanics.layers.stack import Stack
from palpate.mechanics.torn_layers.strip_elements import StripMesh, StripStiffness, graded

ALONG_CELL_M = 0.6e-3  # of the jump along the cut
ALONG_CELLS = 128  # of the period along it: 77 mm
SOLVED_WAVES = 18  # wavenumbers that are solved; the others lie between
FIRST_M, GROWTH, LAST_M = 0.12e-3, 1.14, 6e-3  # widths of elements from the cut outwards
END_M = 90e-3  # far end: three times the length over which a nearly incompressible stack of 5 mm rings out
ROW_M = 0.27e-3  # height of elements that the cut crosses; three times that below
MIN_CUT_SHARE = 0.05  # of the stack's thickness


@dataclass(frozen=True, slots=True, eq=False)
class CutResponse:
    """Response to a jump, wave by wave along the cut.

    Attributes:
        k: wavenumbers ``[k]`` [1/m].
        x_m: from the cut ``[x]`` [m]; on the far side the motions are odd or even.
        cut_z_m: depths at which the jump is given, from the surface ``[z]`` [m]; it is 0 at the cut's end.
        stiffness: between jumps (component, depth), per length along the cut ``[k 3z 3z]`` [Pa], complex and
            Hermitian.
        surface, plane: motion x, y, z of the surface and of a plane per jump ``[k 3 x 3z]``, complex.
    """

    k: Float[ndarray, " k"]
    x_m: Float[ndarray, " x"]
    cut_z_m: Float[ndarray, " z"]
    stiffness: ndarray
    surface: ndarray
    plane: ndarray


def strip_mesh(stack: Stack, cut_m: float, finer: float = 1.0) -> StripMesh:
    """Mesh of a stack with a row's edge at the end of a cut [m].

    Args:
        stack: on a rigid floor, of finite thickness.
        cut_m: depth of the cut.
        finer: elements over those that suffice.

    Raises:
        InputError: a stack without a floor, or a cut that is not within it.
    """
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
    """Stiffness ``[3z 3z]`` [Pa] and motion of surface and plane ``[3 x 3z]``, V for u_y, of one wave."""
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
    """Response of a stack to jumps on a cut at every wave of its period; seconds, then kept in memory.

    Args:
        stack: on a rigid floor.
        cut_m: depth of the cut [m].
        plane_m: depth of the plane [m], a face between layers.
        finer: elements over those that suffice.
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
