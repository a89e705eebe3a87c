"""Models of a fingertip on a rigid flat, and on elastic flats.

    hertz            elastic ball, to a contact radius of half its own
    exponential      F = b (exp(m d) - 1), A = k F^n with n from 0 to 2/3
    finite-strain    gel hemisphere under a skin, scaled from the tables of `tip_table`

On a soft flat, `on_flat` replaces the finger at each force by the Hertz ball with its approach and area
(error at most 5 % in approach and 11 % in area for the tabulated tips at 0.5 to 2 N).

References: D. T. V. Pawluk, R. D. Howe, J. Biomech. Eng. 121 (1999) 178, doi:10.1115/1.2835100; N. Xydas,
I. Kao, Int. J. Robotics Res. 18 (1999) 941, doi:10.1177/02783649922066673.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.axisymmetric.tip_table import tip_table
from palpate.mechanics.half_space.hertz import MAX_SLOPE, Body, positive

EXPONENTIAL_TO_N = 2.0  # maximum force of Pawluk and Howe's presses
HERTZ_EXPONENT = 2 / 3  # exponent of area over force

Forces = Float[ndarray, "*n"]
Law = Callable[[Forces], Forces]


@dataclass(frozen=True, slots=True)
class Fingertip:
    """A fingertip on a flat.

    Attributes:
        greatest_n: Maximum force of the model [N].
        source: Origin and constants, in words.
        approach, area: Unchecked laws; use `approach_m` and `area_m2`.
    """

    name: str
    greatest_n: float
    source: str
    approach: Law
    area: Law

    def approach_m(self, force_n: float | Forces) -> Forces:
        """Displacement at a force [m]."""
        return self._of(self.approach, force_n)

    def area_m2(self, force_n: float | Forces) -> Forces:
        """Contact area at a force [m^2]."""
        return self._of(self.area, force_n)

    def _of(self, law: Law, force_n: float | Forces) -> Forces:
        force = np.asarray(force_n, float)
        if not np.all((force >= 0) & (force <= self.greatest_n * (1 + 1e-12))):
            raise RangeError(
                f"a fingertip of the model {self.name!r} is known from 0 to {self.greatest_n:.4g} N, and was "
                "asked outside that; press less, or take a model that reaches further",
                code="outside-law",
            )
        return np.asarray(law(np.minimum(np.atleast_1d(force), self.greatest_n))).reshape(force.shape)


def hertz_fingertip(ball: Body) -> Fingertip:
    """Return an elastic ball on a rigid flat, to a contact radius of half its own."""
    if not ball.radius_m < math.inf:
        raise RangeError(
            "a fingertip of infinite radius; give a finite one, in mm, such as 15", code="not-finite"
        )
    widest = MAX_SLOPE * ball.radius_m
    return Fingertip(
        "hertz",
        4 / 3 * ball.modulus_pa * widest**3 / ball.radius_m,
        f"Hertz: ball of {ball.modulus_pa / 1e3:g} kPa (over 1 - nu²) and {ball.radius_m * 1e3:g} mm",
        lambda F: np.asarray(ball.approach_m(F)),
        lambda F: np.asarray(ball.area_m2(F)),
    )


def exponential_fingertip(
    scale_n: float,
    rate_per_m: float,
    area_at_1n_m2: float,
    area_exponent: float,
    greatest_n: float = EXPONENTIAL_TO_N,
) -> Fingertip:
    """Return F = b (exp(m d) - 1) and A = k F^n with the constants of a finger.

    Args:
        scale_n: b [N].
        rate_per_m: m [1/m].
        area_at_1n_m2: k, the area at 1 N [m^2].
        area_exponent: n, above 0 and at most 2/3.
        greatest_n: Maximum fitted force, at most 2 N.
    """
    positive("the exponential's scale b", scale_n, "N")
    positive("the exponential's rate m", rate_per_m, "1/m")
    positive("the area at 1 N", area_at_1n_m2, "m^2")
    if not 0 < area_exponent <= HERTZ_EXPONENT + 1e-12:
        raise RangeError(
            f"area grows as force to the power {area_exponent:g}; above 0 and at most 2/3, which is Hertz's, "
            "are allowed",
            code="exponent-range",
        )
    if not 0 < greatest_n <= EXPONENTIAL_TO_N:
        raise RangeError(
            f"an exponential fingertip to {greatest_n:g} N; above 0 and at most {EXPONENTIAL_TO_N:g} N, "
            "where it was found, are allowed",
            code="outside-law",
        )
    return Fingertip(
        "exponential",
        greatest_n,
        f"F = b (exp(m d) - 1), b {scale_n:g} N, m {rate_per_m / 1e3:g}/mm (form: Pawluk and Howe, "
        f"doi:10.1115/1.2835100); A = k F^n, k {area_at_1n_m2 * 1e6:g} mm², n {area_exponent:.4g} (form: "
        "Xydas and Kao, doi:10.1177/02783649922066673); constants as given",
        lambda F: np.log1p(F / scale_n) / rate_per_m,
        lambda F: area_at_1n_m2 * F**area_exponent,
    )


def finite_strain_fingertip(tip: str, radius_m: float, gel_pa: float) -> Fingertip:
    """Return a tabulated tip at finite strain, scaled to a radius and gel modulus.

    Args:
        tip: Name of the tip, see `tip_table.shipped_tips`.
        radius_m: Radius of the hemisphere [m].
        gel_pa: Young's modulus under the skin [Pa]; the skin keeps the table's proportions.
    """
    positive("the fingertip's radius", radius_m, "m")
    positive("the fingertip's Young's modulus", gel_pa, "Pa")
    table = tip_table(tip)
    press = table.press(math.inf)
    most, long = float(press.force_n[-1]), radius_m / table.radius_m
    strong = gel_pa / table.gel_pa * long**2
    return Fingertip(
        "finite-strain",
        most * strong,
        f"finite strain: hemisphere of {radius_m * 1e3:g} mm, {gel_pa / 1e3:g} kPa under a skin of "
        f"{table.skin_m * long * 1e3:g} mm and {table.skin_pa * gel_pa / table.gel_pa / 1e3:g} kPa "
        f"(table {tip!r}, similar)",
        lambda F: long * press.at("approach_m", _within(F / strong, most)),
        lambda F: long**2 * press.at("area_m2", _within(F / strong, most)),
    )


def _within(force: Forces, greatest_n: float) -> Forces:
    """Force without rounding above the table's last."""
    return np.asarray(np.minimum(force, greatest_n))


def on_flat(tip: Fingertip, flat_pa: float) -> Fingertip:
    """Return the fingertip on an elastic flat, as the equivalent Hertz ball at each force.

    Approach and area d, A on a rigid flat give R = A / (pi d) and E_f = 3 F / (4 sqrt(R d^3)); on a flat both
    grow by (1 + E_f / E_o)^(2/3). The range ends at the finger's maximum area on a rigid flat.

    Args:
        tip: Fingertip on a rigid flat.
        flat_pa: Flat's Young's modulus over 1 - nu^2 [Pa], possibly infinite.
    """
    if not flat_pa > 0:
        raise RangeError(f"a flat of {flat_pa:g} Pa; give more than 0 Pa", code="not-positive")

    def growth(force: Forces) -> Forces:
        d, A = tip.approach(force), tip.area(force)
        pressed = (d > 0) & (A > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            finger_pa = 3 * force / (4 * d * np.sqrt(A / np.pi))  # sqrt(R d^3) = d sqrt(A / pi)
        return np.asarray((1 + np.where(pressed, finger_pa, 0.0) / flat_pa) ** (2 / 3))

    def area(force: Forces) -> Forces:
        return np.asarray(tip.area(force) * growth(force))

    widest = tip.area_m2(tip.greatest_n)

    def beyond(force: float) -> float:
        return float(area(np.array([force]))[0] / widest) - 1

    most = tip.greatest_n
    if beyond(most) > 0:
        most = brentq(beyond, 0.0, most, xtol=1e-300, rtol=1e-12)
    return Fingertip(
        tip.name,
        most,
        f"{tip.source}; on a flat of {flat_pa / 1e3:g} kPa (over 1 - nu²), as the ball of Hertz that the "
        "finger is like at each force",
        lambda F: tip.approach(F) * growth(F),
        area,
    )
