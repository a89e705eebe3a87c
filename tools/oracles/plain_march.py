"""The march without a compiler: numpy in double precision, all slices in memory, for the compiled one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray
from scipy.interpolate import RegularGridInterpolator

from palpate.optics import AxisymmetricField, MarchedRays, Rays, Retarder, march, through
from palpate.optics.march import march_even


def march_colour_plain(
    difference: ndarray,
    shear: ndarray,
    half_phase: ndarray,
    weight: ndarray,
    amplitude: ndarray,
    even: bool = False,
) -> ndarray:
    """The slow reference for `march_colour`: one band after the other."""
    law: Callable[..., Retarder] = march_even if even else march
    u, v = np.asarray(difference, float), np.asarray(shear, float)
    bands = zip(half_phase, weight, amplitude, strict=True)
    return np.asarray(sum(through(law(u, v, float(c)), part)[..., None] * w for c, w, part in bands))


def march_axisymmetric_plain(
    field: AxisymmetricField,
    rays: Rays,
    half_phase: ndarray,
    weight: ndarray,
    amplitude: ndarray,
    slices: int = 64,
    frozen_pa: tuple[float, float] = (0.0, 0.0),
) -> MarchedRays:
    """The slow reference for `march_axisymmetric`."""
    s, z, start, end, scale = rays.broadcast().reshape(5, -1)
    first, last = np.arctan(start / scale), np.arctan(end / scale)
    step = (last - first) / slices
    edge = first + np.arange(slices + 1)[:, None] * step
    y, dy, y_edge = _middles(scale, edge, step)
    length = np.diff(y_edge, axis=0)

    clear = z - np.interp(np.hypot(s, y_edge), field.r_m, field.surface_m)
    below, above = clear[:-1], clear[1:]
    crossing = np.sign(below) * np.sign(above) < 0
    span = np.where(crossing, abs(above - below), 1.0)
    share = np.where(crossing, np.maximum(below, above) / span, (below >= 0) & (above >= 0))
    part = length * share / 2
    y = np.where(crossing, np.where(above > 0, y_edge[1:] - part, y_edge[:-1] + part), y)
    share = share * (z <= field.thickness_m)

    r = np.hypot(s, y)
    top = np.interp(r, field.r_m, field.surface_m)
    zeta = np.clip((z - top) / (field.thickness_m - top), 0, 1)
    read = RegularGridInterpolator((field.zeta, field.r_m), np.moveaxis(field.stress_pa, 0, -1))
    inside_table = r <= field.r_m[-1]
    rr, tt, zz, rz = np.moveaxis(
        read(np.stack([zeta, np.minimum(r, field.r_m[-1])], -1)) * inside_table[..., None], -1, 0
    )
    cosine = s / np.maximum(r, np.finfo(float).tiny)
    difference = ((rr - tt) * cosine**2 + tt - zz) * dy * share + frozen_pa[0] * length * share
    shear = 2 * rz * cosine * dy * share + frozen_pa[1] * length * share
    light = march_colour_plain(difference, shear, half_phase, weight, amplitude)
    skin = length * share
    inside = np.stack([skin.sum(0), (skin * ~inside_table).sum(0)])
    transmitted, *lengths = (part.astype(np.float32) for part in (light, *inside))
    return MarchedRays(transmitted.reshape(*rays.shape, -1), *(part.reshape(rays.shape) for part in lengths))


def _middles(scale: ndarray, edge: ndarray, step: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    middle = (edge[1:] + edge[:-1]) / 2
    # scale / cos^2 step, not the difference of the edges: the former sums a smooth ray far more exactly
    return scale * np.tan(middle), scale / np.cos(middle) ** 2 * step, scale * np.tan(edge)
