"""What an axisymmetric march works on: a table of stress around an axis, and the rays past it."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError, RangeError
from palpate.core.shapes import Float

Along = Float[ndarray, "*_"]
Numbers = Float[ndarray, "5 *n"]


@dataclass(frozen=True, slots=True)
class AxisymmetricField:
    """Stress in a pressed layer, symmetric about an axis, in the deformed body.

    Attributes:
        r_m: distances from the axis [m], ascending from 0.
        zeta: shares of the way from the deformed surface to the bottom, ascending from 0 to 1.
        surface_m: z of the deformed surface at each r [m]; positive in the dimple.
        thickness_m: z of the bottom [m]; (r, z) has zeta = (z - surface) / (thickness - surface).
        stress_pa: Cauchy rr, tt, zz and rz [Pa], positive in tension.
        indenter_m: z of the indenter's underside at each r [m], -inf where there is none; it may not get
            deeper away from the axis. None: nothing stands in the light.
    """

    r_m: Float[ndarray, " n"]
    zeta: Float[ndarray, " m"]
    surface_m: Float[ndarray, " n"]
    thickness_m: float
    stress_pa: Float[ndarray, "4 m n"]
    indenter_m: Float[ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        n, m = len(self.r_m), len(self.zeta)
        if min(n, m) < 2 or self.surface_m.shape != (n,) or self.stress_pa.shape != (4, m, n):
            raise InputError(
                f"{n} radii, {m} depths, surface {self.surface_m.shape}, stress {self.stress_pa.shape}; give "
                "two or more of each, surface [n] and stress [4 m n]"
            )
        if not all(np.isfinite(part).all() for part in (self.r_m, self.zeta, self.surface_m, self.stress_pa)):
            raise InputError("radii, depths, surface and stress must be finite numbers; look for NaN")
        if self.r_m[0] != 0 or (np.diff(self.r_m) <= 0).any():
            raise InputError("the radii must ascend from 0 m")
        if self.zeta[0] != 0 or abs(self.zeta[-1] - 1) > 1e-9 or (np.diff(self.zeta) <= 0).any():
            raise InputError("zeta must ascend from 0 at the surface to 1 at the bottom")
        if not (np.isfinite(self.thickness_m) and self.thickness_m > self.surface_m.max()):
            raise RangeError(
                f"bottom at {self.thickness_m} m, surface down to {self.surface_m.max()} m: no skin is left; "
                "give a bottom below the surface"
            )
        _check_indenter(self.indenter_m, n)


@dataclass(frozen=True, slots=True)
class Rays:
    """Straight rays along y; the five arrays broadcast to one shape.

    Attributes:
        offset_m: s, the ray's x less the axis's [m].
        depth_m: z [m]; negative above the surface at rest.
        start_m: y where the ray enters the skin [m], 0 being nearest to the axis.
        end_m: y where it leaves [m], beyond the start.
        scale_m: positive [m]; slices are equal steps of atan(y / scale).
    """

    offset_m: Along
    depth_m: Along
    start_m: Along
    end_m: Along
    scale_m: Along

    def __post_init__(self) -> None:
        parts = [getattr(self, part.name) for part in fields(self)]
        try:
            np.broadcast_shapes(*(part.shape for part in parts))
        except ValueError as e:
            raise InputError(f"shapes {[p.shape for p in parts]} do not broadcast to one set of rays") from e
        if not all(np.isfinite(part).all() for part in parts):
            raise InputError("every number of a ray must be finite, in metres; look for NaN or infinity")
        if not ((self.scale_m > 0).all() and (self.end_m > self.start_m).all()):
            raise RangeError("each ray needs a positive scale [m] and an end beyond its start [m]")

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the rays together."""
        return np.broadcast_shapes(*(getattr(self, part.name).shape for part in fields(self)))

    def broadcast(self) -> Numbers:
        """All numbers of all rays [m]."""
        return np.stack([np.broadcast_to(getattr(self, part.name), self.shape) for part in fields(self)])


def _check_indenter(indenter_m: ndarray | None, n: int) -> None:
    if indenter_m is None:
        return
    under = np.maximum(indenter_m, np.finfo(float).min)
    if under.shape != (n,) or not np.isfinite(under).all() or (np.diff(under) > 0).any():
        raise InputError(
            f"indenter {indenter_m.shape} for {n} radii: give its underside [m] at each r, rising away from "
            "the axis, -inf where there is none"
        )
