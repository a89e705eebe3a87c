"""Direction of an edge: principal axis of the samples that moved most, an angle of period pi.

Its standard error combines redrawn mark noise and the choice of the ratio of samples.

Reference: K. V. Mardia and P. E. Jupp, Directional Statistics (2000), section 1.1 on axial data,
doi:10.1002/9780470316979.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, InputError, ndarray
from palpate.estimators.surface_strain.strain_fields import StrainFields

DEFORMED_SHARE = 0.1  # ratio of the samples; assumed, not in the thesis
OTHER_SHARES = (0.7, 1.4)  # multiples of that ratio, for the error
DRAWS = 48
NORMAL_90 = 1.6449  # standard errors of a two-sided 90 % interval
MIN_ELONGATION = 1.6  # length over width of what has moved most: a round contact has up to 1.3
MIN_SHIFT = 5.0  # times the marks' noise
HALF_TURN = math.pi


@dataclass(frozen=True, slots=True)
class EdgeDirection:
    """Direction of an edge, an angle of period pi.

    Attributes:
        angle_rad: Angle from the marks' x axis towards y, 0 to pi.
        error_rad: Standard error.
        half_rad: Half-width of its 90 % interval, at most pi/2.
        elongation: Length over width of the samples that moved most (standard deviations).
        centre: Center of these samples (x, y) [unit of the marks].
    """

    angle_rad: float
    error_rad: float
    half_rad: float
    elongation: float
    centre: tuple[float, float]

    def contains(self, angle_rad: float) -> bool:
        """Return whether an angle, modulo half turns, lies within the 90 % interval."""
        return abs(axial_difference(angle_rad, self.angle_rad)) <= self.half_rad


def axial_difference(one_rad: float, other_rad: float) -> float:
    """Return the shortest turn from the other direction to the one, -pi/2 to pi/2 [rad].

    Example:
        >>> round(axial_difference(math.radians(179), math.radians(1)), 4)
        -0.0349
    """
    return (one_rad - other_rad + HALF_TURN / 2) % HALF_TURN - HALF_TURN / 2


def edge_direction(fields: StrainFields, most_deformed: float = DEFORMED_SHARE) -> EdgeDirection | None:
    """Return the direction of the edge in contact; None without contact or for a round one.

    Args:
        fields: Strain fields of the frame.
        most_deformed: Ratio of the samples, by their shift, that is used; 0.01 to 0.5.
    """
    if not 0.01 <= most_deformed <= 0.5:
        raise InputError(f"a share of {most_deformed} of the samples; give 0.01 to 0.5", code="ratio-range")
    seen = fields.basis.supported
    at, shifts = fields.at[:, seen], fields.displacement[:, seen]
    noise = math.sqrt(float(fields.variances.sum(axis=0).mean()))
    if np.quantile(np.hypot(*shifts), 1 - most_deformed) < MIN_SHIFT * noise:
        return None
    angle, elongation, centre = _axis(at, shifts, most_deformed)
    if elongation < MIN_ELONGATION:
        return None
    rng = np.random.default_rng(0)
    spread = np.sqrt(fields.variances.sum(axis=0))[:, None]
    drawn = []
    for _ in range(DRAWS):
        net = fields.basis.net(spread * rng.standard_normal(fields.rest.shape))
        again = _axis(at, shifts + fields.basis.sampled(net)[:, seen], most_deformed)
        drawn.append(axial_difference(again[0], angle))
    others = [
        axial_difference(_axis(at, shifts, min(0.5, most_deformed * share))[0], angle)
        for share in OTHER_SHARES
    ]
    error = math.hypot(float(np.std(drawn)), math.sqrt(float(np.mean(np.square(others)))))
    half = min(NORMAL_90 * error, HALF_TURN / 2)
    return EdgeDirection(angle % HALF_TURN, error, half, elongation, centre)


def _axis(
    at: Float[ndarray, "2 k"], shifts: Float[ndarray, "2 k"], share: float
) -> tuple[float, float, tuple[float, float]]:
    """Principal axis [rad], length over width, and center of the samples that moved most."""
    size = np.hypot(*shifts)
    count = max(3, int(share * len(size)))
    most = at[:, np.argpartition(size, -count)[-count:]]
    centre = most.mean(axis=1)
    (xx, xy), (_, yy) = np.cov(most)
    half, middle = math.hypot((xx - yy) / 2, xy), (xx + yy) / 2
    elongation = math.sqrt((middle + half) / max(middle - half, 1e-12 * middle))
    return math.atan2(2 * xy, xx - yy) / 2, elongation, (float(centre[0]), float(centre[1]))
