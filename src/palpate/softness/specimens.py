"""Two-cylinder silicone specimens of the published classes under an elastic ball.

    CL1  two cylinders of one silicone;  CL2  a rigid cylinder on silicone;  CL3  two silicones, and mirrored

Young's moduli are given by the caller. CL1 and CL3 are laterally infinite bonded layers (`finger_on_stack`).
CL2 is a finger on a rigid flat in series with a bonded disc (Gent and Lindley),

    F = E_a A d / h,    1 / E_a = 1 / [E (1 + 2 S^2)] + 3 (1 - 2 nu) / E,    S = radius / 2 h.

References: E. P. Scilingo, M. Bianchi, G. Grioli, A. Bicchi, Rendering softness, IEEE Trans. Haptics 3 (2010)
109, doi:10.1109/TOH.2010.2, sec. 4.2; A. N. Gent, P. B. Lindley, The compression of bonded rubber blocks,
Proc. Inst. Mech. Eng. 173 (1959) 111, as given in doi:10.5545/sv-jme.2013.1510, equations 1 and 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.interpolate import CubicSpline

from palpate.core import InputError, RangeError
from palpate.mechanics.fingertip_laws import hertz_fingertip
from palpate.mechanics.half_space.hertz import Body
from palpate.mechanics.layers.influence import MAX_STRAIN, press_course
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.softness.characteristics import SoftObject, pressed_object

HEIGHT_M = 7e-3
RADIUS_M = 18.5e-3
SOFTENER = (0, 10, 20, 35, 45)  # percent
POISSON = 0.499  # of silicone: nearly incompressible
PRESSES = 40
FINE = 513


class SpecimenClass(StrEnum):
    """How two cylinders are stacked."""

    ALIKE = "CL1"
    PLATE = "CL2"
    MIRRORED = "CL3"


@dataclass(frozen=True, slots=True)
class StackedSpecimen:
    """Two cylinders on a rigid table; `above_pa` is infinite for a rigid one."""

    kind: SpecimenClass
    name: str
    above_pa: float
    below_pa: float
    poisson: float = POISSON


def specimens(
    kind: SpecimenClass, moduli_pa: Sequence[float], poisson: float = POISSON
) -> tuple[StackedSpecimen, ...]:
    """Return the five specimens of a class; moduli fall with 0, 10, 20, 35, and 45 % softener."""
    E = [float(one) for one in moduli_pa]
    if len(E) != len(SOFTENER):
        raise InputError(
            f"{len(E)} moduli; give five, with {', '.join(map(str, SOFTENER))} % of softener, in kPa",
            code="moduli-count",
        )
    if not (np.isfinite(E).all() and min(E) > 0):
        raise RangeError("give five finite moduli above 0 kPa", code="modulus")
    if not (np.diff(E) < 0).all():
        raise InputError(
            f"moduli of {', '.join(f'{1e-3 * one:g}' for one in E)} kPa do not fall; softener makes a "
            "silicone softer: give them from 0 to 45 %",
            code="moduli-order",
        )
    if not 0 <= poisson < 0.5:
        raise RangeError(
            f"a Poisson's ratio of {poisson:g}; 0 to below 0.5 are allowed, a silicone has 0.499",
            code="poisson",
        )
    last = len(E) - 1
    if kind == SpecimenClass.ALIKE:
        return tuple(
            StackedSpecimen(kind, f"{kind} {SOFTENER[i]} %", E[i], E[i], poisson) for i in range(last + 1)
        )
    if kind == SpecimenClass.PLATE:
        return tuple(
            StackedSpecimen(kind, f"{kind} plate on {SOFTENER[i]} %", np.inf, E[i], poisson)
            for i in range(last + 1)
        )
    return tuple(
        StackedSpecimen(kind, f"{kind} {SOFTENER[i]} % on {SOFTENER[last - i]} %", E[i], E[last - i], poisson)
        for i in range(last + 1)
    )


def series_spread(all_: Sequence[StackedSpecimen]) -> float:
    """Greatest over least of 1 / E_above + 1 / E_below, less 1: how far springs in a line would differ."""
    sums = [1 / one.above_pa + 1 / one.below_pa for one in all_]
    return max(sums) / min(sums) - 1


def plate_stiffness_n_m(below_pa: float, poisson: float = POISSON) -> float:
    """Force over displacement of a rigid plate on one silicone cylinder, bonded to plate and table [N/m]."""
    return bonded_disc_n_m(below_pa, poisson, RADIUS_M, HEIGHT_M)


def bonded_disc_n_m(modulus_pa: float, poisson: float, radius_m: float, height_m: float) -> float:
    """Force over displacement of a disc between two rigid plates that it sticks to [N/m]."""
    shape = radius_m / (2 * height_m)
    soft = 1 / (1 + 2 * shape**2) + 3 * (1 - 2 * poisson)
    return modulus_pa / soft * np.pi * radius_m**2 / height_m


def specimen_object(one: StackedSpecimen, finger: Body, until_n: float | None = None) -> SoftObject:
    """Return both cues of a specimen under an elastic ball, up to `until_n` or the limit of small strain."""
    solve = _plate if one.kind == SpecimenClass.PLATE else _layers
    try:
        force, approach, area = solve(one, finger, until_n)
    except RangeError as e:
        raise RangeError(f"{one.name}: {e}", code=e.code) from e
    above = "rigid" if np.isinf(one.above_pa) else f"{one.above_pa / 1e3:g} kPa"
    model = "a rigid plate on a bonded disc" if one.kind == SpecimenClass.PLATE else "bonded layers"
    return pressed_object(
        one.name, force, approach, area,
        f"{model}, small strain: {above} on {one.below_pa / 1e3:g} kPa (Poisson's ratio {one.poisson:g}), "
        f"each {HEIGHT_M * 1e3:g} mm, under a finger of {finger.modulus_pa / 1e3:.4g} kPa (over 1 - nu²) and "
        f"{finger.radius_m * 1e3:g} mm",
    )  # fmt: skip


def _layers(
    one: StackedSpecimen, finger: Body, until_n: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    stack = Stack(tuple(ElasticLayer(HEIGHT_M, E, one.poisson) for E in (one.above_pa, one.below_pa)))
    course = press_course(stack, finger, PRESSES, until_n)
    a = np.linspace(0.0, course.radius_m[-1], FINE)
    force, approach = (
        CubicSpline(course.radius_m, column)(a) for column in (course.force_n, course.approach_m)
    )
    return force, approach, np.pi * a**2


def _plate(
    one: StackedSpecimen, finger: Body, until_n: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    stiffness = plate_stiffness_n_m(one.below_pa, one.poisson)
    most = min(hertz_fingertip(finger).greatest_n, MAX_STRAIN * HEIGHT_M * stiffness)
    end = most if until_n is None else until_n
    if not 0 < end <= most * (1 + 1e-9):
        raise RangeError(
            f"a press to {end:g} N; above 0 and at most {most:.4g} N are allowed, where the contact has half "
            "of the finger's radius or the silicone is pressed in by a fifth of its height",
            code="force-range",
        )
    force = end * np.linspace(0.0, 1.0, FINE) ** 3
    return force, np.asarray(finger.approach_m(force)) + force / stiffness, np.asarray(finger.area_m2(force))
