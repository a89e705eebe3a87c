"""Edge-on view of a contact without symmetry: march rays through its stress on planes.

The stress is that of a linear layer at rest, or of a finite-strain table in the deformed state. Rays are read
in slices, finest near the probe; closely spaced rays are interpolated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

from palpate.core import Contact, Float, Float32, ndarray
from palpate.mechanics.layers.layer_stress import OnGrid
from palpate.optics.march import march_colour
from palpate.optics.polariscope import ColumnRays, plane_amplitude, with_leak
from palpate.sensors.palm import fringe_view
from palpate.sensors.palm.membrane_faults import frozen_at
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.probe_shapes import parts_of, silhouette
from palpate.sensors.palm.probe_stress import laid_of, rows_of

# These values limit the light's error to 0.1 of 255 (rms), 1 at most.
SLICES = 64
MORE_SLICES = 32  # additional slices for each further point that they crowd around
FINE = 400  # points of a ray for the layout of its slices
MAX_ACROSS_M = 0.14e-3  # maximum distance of marched rays
COLUMNS = 64  # columns marched together, which bounds the memory
WIDTH = 0.3  # distance of equally fine slices, in thicknesses

Rays = Float[ndarray, "w s"]


def march_contact(spec: PalmSpec, contact: Contact) -> fringe_view.Light:
    """Return the light of each ray; dark where the probe or the sunken surface blocks it."""
    view = spec.fringes.sampled(*spec.rays_per_pixel)
    light = np.full((*view.size_px[::-1], 3), spec.extinction, np.float32)
    rays, z = fringe_view.columns(spec, view), view.down_m
    rows = np.flatnonzero((z >= 0) & (z <= spec.thickness_m))
    seen = np.flatnonzero(rays.visible)
    chosen = _chosen(rays, seen)
    places = _slices(spec, contact, rays, chosen)
    if contact.force_n > 0 or spec.frozen_birefringence or spec.residual.birefringence:
        marched = _marched(spec, contact, rays, chosen, places, z[rows])
        light[rows[0] : rows[-1] + 1, seen] = _between(marched, chosen, seen)
    sunk = np.zeros(len(rays.visible))
    sunk[seen] = np.interp(seen, chosen, _lowest(contact, places))
    stopped = _stopped(spec, contact, rays, z)
    light[(z[:, None] > 0) & (stopped | (z[:, None] < sunk))] = 0
    return fringe_view.mean_of(light, *spec.rays_per_pixel)


class Places(NamedTuple):
    """Midpoints (x, y) of the rays' slices and their lengths [m]."""

    x: Rays
    y: Rays
    length: Rays


def _chosen(rays: ColumnRays, seen: ndarray) -> ndarray:
    """Columns to march, at most MAX_ACROSS_M apart, and the last."""
    apart = float(np.abs(np.diff(rays.impact_m[seen])).max(initial=0.0))
    stride = max(1, int(MAX_ACROSS_M / apart)) if apart else 1
    return np.unique(np.append(seen[::stride], seen[-1]))


def _between(marched: Float32[ndarray, "h c 3"], chosen: ndarray, seen: ndarray) -> Float32[ndarray, "h w 3"]:
    below = np.clip(np.searchsorted(chosen, seen, side="right") - 1, 0, max(len(chosen) - 2, 0))
    above = np.minimum(below + 1, len(chosen) - 1)
    share = ((seen - chosen[below]) / np.maximum(chosen[above] - chosen[below], 1)).astype(np.float32)
    return np.asarray(marched[:, below] + (marched[:, above] - marched[:, below]) * share[:, None])


def _slices(spec: PalmSpec, contact: Contact, rays: ColumnRays, chosen: ndarray) -> Places:
    """Slices of equal angle as seen from the points the ray passes."""
    pose = contact.pose
    offset, start, end = (along[chosen] for along in rays.about(pose.x_m, pose.y_m))
    cos, sin = np.cos(rays.turn_rad[chosen])[:, None], np.sin(rays.turn_rad[chosen])[:, None]
    about = np.array(_crowded(contact)).T[..., None, None]  # [2 p 1 1]
    aside = offset[:, None] - (about[0] * cos - about[1] * sin)
    ahead = about[0] * sin + about[1] * cos
    scale = np.hypot(aside, WIDTH * spec.thickness_m)
    fine = start[:, None] + (end - start)[:, None] * np.linspace(0, 1, FINE)
    angle = np.arctan((fine - ahead) / scale).sum(axis=0)
    count = SLICES + MORE_SLICES * (about.shape[1] - 1)
    step = (angle[:, -1:] - angle[:, :1]) / count
    wanted = angle[:, :1] + (np.arange(count) + 0.5) * step
    along = np.stack([np.interp(w, a, f) for w, a, f in zip(wanted, angle, fine, strict=True)])
    for _ in range(2):  # Newton's steps from the straight lines between fine points to the place itself
        rate = (scale / (scale**2 + (along - ahead) ** 2)).sum(axis=0)
        missing = wanted - np.arctan((along - ahead) / scale).sum(axis=0)
        along = np.clip(along + missing / rate, start[:, None], end[:, None])
    rate = (scale / (scale**2 + (along - ahead) ** 2)).sum(axis=0)
    across = offset[:, None]
    return Places(pose.x_m + across * cos + along * sin, pose.y_m + along * cos - across * sin, step / rate)


def _crowded(contact: Contact) -> list[tuple[float, float]]:
    """Points around which slices crowd: each ball, or ends and middle of one body."""
    probe = contact.probe
    if probe.length_m and len(parts_of(probe)) == 1:
        x, y = (probe.length_m / 3 * f(probe.turn_rad) for f in (np.cos, np.sin))
        return [(-x, -y), (0.0, 0.0), (x, y)]
    return [(x, y) for _, (x, y, _) in parts_of(probe)]


def _lowest(contact: Contact, places: Places) -> Float[ndarray, " w"]:
    """Maximum surface depth along each ray [m]."""
    x, y = contact.x_m, contact.y_m
    at = [(places.y - y[0]) / (y[1] - y[0]), (places.x - x[0]) / (x[1] - x[0])]
    return np.asarray(map_coordinates(contact.displacement_m, at, order=1, cval=0.0).max(axis=1))


def _stopped(spec: PalmSpec, contact: Contact, rays: ColumnRays, z: Float[ndarray, " h"]) -> ndarray:
    """Mask of the rays that the probe blocks."""
    pose, stopped = contact.pose, np.zeros((len(z), len(rays.visible)), bool)
    if pose.depth_m == 0:
        return stopped
    for part, (x, y, up) in parts_of(contact.probe):
        offset = np.where(rays.visible, rays.about(pose.x_m + x, pose.y_m + y)[0], np.inf)
        depth = pose.depth_m - up
        stopped |= silhouette(part, depth if depth else -1e-12, offset, z) > 0
    return stopped


def _marched(
    spec: PalmSpec,
    contact: Contact,
    rays: ColumnRays,
    chosen: ndarray,
    places: Places,
    z: Float[ndarray, " h"],
) -> Float32[ndarray, "h c 3"]:
    laid = laid_of(spec, contact)
    planes, near, far, _ = laid
    onto = rows_of(laid, z)
    seen = fringe_view.spectrum(spec.bands)
    light = np.empty((len(z), len(chosen), 3), np.float32)
    for first in range(0, len(chosen), COLUMNS):
        part = slice(first, first + COLUMNS)
        frozen = frozen_at(spec, rays.impact_m[chosen[part]], planes[:, None])
        difference, shear = _read(spec, near, far, rays.turn_rad[chosen[part]], places, part, frozen)
        light[:, part] = march_colour(
            onto @ difference,
            onto @ shear,
            spec.stress_optic.half_phase(seen.wavelength_m),
            seen.weight,
            plane_amplitude(spec.polariser_rad, spec.bands),
        )
    return np.asarray(with_leak(light, spec.extinction), dtype=np.float32)


def _read(
    spec: PalmSpec,
    near: OnGrid,
    far: OnGrid,
    turn: ndarray,
    places: Places,
    part: slice,
    frozen: tuple[ndarray, ndarray],
) -> tuple[Float32[ndarray, "s z w"], Float32[ndarray, "s z w"]]:
    """Difference and shear times length, of each slice on every plane."""
    from palpate.sensors.palm import ray_kernels  # here: compiling is for those who march

    x, y, length = (np.ascontiguousarray(values[part].T) for values in places)
    c, s = np.cos(turn), np.sin(turn)
    turns = np.stack([c * c, s * s, -2 * s * c, 2 * c, -2 * s]).astype(np.float32)
    C = spec.stress_optic.coefficient_per_pa
    grids = [np.array([*grid.first_m, *(1 / cell for cell in grid.cell_m)]) for grid in (near, far)]
    u, v = (np.empty((len(x), near.stress_pa.shape[0], x.shape[1]), np.float32) for _ in range(2))
    ray_kernels.read_along(
        near.stress_pa,
        far.stress_pa,
        *grids,
        x,
        y,
        length.astype(np.float32),
        turns,
        np.stack([component / C for component in frozen]).astype(np.float32),
        u,
        v,
    )
    return u, v
