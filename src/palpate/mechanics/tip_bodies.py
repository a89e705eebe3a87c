"""Meshes of a hemispherical tip, gel under a skin, and of a cylinder, for `revolved`."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from palpate.core.errors import RangeError
from palpate.core.shapes import Float, Int
from palpate.mechanics.revolved import RevolvedBody, tensor_mesh
from palpate.mechanics.tilted_tip import TipModes, TopModes, facet_modes

CORE = 0.05  # of the radius, held, so that no cell shrinks to the centre
FINE_TO = np.deg2rad(84.0)  # polar angle up to which cells are even
TOP_FINE_TO = 0.85  # of a cylinder's radius


def tip_modes(
    radius_m: float,
    skin_m: float,
    skin_pa: float,
    gel_pa: float,
    poisson_ratio: float,
    *,
    rings: int = 42,
    azimuths: int = 24,
    modes: int = 32,
) -> TipModes:
    """The answer of a hemisphere whose equator and core are held.

    Args:
        radius_m, skin_m: of the hemisphere; thickness of its skin [m].
        skin_pa, gel_pa: Young's moduli [Pa].
        poisson_ratio: of both.
        rings, azimuths: cells of the skin from the axis to 84 degrees, and around half of it.
        modes: around the axis.

    Raises:
        RangeError: no such tip.
    """
    if not (0 < skin_m < 0.5 * radius_m and skin_pa > 0 and gel_pa > 0 and 0 < poisson_ratio < 0.5):
        raise RangeError(
            f"a tip of radius {1e3 * radius_m:g} mm with a skin of {1e3 * skin_m:g} mm, {skin_pa:g} Pa, gel "
            f"{gel_pa:g} Pa, Poisson's ratio {poisson_ratio:g}; the skin is thinner than half the radius, "
            "moduli are positive, the ratio is between 0 and 1/2"
        )
    body, facets, inside = _hemisphere(radius_m, skin_m, skin_pa, gel_pa, poisson_ratio, rings)
    skin, pins = facet_modes(body, facets, inside, modes)
    r, z = body.places_m[inside].T
    return TipModes(
        radius_m, np.linspace(0.0, FINE_TO, rings + 1), azimuths, skin, pins, np.arctan2(r, radius_m - z)
    )


def _hemisphere(
    radius: float, skin: float, skin_pa: float, gel_pa: float, nu: float, rings: int
) -> tuple[RevolvedBody, Int[ndarray, "rings 3"], Int[ndarray, " places"]]:
    """The body, the facets of its outside up to `FINE_TO`, and the nodes of the skin's inside."""
    inner = radius - skin
    coarse = np.linspace(FINE_TO, np.pi / 2, max(3, rings // 8))[1:]
    phi = np.concatenate([np.linspace(0.0, FINE_TO, rings + 1), coarse])
    depth = np.cumsum(1.3 ** np.arange(max(5, rings // 4)))
    gel = inner - depth[::-1] / depth[-1] * (inner - CORE * radius)
    rho = np.concatenate([gel, [inner, (inner + radius) / 2, radius]])

    def place(x: Float[ndarray, "2 k"]) -> Float[ndarray, "2 k"]:
        return np.stack([x[1] * np.sin(x[0]), radius - x[1] * np.cos(x[0])])

    mesh = tensor_mesh(phi, rho, place)
    r, z = mesh.doflocs
    angle, distance = np.arctan2(r, radius - z), np.hypot(r, z - radius)
    middle = mesh.doflocs[:, mesh.t].mean(axis=1)
    outer = np.hypot(middle[0], middle[1] - radius) > inner
    held = np.flatnonzero(np.isclose(angle, np.pi / 2) | np.isclose(distance, CORE * radius))
    outside, inside = (_along(angle, np.isclose(distance, at)) for at in (radius, inner))
    facets = np.stack([outside[:-2:2], outside[1:-1:2], outside[2::2]], axis=1)[:rings]
    body = RevolvedBody(mesh, np.where(outer, skin_pa, gel_pa), nu, held)
    return body, facets, inside


def top_modes(
    radius_m: float,
    height_m: float,
    youngs_pa: float,
    poisson_ratio: float,
    *,
    rings: int = 30,
    modes: int = 32,
) -> TopModes:
    """The answer of a cylinder's top, whose base is bonded.

    Args:
        radius_m, height_m: of the cylinder [m].
        youngs_pa, poisson_ratio: of its material [Pa].
        rings: cells along the radius.
        modes: around the axis.

    Raises:
        RangeError: no such cylinder.
    """
    if not (min(radius_m, height_m, youngs_pa) > 0 and 0 < poisson_ratio < 0.5):
        raise RangeError(
            f"a cylinder of {1e3 * radius_m:g} mm radius and {1e3 * height_m:g} mm height, {youngs_pa:g} Pa, "
            f"Poisson's ratio {poisson_ratio:g}; all are positive, the ratio below 1/2"
        )
    fine = TOP_FINE_TO * radius_m
    r = np.concatenate([np.linspace(0.0, fine, rings + 1), np.linspace(fine, radius_m, 5)[1:]])
    down = np.cumsum(1.35 ** np.arange(max(8, rings // 3)))
    z = np.concatenate([-down[::-1] / down[-1] * height_m, [0.0]])
    mesh = tensor_mesh(r, z)
    at_r, at_z = mesh.doflocs
    held = np.flatnonzero(np.isclose(at_z, -height_m))
    top = _along(at_r, np.isclose(at_z, 0.0, atol=1e-9))
    body = RevolvedBody(mesh, np.full(mesh.t.shape[1], youngs_pa), poisson_ratio, held)
    answers = np.stack([body.compliance(m, top, top) for m in range(modes)])
    return TopModes(at_r[top], answers)


def _along(order: Float[ndarray, " n"], which: ndarray) -> Int[ndarray, " k"]:
    """Nodes of a row, in order along it."""
    nodes = np.flatnonzero(which)
    return nodes[np.argsort(order[nodes])]
