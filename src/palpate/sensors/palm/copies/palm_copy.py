"""One unit of the palm: its terms, its presses, and their prior.

An image determines position, depth, and the product E C; the force is E times a function of depth. With C
known an image gives the force; with both unknown one known force determines both. Calibration, reading, and
weight check are one estimate that differs only in the prior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palpate.core import Float, Pose, RangeError, UInt8, ndarray
from palpate.estimators.unit_fit import Widening, term_rows
from palpate.sensors.palm.membrane_faults import SIDE_MODES, ResidualMap
from palpate.sensors.palm.palm_spec import PalmSpec, View

PIXEL_SD = 0.007  # standard deviation of a pixel over white
PARTS = ("along", "aside")
MODES = 8  # modes of the residual birefringence up to second order

TERMS = (
    "modulus", "product", "lamp", "polariser_rad", "elevation_rad", "mirror_across_px", "mirror_down_px",
    "fringes_across_px", "fringes_down_px", "ambient", "corner_loss", "mired", "blur_px",
    "thickness", "mirror_turn_rad", "fringes_turn_rad", "mirror_scale", "fringes_scale",
    "residual_along", "residual_aside", "harder_across", "harder_along",
    *(f"residual_{part}_{i}{j}" for part in PARTS for i, j in SIDE_MODES[:MODES]),
)  # fmt: skip
"""Terms relative to the design: log E, log E C, and log lamp; angles of polariser and mirror; shifts of both
regions; room light; corner loss; lamp color [mired]; blur; log thickness; rotations and log sizes of both
regions; residual birefringence along the axes and diagonals [wavelengths per diameter]; growth of log E to
the rim along x and y; weights of `side_modes` of both residual components."""
RESIDUAL_MODES = {part: tuple(one for one in TERMS if one.startswith(f"residual_{part}_")) for part in PARTS}
"""Names of the residual modes of each component."""

LOCAL = (
    "x_m", "y_m", "log_depth", "exposure", "harder", "thicker", "residual_along", "residual_aside",
)  # fmt: skip
"""Unknowns of one press: position, log depth, log exposure over the untouched frame's, and local deviations
of the membrane in the terms' units."""

Terms = Float[ndarray, " t"]
Covariance = Float[ndarray, "t t"]
Local = Float[ndarray, " 8"]


AS_SAID = Widening()
"""Widening without held-out presses."""

LOCAL_SPREADS = {
    "exposure": 0.01, "harder": 0.012, "thicker": 0.004, "residual_along": 0.004, "residual_aside": 0.004,
}  # fmt: skip
"""Standard deviations of one press from its unit's terms. Assumed."""


@dataclass(frozen=True, eq=False)
class PalmCopy:
    """A unit of the palm as a specification and deviations from it.

    Attributes:
        terms: Values of `TERMS`; 0 is the spec.
        widening: Factors of new readings' intervals from held-out presses.
        local_spreads: Standard deviations of `LOCAL` from exposure on.
    """

    spec: PalmSpec
    terms: Terms
    covariance: Covariance
    widening: Widening = AS_SAID
    local_spreads: tuple[float, ...] = tuple(LOCAL_SPREADS.values())

    @property
    def modulus_pa(self) -> float:
        return self.spec.youngs_modulus_pa * math.exp(self.terms[0])

    @property
    def coefficient_per_pa(self) -> float:
        return self.spec.stress_optic.coefficient_per_pa * math.exp(self.terms[1] - self.terms[0])

    @property
    def modulus_share(self) -> float:
        """Relative standard deviation of E."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def coefficient_share(self) -> float:
        """Relative standard deviation of C."""
        towards = np.zeros(len(TERMS))
        towards[:2] = -1.0, 1.0
        return math.sqrt(towards @ self.covariance @ towards)

    @property
    def told(self) -> dict[str, dict[str, float]]:
        """Each term with its standard deviation."""
        return term_rows(TERMS, self.terms, self.covariance)

    @property
    def looks(self) -> PalmSpec:
        """Spec of a palm that looks like this unit; E is the design's and C absorbs the product."""
        at = dict(zip(TERMS, self.terms.tolist(), strict=True))
        spec, law = self.spec, self.spec.stress_optic
        size, axis = residual_of(spec, at["residual_along"], at["residual_aside"])
        mirror = spec.mirror.moved(at["mirror_across_px"], at["mirror_down_px"])
        fringes = spec.fringes.moved(at["fringes_across_px"], at["fringes_down_px"])
        return replace(
            spec,
            stress_optic=replace(law, coefficient_per_pa=law.coefficient_per_pa * math.exp(at["product"])),
            lamp_gain=spec.lamp_gain * math.exp(at["lamp"]),
            polariser_rad=spec.polariser_rad + at["polariser_rad"],
            mirror_elevation_rad=spec.mirror_elevation_rad + at["elevation_rad"],
            mirror=_turned(mirror, at["mirror_turn_rad"], at["mirror_scale"]),
            fringes=_turned(fringes, at["fringes_turn_rad"], at["fringes_scale"]),
            ambient=max(spec.ambient + at["ambient"], 0.0),
            corner_loss=min(max(spec.corner_loss + at["corner_loss"], 0.0), 1.0),
            lamp_mired=spec.lamp_mired + at["mired"],
            chain=replace(spec.chain, blur_px=max(at["blur_px"], 0.0)),
            thickness_m=spec.thickness_m * math.exp(at["thickness"]),
            frozen_birefringence=size,
            frozen_axis_rad=axis,
            residual=self._residual,
        )

    @property
    def _residual(self) -> ResidualMap:
        along, aside = (
            tuple(self.terms[[AT[one] for one in RESIDUAL_MODES[part]]].tolist()) for part in PARTS
        )
        unit = self.spec.stress_optic.reference_wavelength_m / self.spec.diameter_m
        return ResidualMap(unit, modes=(along, aside)) if any(along + aside) else self.spec.residual

    def under(self, local: Local) -> PalmCopy:
        """Unit with the membrane's local deviations of one press, see `LOCAL`."""
        terms = self.terms.copy()
        for name, value in zip(LOCAL[5:], local[5:], strict=True):
            terms[AT["thickness" if name == "thicker" else name]] += value
        terms[AT["product"]] += harder_at(self, local)
        return replace(self, terms=terms)


AT = {name: i for i, name in enumerate(TERMS)}
"""Index of each term."""


def harder_at(copy: PalmCopy, local: Local) -> float:
    """Return the logarithm of E at a press over the unit's."""
    across, along = copy.terms[AT["harder_across"]], copy.terms[AT["harder_along"]]
    return float((across * local[0] + along * local[1]) / copy.spec.radius_m + local[4])


def residual_of(spec: PalmSpec, along: float, aside: float) -> tuple[float, float]:
    """Return the total residual birefringence and its axis [rad] of a design and components in wavelengths
    per diameter.
    """
    unit = spec.stress_optic.reference_wavelength_m / spec.diameter_m
    turn = 2 * spec.frozen_axis_rad
    u = spec.frozen_birefringence * math.cos(turn) + unit * along
    v = spec.frozen_birefringence * math.sin(turn) + unit * aside
    return math.hypot(u, v), math.atan2(v, u) / 2


def _turned(view: View, turn_rad: float, scale: float) -> View:
    wide, high = (pitch * math.exp(-scale) for pitch in view.pitches_m)
    rows = None if view.row_pitch_m is None else high
    return replace(view, pitch_m=wide, row_pitch_m=rows, turn_rad=view.turn_rad + turn_rad)


SPREADS = {
    "lamp": 0.2, "polariser_rad": math.radians(2.0), "elevation_rad": math.radians(1.5),
    "mirror_across_px": 1.0, "mirror_down_px": 1.0, "fringes_across_px": 0.5, "fringes_down_px": 0.5,
    "ambient": 0.01, "corner_loss": 0.1, "mired": 8.0, "blur_px": 0.4,
    "thickness": 0.02, "mirror_turn_rad": math.radians(0.4), "fringes_turn_rad": math.radians(0.4),
    "mirror_scale": 0.003, "fringes_scale": 0.003, "residual_along": 0.012, "residual_aside": 0.012,
    "harder_across": 0.015, "harder_along": 0.015,
    **dict.fromkeys((*RESIDUAL_MODES["along"], *RESIDUAL_MODES["aside"]), 0.003),
}  # fmt: skip
"""Standard deviations of units about their design. Assumed."""
MAX_TIMES = 5.0  # maximum ratio of a measured C to the design's, or its inverse
BLUR_PX = 0.5  # prior blur of a lens (assumed)


def designed_copy(
    spec: PalmSpec, *, modulus_share: float = 0.25, coefficient_share: float = 0.25,
    spreads: Mapping[str, float] = SPREADS, local_spreads: Mapping[str, float] = LOCAL_SPREADS,
) -> PalmCopy:  # fmt: skip
    """Return the prior of a unit: its design and the spread of units.

    Args:
        spec: Design.
        modulus_share, coefficient_share: Relative standard deviations of E and C.
        spreads: Standard deviations of all other terms.
        local_spreads: Standard deviations of `LOCAL` from exposure on.
    """
    others, own = (
        [of[name] for name in names] for of, names in ((spreads, TERMS[2:]), (local_spreads, LOCAL[3:]))
    )
    shares = {"share of the modulus": modulus_share, "share of the coefficient": coefficient_share}
    bad = [
        f"{name} {one:g}"
        for name, one in [*shares.items(), *spreads.items(), *local_spreads.items()]
        if not (math.isfinite(one) and one > 0)
    ]
    if bad:
        raise RangeError(f"spreads: {', '.join(bad)}; give finite ones above 0", code="not-positive")
    covariance = np.diag(np.square([modulus_share, math.hypot(modulus_share, coefficient_share), *others]))
    covariance[0, 1] = covariance[1, 0] = modulus_share**2  # E C holds E
    terms = np.zeros(len(TERMS))
    terms[TERMS.index("blur_px")] = BLUR_PX
    return PalmCopy(spec, terms, covariance, local_spreads=tuple(own))


def measured_copy(
    spec: PalmSpec, coefficient_per_pa: float, coefficient_share: float = 0.02, modulus_share: float = 0.25
) -> PalmCopy:
    """Return the prior of a unit with a measured stress-optic coefficient.

    Args:
        spec: Design.
        coefficient_per_pa: C [1/Pa].
        coefficient_share, modulus_share: Relative standard deviations of C and of the design's E.
    """
    for name, share in (("coefficient", coefficient_share), ("modulus", modulus_share)):
        if share > 1:
            raise RangeError(f"ratio {share:g} of the {name}; give 1 or less", code="ratio-range")
    designed = spec.stress_optic.coefficient_per_pa
    times = coefficient_per_pa / designed
    if not (math.isfinite(times) and 1 / MAX_TIMES <= times <= MAX_TIMES):
        raise RangeError(
            f"a stress-optic coefficient of {coefficient_per_pa:.3g} /Pa; this design has "
            f"{designed:.3g} /Pa, and {designed / MAX_TIMES:.2g} to {designed * MAX_TIMES:.2g} "
            "/Pa are allowed (1 brewster is 1e-12 /Pa)",
            code="coefficient-range",
        )
    copy = designed_copy(spec, modulus_share=modulus_share, coefficient_share=coefficient_share)
    terms = copy.terms.copy()
    terms[AT["product"]] = math.log(times)
    return replace(copy, terms=terms)


@dataclass(frozen=True, eq=False)
class PicturedPress:
    """A frame of the ball's press, with its force where known.

    Attributes:
        image, reference: Whole frames under load and untouched, 8-bit sRGB.
        force_n: Known force [N] or None.
        force_share: Relative standard deviation of the force.
        place_m: Known position (x, y) [m] or None.
        place_sd_m: Standard deviation of the position per axis [m].
    """

    image: UInt8[ndarray, "h w 3"]
    reference: UInt8[ndarray, "h w 3"]
    force_n: float | None = None
    force_share: float = 0.01
    place_m: tuple[float, float] | None = None
    place_sd_m: float = 30e-6


class PressFound(NamedTuple):
    """Reading of one image.

    Attributes:
        force_share: Standard deviation of the force's logarithm.
        off: Rms difference from the unit's image over white, away from edges.
    """

    x_m: float
    y_m: float
    depth_m: float
    force_n: float
    x_sd_m: float
    y_sd_m: float
    depth_sd_m: float
    force_share: float
    off: float

    @property
    def misfit(self) -> float:
        """Difference from the unit's image in pixel standard deviations."""
        return self.off / PIXEL_SD

    @property
    def pose(self) -> Pose:
        return Pose(self.x_m, self.y_m, self.depth_m)


@dataclass(frozen=True, eq=False)
class CopyFit:
    """A unit after its presses.

    Attributes:
        presses: Reading of each image.
        untold: Terms whose variance fell by less than a fifth, without the residual birefringence's modes.
    """

    copy: PalmCopy
    presses: tuple[PressFound, ...]
    untold: tuple[str, ...]
