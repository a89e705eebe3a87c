"""A rigid unit sphere against the top: stiff springs along its normal, and along its meridian for friction.

A point at x lies on the sphere's meridian at the angle theta from the lowest point, with the normal
n = (sin, cos) and the tangent t = (cos, -sin) of theta; its gap is |x - c| - 1. The pressure is
p = normal max(-gap, 0), the friction tau = TANGENT (theta - anchor), cut at +-mu p. All are forces on the
unloaded area. The anchor is where the point first touched and moves along where it slips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

NORMAL = 4000.0  # E/R at least; the contact sinks p/NORMAL < 1e-3 R into the sphere
TANGENT = 400.0  # E/R

Top = Float[ndarray, "facets q"]


@dataclass(frozen=True)
class Touch:
    """Tractions on the top's quadrature points, and how they change with displacement."""

    traction: Float[ndarray, "facets q 2"]  # on the skin, per unloaded area
    stiffness: Float[ndarray, "facets q 2 2"]  # -d traction / d displacement
    pressure: Top
    angle: Top
    anchor: Top  # after slipping; NaN where the point does not touch
    touching: Bool[ndarray, "facets q"]


def touch(
    x: Float[ndarray, "facets q 2"],
    depth: float,
    friction: float,
    anchor: Top,
    normal: float,
    cautious: bool = False,
) -> Touch:
    """Press the sphere to `depth` against points at x.

    Args:
        x: deformed places (r, z) of the top's points [R].
        depth: of the sphere's lowest point below the unloaded surface [R].
        anchor: angles that the springs along the meridian hold to; NaN where none is attached yet.
        normal: stiffness of the springs along the normal [E/R]. Below about p^2 / (mu cell) the top wrinkles
            at the size of the cells: its tilt between the springs then releases more work than they hold.
        cautious: give a slipping point the stiffness of its chord and not that of slip, which has none along
            the meridian. Newton's method is slower so, but points do not jump between slip one way and the
            other.
    """
    away = x - np.array([0.0, depth - 1.0])
    distance = np.hypot(away[..., 0], away[..., 1])
    n = away / distance[..., None]
    t = np.stack([n[..., 1], -n[..., 0]], axis=-1)
    angle = np.arctan2(away[..., 0], away[..., 1])
    touching = distance < 1.0
    p = normal * np.where(touching, 1.0 - distance, 0.0)

    held = touching & ~np.isnan(anchor) & (friction > 0.0)
    trial = np.where(held, TANGENT * (angle - np.where(held, anchor, 0.0)), 0.0)
    limit = friction * p
    slipping = held & (np.abs(trial) > limit)
    tau = np.where(slipping, np.sign(trial) * limit, trial)
    chord = TANGENT * limit / np.where(slipping, np.abs(trial), 1.0) if cautious else 0.0

    nn, tt = n[..., :, None] * n[..., None, :], t[..., :, None] * t[..., None, :]
    tn, nt = t[..., :, None] * n[..., None, :], n[..., :, None] * t[..., None, :]
    slope_n, slope_t, slope_s = (
        np.where(touching, normal, 0.0),
        np.where(slipping, chord, np.where(held, TANGENT, 0.0)) / distance,
        np.where(slipping & (not cautious), -np.sign(trial) * friction * normal, 0.0),
    )
    stiffness = (
        slope_n[..., None, None] * nn
        + (slope_t - p / distance)[..., None, None] * tt
        + slope_s[..., None, None] * tn
        - (tau / distance)[..., None, None] * nt
    )
    return Touch(
        traction=p[..., None] * n - tau[..., None] * t,
        stiffness=stiffness,
        pressure=p,
        angle=angle,
        anchor=np.where(touching, np.where(held, angle - tau / TANGENT, angle), np.nan),
        touching=touching,
    )
