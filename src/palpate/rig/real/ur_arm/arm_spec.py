"""Specification of an arm: its address, frame, box, speeds and times.

Frame of a rig in that of an arm's base: a rotation and a zero, with the tool's orientation kept fixed.

The rig's frame is x right, y towards the viewer, z into the skin; the arm's base has its own. A place p of
the rig is at R p + zero in the base. R must be a rotation: a mirrored frame would send the probe to the wrong
side, and a z that is turned round would send it into the skin at every lift.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.core import InputError, Position, RangeError

Rows = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
Pose = tuple[float, float, float, float, float, float]
"""Place [m] and rotation vector [rad] of the tool in the arm's base."""

MAX_SKEW = 1e-4  # of R R^T from 1: four decimals, as people write a rotation
MAX_LEAN_DEG = 45.0  # between the tool's own z and the rig's: an indenter presses along its axis


@dataclass(frozen=True, slots=True)
class ArmFrame:
    """Rig's frame, and the one orientation of the tool in it.

    Attributes:
        rotation: rows of R; its columns are the rig's x, y and z in the arm's base.
        zero_m: the rig's zero in the arm's base [m].
        tool_rad: rotation vector of the tool in the arm's base, whose z leads out of the flange [rad].

    Raises:
        InputError: R is no rotation, or the tool's z does not lead into the skin.

    Example:
        >>> down = ArmFrame(((1, 0, 0), (0, -1, 0), (0, 0, -1)), (0.4, 0.1, 0.2), (math.pi, 0, 0))
        >>> down.base_m((0.0, 0.0, 0.05))  # 50 mm into the skin is 50 mm lower
        (0.4, 0.1, 0.15000000000000002)
    """

    rotation: Rows
    zero_m: Position
    tool_rad: Position

    def __post_init__(self) -> None:
        if not np.isfinite([*np.ravel(self.rotation), *self.zero_m, *self.tool_rad]).all():
            raise InputError(
                "rotation, zero and the tool's rotation vector of an arm must be finite numbers",
                code="not-finite",
            )
        skew = np.abs(self._matrix @ self._matrix.T - np.eye(3)).max()
        if skew > MAX_SKEW:
            raise InputError(
                f"rotation is not orthonormal: its rows are off unit length or square by {skew:.2g}, and "
                f"{MAX_SKEW:g} is allowed; give the rig's x, y and z in the arm's base as its columns",
                code="not-orthonormal",
            )
        if np.linalg.det(self._matrix) < 0:
            raise InputError(
                "rotation mirrors (its determinant is -1): the rig's frame is right-handed, x to the right, "
                "y towards the viewer, z into the skin; one of its columns has the wrong sign",
                code="mirrored",
            )
        lean_deg = math.degrees(math.acos(np.clip(self._tool_matrix[:, 2] @ self._matrix[:, 2], -1, 1)))
        if lean_deg > MAX_LEAN_DEG:
            raise InputError(
                f"the tool's z leads {lean_deg:.0f} degrees away from the rig's z, into the skin, and "
                f"{MAX_LEAN_DEG:g} are allowed: rotation or tool_rotvec_rad is turned round",
                code="tool-direction",
            )

    @property
    def _matrix(self) -> np.ndarray:
        return np.asarray(self.rotation, dtype=float)

    @property
    def _tool_matrix(self) -> np.ndarray:
        return Rotation.from_rotvec(self.tool_rad).as_matrix()

    def base_m(self, rig_m: Position) -> Position:
        """Place in the arm's base, R p + zero [m]."""
        x, y, z = (self._matrix @ rig_m + self.zero_m).tolist()
        return x, y, z

    def rig_m(self, base_m: Position) -> Position:
        """Place in the rig's frame, R^T (p - zero) [m]."""
        x, y, z = (self._matrix.T @ np.subtract(base_m, self.zero_m)).tolist()
        return x, y, z

    def tilt_deg(self, tool_rad: Position) -> float:
        """Angle between an orientation of the tool and the stated one [degrees].

        Rotation vectors near pi have two signs for one orientation, so they are not compared themselves.
        """
        between = Rotation.from_rotvec(self.tool_rad).inv() * Rotation.from_rotvec(tool_rad)
        return math.degrees(between.magnitude())


MAX_SPEED_M_S = 0.25
"""Ceiling of an arm's speed: that at which people may be near one (ISO 10218-1, reduced speed) [m/s]."""
MIN_STOP_M_S2, MAX_STOP_M_S2 = 0.1, 10.0
MAX_TILT_DEG = 2.0
MIN_RATE_HZ, MAX_RATE_HZ = 50.0, 500.0


@dataclass(frozen=True, slots=True)
class UrArmSpec:
    """Specification of how an arm is reached, mounted and limited.

    Attributes:
        host: name or address of its controller.
        frame: the rig's frame in the arm's base, and the tool's orientation.
        least_m, greatest_m: where it may be sent, in the rig's frame [m].
        top_speed_m_s: fastest that is allowed; at most `MAX_SPEED_M_S` [m/s].
        acceleration_m_s2: at which a move begins and ends [m/s^2].
        stop_m_s2: at which a stop slows down, and which its distance is counted from [m/s^2].
        latency_s: from asking for a stop until it begins to slow down [s].
        tilt_deg: by which the tool may be found out of the stated orientation [degrees].
        rate_hz: of its status [Hz].
        stale_s: age of a status that is too old [s].
        stop_s: how long a stop may take before its program is ended [s].
        still_s: how long it may stand short of its target before that is a fault [s].

    Raises:
        RangeError: a number is out of its range, or the box is empty.
    """

    host: str
    frame: ArmFrame
    least_m: Position
    greatest_m: Position
    top_speed_m_s: float = 0.05
    acceleration_m_s2: float = 0.5
    stop_m_s2: float = 1.0
    latency_s: float = 0.05
    tilt_deg: float = 0.5
    rate_hz: float = 125.0
    stale_s: float = 0.1
    stop_s: float = 5.0
    still_s: float = 1.0

    def __post_init__(self) -> None:
        ranges = {
            "top_speed_m_s": (0.0, MAX_SPEED_M_S, "m/s"),
            "acceleration_m_s2": (0.0, MAX_STOP_M_S2, "m/s^2"),
            "stop_m_s2": (MIN_STOP_M_S2, MAX_STOP_M_S2, "m/s^2"),
            "latency_s": (0.0, 1.0, "s"),
            "tilt_deg": (0.0, MAX_TILT_DEG, "degrees"),
            "rate_hz": (MIN_RATE_HZ, MAX_RATE_HZ, "Hz"),
            "stale_s": (0.0, 0.5, "s"),
            "stop_s": (0.0, 30.0, "s"),
            "still_s": (0.0, 30.0, "s"),
        }
        for name, (least, most, unit) in ranges.items():
            value = getattr(self, name)
            if not (value > 0 and least <= value <= most):
                raise RangeError(
                    f"{name} is {value} {unit}; give more than 0, and {least:g} to {most:g} {unit}"
                )
        for axis, low, high in zip("xyz", self.least_m, self.greatest_m, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise RangeError(f"the arm's box along {axis} is {low} to {high} m; give a finite, wider one")
