"""The edge-on view of any contact: rays through the stress of linear layers, where the skin was at rest.

Slower than the ball's own ways and bound to shallow presses, it knows no symmetry: punches, edges, cylinders,
two points, lateral load. The stress is laid out on two grids, the contact's own and a wide coarse one for
what lies beyond it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray
from scipy.interpolate import RegularGridInterpolator

from palpate.core.axes import Field
from palpate.core.contact import Contact
from palpate.mechanics.stack_field import STRESSES, field_below
from palpate.optics.fast_march import march_colour
from palpate.optics.polariscope import plane_amplitude, with_leak
from palpate.optics.rim import ColumnRays
from palpate.optics.stress_optic import frozen_stress
from palpate.sensors.palm import fringes
from palpate.sensors.palm.field import has_table
from palpate.sensors.palm.press import stack_of
from palpate.sensors.palm.shapes import silhouette
from palpate.sensors.palm.spec import PalmSpec

PLANES = 48  # of stress, finest at the surface
SLICES = 96
COLUMNS = 32  # marched together, which bounds the memory
WIDE_CELLS = 128  # of the wide grid's side
REACH = 3.0  # thicknesses beyond the contact's own grid at which the stress has died away

Slices = Float[ndarray, "s h w"]


def exact(spec: PalmSpec, contact: Contact) -> fringes.Light:
    """What each ray sees; dark where the probe or the sunken surface stops it."""
    pose = contact.pose
    if contact.force_n == 0 and has_table(spec):  # the quicker way to a membrane at rest
        return fringes.exact(spec, 0.0, pose.x_m, pose.y_m)
    view = spec.fringes.sampled(*spec.rays_per_pixel)
    light = np.full((*view.size_px[::-1], 3), spec.extinction, np.float32)
    rays, z = fringes.columns(spec, view), view.down_m
    rows = np.flatnonzero((z >= 0) & (z <= spec.thickness_m))
    inside, columns = Inside(spec, contact), np.flatnonzero(rays.visible)
    for first in range(0, len(columns), COLUMNS):
        part = columns[first : first + COLUMNS]
        light[rows[0] : rows[-1] + 1, part] = _marched(spec, inside, rays, part, z[rows])
    offset = np.where(rays.visible, rays.about(pose.x_m, pose.y_m)[0], np.inf)
    sunk = np.interp(offset, contact.x_m - pose.x_m, contact.sinking_m.max(axis=0), left=0.0, right=0.0)
    stopped = silhouette(contact.probe, pose.depth_m, offset, z) > 0
    light[(z[:, None] > 0) & (stopped | (z[:, None] < sunk))] = 0
    return fringes.mean_of(light, *spec.rays_per_pixel)


class Inside:
    """Stress under a contact, to be read at any place."""

    def __init__(self, spec: PalmSpec, contact: Contact) -> None:
        self.z = spec.thickness_m * np.linspace(0, 1, PLANES) ** 2
        self.x0, self.y0 = contact.pose.x_m, contact.pose.y_m
        shear = np.zeros((2, *contact.pressure_pa.shape)) if contact.shear_pa is None else contact.shear_pa
        loads = (contact.pressure_pa, *shear)
        x, y = contact.x_m - self.x0, contact.y_m - self.y0
        self._half = min(-x[0], x[-1], -y[0], y[-1])
        self._near = self._laid(spec, loads, x, y)
        wide = np.linspace(-1, 1, WIDE_CELLS) * (self._half + REACH * spec.thickness_m)
        self._far = self._laid(spec, [_spread(load, x, y, wide) for load in loads], wide, wide)

    def _laid(
        self, spec: PalmSpec, loads: tuple[Field, ...] | list[Field], x: ndarray, y: ndarray
    ) -> RegularGridInterpolator:
        p, qx, qy = loads
        field = field_below(stack_of(spec), p, x, y, self.z, shear_x_pa=qx, shear_y_pa=qy)
        values = np.moveaxis(field.stress_pa.astype(np.float32), (0, 1), (2, 3))
        return RegularGridInterpolator((y, x), np.ascontiguousarray(values), bounds_error=False, fill_value=0)

    def at(self, x: Float[ndarray, "w s"], y: Float[ndarray, "w s"]) -> Float[ndarray, "w s z 6"]:
        """All six stresses [Pa] on all planes above and below places about the contact's centre [m]."""
        places = np.stack([y, x], axis=-1)
        near = np.maximum(abs(x), abs(y)) <= self._half
        stress = np.empty((*x.shape, PLANES, len(STRESSES)))
        stress[near], stress[~near] = self._near(places[near]), self._far(places[~near])
        return stress


def _spread(load: Field, x: ndarray, y: ndarray, wide: Float[ndarray, " n"]) -> Float[ndarray, "n n"]:
    """A load on the wide grid, its sum kept."""
    cell = wide[1] - wide[0]
    edges = np.append(wide, wide[-1] + cell) - cell / 2
    rows, columns = np.meshgrid(y, x, indexing="ij")
    total, _, _ = np.histogram2d(rows.ravel(), columns.ravel(), bins=(edges, edges), weights=load.ravel())
    return np.asarray(total * (x[1] - x[0]) * (y[1] - y[0]) / cell**2)


def _marched(
    spec: PalmSpec, inside: Inside, rays: ColumnRays, part: ndarray, z: Float[ndarray, " h"]
) -> Float32[ndarray, "h w 3"]:
    offset, start, end = (along[part] for along in rays.about(inside.x0, inside.y0))
    scale = np.hypot(offset, 0.3 * spec.thickness_m)
    first, last = np.arctan(start / scale), np.arctan(end / scale)
    step = (last - first) / SLICES
    angle = first[:, None] + (np.arange(SLICES) + 0.5) * step[:, None]
    along = scale[:, None] * np.tan(angle)
    length = scale[:, None] / np.cos(angle) ** 2 * step[:, None]
    cos, sin = np.cos(rays.turn_rad[part])[:, None], np.sin(rays.turn_rad[part])[:, None]
    stress = inside.at(offset[:, None] * cos + along * sin, along * cos - offset[:, None] * sin)
    xx, yy, zz, yz, xz, xy = np.moveaxis(stress, -1, 0)
    c, s = cos[..., None], sin[..., None]
    frozen = frozen_stress(spec.frozen_birefringence, spec.frozen_axis_rad, spec.stress_optic)
    difference = c**2 * xx - 2 * s * c * xy + s**2 * yy - zz + frozen[0]
    shear = 2 * (c * xz - s * yz) + frozen[1]
    seen = fringes.spectrum(spec.bands)
    light = march_colour(
        _on_rows(difference * length[..., None], inside.z, z),
        _on_rows(shear * length[..., None], inside.z, z),
        spec.stress_optic.half_phase(seen.wavelength_m),
        seen.weight,
        plane_amplitude(spec.polariser_rad, spec.bands),
    )
    return with_leak(light, spec.extinction)


def _on_rows(
    values: Float[ndarray, "w s z"], planes: Float[ndarray, " z"], z: Float[ndarray, " h"]
) -> Slices:
    """From planes to rows, along straight lines."""
    k = np.clip(np.searchsorted(planes, z) - 1, 0, len(planes) - 2)
    t = (z - planes[k]) / (planes[k + 1] - planes[k])
    return np.asarray((values[..., k] * (1 - t) + values[..., k + 1] * t).transpose(1, 2, 0))
