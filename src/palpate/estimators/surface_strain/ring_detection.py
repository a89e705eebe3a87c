"""Contacts found by their stretch, and the ring of greatest outward motion around each.

About a center c, with d = (X - c)/s and w = 1 + d.d, the shift of a mark is

    U = A d w^-q + B (z x d) w^-q + T w^-(q + 1),

A for a press, B for a torque, T for a lateral load and for skin that sinks towards an off-axis camera; the
ring has radius s / sqrt(2q - 1). Contacts add up. Fitted by Levenberg-Marquardt least squares; model misfit
is correlated over the ring's area and counts once in the standard errors.

References: D. W. Marquardt, J. SIAM 11, 431 (1963), doi:10.1137/0111030.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter

from palpate.core import Field, Float, ndarray
from palpate.estimators.surface_strain.strain_fields import StrainFields

COARSE = 41  # samples along an axis on which contacts are looked for
SMOOTH = 0.7  # of the pitch: standard deviation of the smoothing before
MIN_STRETCH = 5.0  # times its noise: a contact's area strain
MIN_SHARE = 0.3  # of the greatest: a second contact's area strain
MAX_SADDLE = 0.7  # of the lesser peak: two contacts have a lower stretch between them
MIN_SIGNIFICANCE = 4.0  # of the outward shift over its standard error
MAX_CONTACTS = 6
STEPS = 30
SETTLED = 2e-3  # of a pitch, and of the parameters without unit
GAINED = 1e-3  # relative gain of the squared misfit at which the fit has settled
AROUND = 6.0  # pitches from a contact within which marks count
START_WIDTH, START_POWER = 1.5, 2.0  # s in pitches, and q
POWERS = (0.75, 8.0)  # bounds of q
WIDTHS = (0.4, 10.0)  # bounds of s [pitch]
PER_RING = 8  # cx, cy, ln s, q, A, B, Tx, Ty

Params = Float[ndarray, " p"]
Points = Float[ndarray, "n 2"]


@dataclass(frozen=True, slots=True)
class ShearRing:
    """Ring of one contact in the unit of the marks, with standard errors.

    Attributes:
        radius: Radius of greatest outward motion.
        outward: Greatest outward shift.
        around: Greatest shift around the center, positive from x towards y.
        along: Shift of the center (x, y).
    """

    x: float
    y: float
    radius: float
    outward: float
    around: float
    along: tuple[float, float]
    x_error: float
    y_error: float
    radius_error: float
    outward_error: float
    around_error: float
    along_error: tuple[float, float]


class ContactPeak(NamedTuple):
    """Position of a contact's greatest stretch, and its area strain."""

    x: float
    y: float
    area_strain: float


class StretchOverNoise(NamedTuple):
    """Smoothed area strain on coarse samples, and its noise threshold.

    Attributes:
        coarse: Rows and columns of the fields' samples.
        smooth: Area strain ``[nv nu]``; without meaning where nothing is seen.
        least: Threshold.
        per_pitch: Coarse samples in a pitch, along rows and along columns.
    """

    coarse: tuple[slice, slice]
    smooth: Field
    least: float
    per_pitch: tuple[float, float]


def stretch_over_noise(fields: StrainFields, pitch: float) -> StretchOverNoise:
    """Return the smoothed area strain for the search of contacts."""
    rows, columns = (slice(None, None, max(1, size // COARSE)) for size in fields.at.shape[1:])
    seen = fields.basis.supported[rows, columns]
    n_v, n_u = (size / span for size, span in zip(seen.shape, _spans(fields), strict=True))
    H = fields.gradient[:, :, rows, columns]
    smooth = _smoothed(H[0, 0] + H[1, 1], seen, [SMOOTH * n_v, SMOOTH * n_u])
    noise = math.sqrt(2 * float(fields.variances.sum(axis=0).mean())) / pitch
    return StretchOverNoise((rows, columns), smooth, MIN_STRETCH * noise / (2 * SMOOTH), (n_v, n_u))


def contact_peaks(fields: StrainFields, pitch: float | None = None) -> list[ContactPeak]:
    """Return contacts by their stretch, the strongest first; peaks without a dip between them are one."""
    (rows, columns), smooth, least, per_pitch = stretch_over_noise(fields, pitch or mark_pitch(fields))
    at, seen = fields.at[:, rows, columns], fields.basis.supported[rows, columns]
    told = np.where(seen, smooth, -np.inf)  # a peak over marks that are lost is told by those beside them
    top = told == maximum_filter(told, [2 * int(n) + 1 for n in per_pitch])
    top &= (smooth > least) & (smooth > MIN_SHARE * told.max()) & seen
    order = sorted(((int(i), int(j)) for i, j in np.argwhere(top)), key=lambda place: -smooth[place])
    kept: list[tuple[int, int]] = []
    for place in order:
        if all(_apart(smooth, place, other) for other in kept):
            kept.append(place)
    return [ContactPeak(float(at[0][p]), float(at[1][p]), float(smooth[p])) for p in kept[:MAX_CONTACTS]]


def find_rings(fields: StrainFields, peaks: list[ContactPeak] | None = None) -> list[ShearRing]:
    """Return the rings of all contacts, the strongest first; none if the fit does not settle."""
    pitch = mark_pitch(fields)
    peaks = contact_peaks(fields, pitch) if peaks is None else peaks
    if not peaks:
        return []
    near = np.min([np.hypot(*(fields.rest - p[:2]).T) for p in peaks], axis=0) < AROUND * pitch
    at, shifts = fields.rest[near] / pitch, fields.moved[near] / pitch
    if at.size < 2 * PER_RING * len(peaks):
        return []
    start = np.concatenate(
        [[p.x / pitch, p.y / pitch, math.log(START_WIDTH), START_POWER, 0.0, 0.0, 0.0, 0.0] for p in peaks]
    )
    fitted = _fit(at, shifts, _with_amplitudes(start, at, shifts))
    if fitted is None:
        return []
    params, inverse, off = fitted
    noise = float(fields.variances.sum(axis=0).mean()) / pitch**2
    excess = max(0.0, float((off**2).sum()) / (off.size - len(params)) - noise)
    rings = []
    for i in range(len(peaks)):
        part = slice(i * PER_RING, (i + 1) * PER_RING)
        p = params[part]
        alike = max(1.0, 2 * math.pi * math.exp(2 * p[2]) / (2 * p[3] - 1))  # marks within sqrt(2) radii
        C = inverse[part, part] * (noise + alike * excess)
        ring = _ring(p, C, pitch)
        if ring.outward > MIN_SIGNIFICANCE * ring.outward_error:
            rings.append(ring)
    return rings


@lru_cache(maxsize=1)  # of one frame's fields several ask
def mark_pitch(fields: StrainFields) -> float:
    """Return the mean distance of neighbors, from the area of a cell [unit]."""
    spans, seen = _spans(fields), fields.basis.supported.ravel()
    some = slice(None, None, 7 if seen.size > 700 else 1)  # a mean needs no more
    (uu, uv), (vu, vv) = fields.to_axes.reshape(2, 2, -1)[:, :, some][:, :, seen[some]]
    inverse = float(np.abs(uu * vv - uv * vu).mean())
    return 1 / math.sqrt(inverse * spans[0] * spans[1])


def _spans(fields: StrainFields) -> tuple[int, int]:
    columns, rows = np.ptp(fields.basis.cells, axis=0)
    return int(rows), int(columns)


def _smoothed(values: Field, seen: ndarray, widths: list[float]) -> Field:
    total = gaussian_filter(np.where(seen, values, 0.0), widths, mode="constant")
    share = gaussian_filter(seen.astype(float), widths, mode="constant")
    return np.asarray(total / np.maximum(share, 0.2))


def _apart(values: Field, one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether values dip on the straight line between two positions."""
    way = [np.linspace(a, b, 25) for a, b in zip(one, other, strict=True)]
    between = map_coordinates(values, way, order=1)
    return bool(between.min() < MAX_SADDLE * min(values[one], values[other]))


class _Shape(NamedTuple):
    """Outward, around, and along parts of a ring for unit amplitudes, and terms of their derivatives."""

    d: Points
    s: float
    w: Float[ndarray, " n"]
    g: Float[ndarray, " n"]
    h: Float[ndarray, " n"]


def _shape(p: Params, at: Points) -> _Shape:
    s = math.exp(p[2])
    d = (at - p[:2]) / s
    w = 1 + (d * d).sum(axis=1)
    g = w ** -p[3]
    return _Shape(d, s, w, g, g / w)


def _model(params: Params, at: Points) -> tuple[Points, Float[ndarray, "n 2 p"]]:
    """Shifts of marks, and their derivatives by the parameters."""
    shifts, slopes = np.zeros_like(at), np.zeros((*at.shape, len(params)))
    for first in range(0, len(params), PER_RING):
        p = params[first : first + PER_RING]
        d, s, w, g, h = _shape(p, at)
        turn = np.array([[p[4], p[5]], [-p[5], p[4]]])  # d turn = A d + B (z x d)
        swirl, along = d @ turn, p[6:8]
        own = swirl * g[:, None] + along * h[:, None]
        by_w = (-p[3] * g / w)[:, None] * swirl - ((p[3] + 1) * h / w)[:, None] * along
        by_d = turn.T * g[:, None, None] + (2 * by_w)[:, :, None] * d[:, None, :]  # [n, component, d]
        mine = slopes[:, :, first : first + PER_RING]
        mine[:, :, :2] = -by_d / s
        mine[:, :, 2] = -swirl * g[:, None] - by_w * (2 * (w - 1))[:, None]
        mine[:, :, 3] = -np.log(w)[:, None] * own
        mine[:, :, 4] = d * g[:, None]
        mine[:, 0, 5], mine[:, 1, 5] = -mine[:, 1, 4], mine[:, 0, 4]
        mine[:, 0, 6] = mine[:, 1, 7] = h
        shifts += own
    return shifts, slopes


def _with_amplitudes(params: Params, at: Points, shifts: Points) -> Params:
    _, slopes = _model(params, at)
    linear = np.arange(len(params)) % PER_RING >= PER_RING // 2
    basis = slopes.reshape(-1, len(params))[:, linear]
    params = params.copy()
    params[linear] = np.linalg.lstsq(basis, shifts.ravel(), rcond=None)[0]
    return params


def _bounded(params: Params) -> Params:
    params = params.copy()
    params[2::PER_RING] = np.clip(params[2::PER_RING], *np.log(WIDTHS))
    params[3::PER_RING] = np.clip(params[3::PER_RING], *POWERS)
    return params


def _fit(at: Points, shifts: Points, params: Params) -> tuple[Params, Float[ndarray, "p p"], Points] | None:
    """Parameters, their covariance per mark variance, and the residual; None if it does not settle."""
    model, slopes = _model(params, at)
    off, damping = shifts - model, 1e-3
    loss = float((off**2).sum())
    for _ in range(STEPS):
        J = slopes.reshape(-1, len(params))
        normal, gradient = J.T @ J, J.T @ off.ravel()
        scale = np.diag(normal) + 1e-12
        trial = _bounded(params + np.linalg.solve(normal + damping * np.diag(scale), gradient))
        model, trial_slopes = _model(trial, at)
        trial_off = shifts - model
        trial_loss = float((trial_off**2).sum())
        step = np.abs(trial - params).max()
        if trial_loss <= loss:
            settled = step < SETTLED or loss - trial_loss < GAINED * loss
            params, off, loss, slopes, damping = trial, trial_off, trial_loss, trial_slopes, damping / 10
            if settled:
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    J = slopes.reshape(-1, len(params))
    try:
        covariance = np.linalg.inv(J.T @ J)
    except np.linalg.LinAlgError:
        return None
    inside = ((params.reshape(-1, PER_RING)[:, :2] > at.min(axis=0) - 1).all()) & (
        (params.reshape(-1, PER_RING)[:, :2] < at.max(axis=0) + 1).all()
    )
    return (params, covariance, off) if inside and (np.diag(covariance) > 0).all() else None


def _ring(p: Params, covariance: Float[ndarray, "p p"], pitch: float) -> ShearRing:
    values = _sizes(p[:, None])[:, 0]
    step = 1e-4 * np.eye(PER_RING)
    slopes = (_sizes(p[:, None] + step) - _sizes(p[:, None] - step)) / 2e-4
    errors = np.sqrt(np.diag(slopes @ covariance @ slopes.T)) * pitch
    x, y, radius, outward, around, *along = (values * pitch).tolist()
    ex, ey, er, eo, ea, *el = errors.tolist()
    return ShearRing(x, y, radius, outward, around, tuple(along), ex, ey, er, eo, ea, tuple(el))


def _sizes(p: Float[ndarray, "8 m"]) -> Float[ndarray, "7 m"]:
    """Center, radius, and the four shifts of rings, each a column [pitch]."""
    s, q = np.exp(p[2]), p[3]
    radius = 1 / np.sqrt(2 * q - 1)
    top = radius * (1 + radius**2) ** -q
    return np.stack([p[0], p[1], s * radius, p[4] * top, p[5] * top, p[6], p[7]])
