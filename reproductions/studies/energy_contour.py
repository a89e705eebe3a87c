"""Equation (3) put to the test: does an iso-strain-energy contour grow by the flux of what the pins see?

The report has dA_c/dF as the integral of a flow's normal part over the contour c of equal strain energy
density, equal to the integral of the flow's divergence inside, and takes the pins' optical flow for that
flow. With r(phi, F) where the skin's place phi is, and phi_L(F) where its energy density is L,

    d(pi r_L^2)/dF = 2 pi r dr/dF (at phi)  +  2 pi r dr/dphi dphi_L/dF.

The first is the flux of the skin's own motion through the contour, which pins follow; the second is how fast
the contour passes over the skin, which no marker follows. If (3) held for the pins, the second would be 0.

What the pins' markers do in the image is another motion than the skin's, since levers and the camera magnify
it: so both are asked, the `skin` across the axis and the `image`, in which areas are scaled as the report
scales them, by the untouched field of pins.

The skin's energy has the shape of a wall around the contact: low inside, greatest a little outside of the
edge, falling from there. So a level has two contours, on the wall's inner and on its outer flank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress
from palpate.sensors.tactip import TacTipSpec
from palpate_reproductions.tactip.tactip_conditions import KAPPA_N_M, POLAR, head_on, marker_radii_px

LEVELS_PA = (150.0, 300.0, 600.0)
HALF = "half"  # of the greatest at each force, instead of a fixed level
REACH = np.deg2rad(80.0)  # beyond, the held base has an energy of its own
FINE = np.linspace(0.0, REACH, 1601)
STEP_N = 0.25  # to either side: the tables' energy is known to its cells only

Flank = Literal["inner", "outer"]
FLANKS: tuple[Flank, ...] = ("inner", "outer")  # the crest and the contact's edge are on the inner one alone
View = Literal["skin", "image"]
Level = float | Literal["half", "peak", "contact"]
Forces = Float[ndarray, " _"]


@dataclass(frozen=True)
class Contour:
    """A contour on one specimen, at forces; NaN where the skin has no such contour.

    Attributes:
        level: of strain energy density [J/m^3]; "half" of the greatest at each force, its "peak", or the true
            edge of the "contact", which is no contour of energy but what (3) is meant to follow.
        view: of the skin's places, or of their pins' markers in the image.
        flux_m2_n: of the motion through the contour: the integral of its divergence inside [m^2/N].
        contact_m2, casr_m2_n: true contact area, and its dA/dF.
    """

    kappa_n_m: float
    level: Level
    flank: Flank
    view: View
    force_n: Forces
    area_m2: Forces
    growth_m2_n: Forces
    flux_m2_n: Forces
    contact_m2: Forces
    casr_m2_n: Forces

    @property
    def carried(self) -> Forces:
        """Share of the growth that the motion carries: 1 if (3) held for pins."""
        return self.flux_m2_n / self.growth_m2_n


def contour(
    spec: TacTipSpec,
    kappa_n_m: float,
    level: Level,
    flank: Flank,
    view: View = "skin",
    force_n: Sequence[float] = (1.0, 2.0, 3.0, 4.0, 5.0),
) -> Contour:
    """A contour's own growth, and the flux through it."""
    press, at = head_on(spec, kappa_n_m).press, np.array(force_n)

    def area(polar: Forces, force: Forces) -> Forces:
        return np.pi * _radius_m(spec, press, view, polar, force) ** 2

    def slope(above: Forces, below: Forces) -> Forces:
        return (above - below) / (2 * STEP_N)

    up, down = at + STEP_N, at - STEP_N
    here, later, before = (contour_rad(press, level, flank, f) for f in (at, up, down))
    return Contour(
        kappa_n_m, level, flank, view, at, area(here, at),
        slope(area(later, up), area(before, down)),
        slope(area(here, up), area(here, down)),  # the same places of the skin
        press.at("area_m2", at), slope(press.at("area_m2", up), press.at("area_m2", down)),
    )  # fmt: skip


def contour_rad(press: HeadOnPress, level: Level, flank: Flank, force_n: Forces) -> Forces:
    """Polar angle where the contour lies at every force, NaN where there is none."""
    if level == "contact":
        return press.at("angle_rad", force_n)
    results = []
    for energy in press.at("energy_pa", force_n):
        curve = PchipInterpolator(press.polar_rad, energy)(FINE)
        top = int(np.argmax(curve))
        if level == "peak":
            results.append(_crest(curve, top))
            continue
        height = curve[top] / 2 if level == HALF else float(level)
        results.append(_down(curve[top::-1], FINE[top::-1], height) if flank == "inner" else
                     _down(curve[top:], FINE[top:], height))  # fmt: skip
    return np.array(results)


def _down(energy: Float[ndarray, " n"], polar: Float[ndarray, " n"], level: float) -> float:
    """Polar angle at which the energy first falls to a level, going down from the top."""
    under = energy <= level
    if energy[0] <= level or not under.any():
        return float("nan")
    i = int(np.argmax(under))
    t = (energy[i - 1] - level) / (energy[i - 1] - energy[i])
    return float(polar[i - 1] + t * (polar[i] - polar[i - 1]))


def _crest(energy: Float[ndarray, " n"], top: int) -> float:
    """The top of a parabola through the wall near it: single cells know it to their size only."""
    near = np.abs(FINE - FINE[top]) < np.deg2rad(4.0)
    a, b, _ = np.polyfit(FINE[near], energy[near], 2)
    return float(-b / (2 * a))


def _radius_m(spec: TacTipSpec, press: HeadOnPress, view: View, polar: Forces, force_n: Forces) -> Forces:
    """Distance from the axis of the skin's places, or of their markers, as they have moved at each force."""
    if view == "skin":
        rows, at = press.at("inside_m", force_n)[..., 0], press.polar_rad
    else:
        metre = spec.pins.rings * spec.pins.pitch_m / spec.camera.disc_px
        rows, at = metre * marker_radii_px(spec, press, force_n), POLAR
    known = np.where((polar >= at[0]) & (polar <= at[-1]), polar, np.nan)
    return np.array([float(CubicSpline(at, row)(p)) for row, p in zip(rows, known, strict=True)])


def contours(
    spec: TacTipSpec | None = None,
    force_n: Sequence[float] = (2.0, 3.0, 4.0),
    levels: Sequence[Level] = (*LEVELS_PA, "half", "peak", "contact"),
    view: View = "skin",
) -> tuple[Contour, ...]:
    """Every contour on all specimens, stiffest first."""
    return tuple(
        contour(spec or TacTipSpec(), kappa, level, flank, view, force_n)
        for level in levels
        for flank in (FLANKS[:1] if level in ("peak", "contact") else FLANKS)
        for kappa in KAPPA_N_M.values()
    )
