"""One copy of the palm, found from its own pictures: what it is, and how far presses tell.

A picture of the ball's press depends on place and depth, on the product of modulus and stress-optic
coefficient, E C, since the stress that turns the light is E times a function of shape, and on lamp,
polariser and mirror. The force is E times a function of depth. So with C known a picture tells the force
whatever E is; with both unknown it tells no more than their product, and one known force tells both.

All of it is one estimate: terms of the copy with a prior, place and depth of each press, pixels as they were
measured, and known forces where there are any. A calibration, a reading and a check with a known weight
differ in what is known beforehand, and in nothing else. Where one press finds the membrane other than the
copy's terms say, by an uneven modulus or thickness or by what is frozen in there, is a few unknowns of that
press, small beforehand.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palpate.core import Float, Pose, RangeError, UInt8, ndarray
from palpate.estimators.unit_fit import Widening, term_rows
from palpate.optics.stress_optic import StressOpticLaw
from palpate.sensors.palm.palm_spec import PalmSpec, View
from palpate.sensors.palm.uneven_membrane import SIDE_MODES, ResidualMap

PIXEL_SD = 0.007  # of a pixel, of white: a little more than what is left of it
PARTS = ("along", "aside")
MODES = 8  # of the residual birefringence: those of the side view that no third order is in

TERMS = (
    "modulus", "product", "lamp", "polariser_rad", "elevation_rad", "mirror_across_px", "mirror_down_px",
    "fringes_across_px", "fringes_down_px", "ambient", "corner_loss", "mired", "blur_px",
    "thickness", "mirror_turn_rad", "fringes_turn_rad", "mirror_scale", "fringes_scale",
    "residual_along", "residual_aside", "harder_across", "harder_along",
    *(f"residual_{part}_{i}{j}" for part in PARTS for i, j in SIDE_MODES[:MODES]),
)  # fmt: skip
"""Logarithms of E, of E C and of the lamp's light over the design's; turns of polariser and of the mirror's
line of sight; shifts of both regions in the frame; room light and corner loss beyond the design's; the lamp's
colour; the lens's blur; the thickness's logarithm; both regions' turns, and logarithms of size; residual
birefringence along the axes and along their diagonals, in wavelengths over the diameter; by how much the
logarithm of E grows from the middle to the rim, along x and along y; and by how much both parts of the
residual birefringence vary over the side view, as weights of `side_modes` of order up to 2 each way, in the
same unit."""
RESIDUAL_MODES = {part: tuple(one for one in TERMS if one.startswith(f"residual_{part}_")) for part in PARTS}
"""Names of these, of each part."""

LOCAL = (
    "x_m", "y_m", "log_depth", "exposure", "harder", "thicker", "residual_along", "residual_aside",
)  # fmt: skip
"""Unknowns of one press: place, logarithm of the depth in m and of the exposure over the untouched frame's,
and by how much the membrane differs there from what the copy's terms say, in the terms' units."""

Terms = Float[ndarray, " t"]
Covariance = Float[ndarray, "t t"]
Local = Float[ndarray, " 8"]


AS_SAID = Widening()
"""No press was held out."""

LOCAL_SPREADS = {
    "exposure": 0.01, "harder": 0.012, "thicker": 0.004, "residual_along": 0.004, "residual_aside": 0.004,
}  # fmt: skip
"""By how much one press differs from what its copy's terms say. Assumed."""


@dataclass(frozen=True, eq=False)
class PalmCopy:
    """A copy of the palm: a spec, and terms by which it differs from it.

    Attributes:
        spec: the palm as designed.
        terms: see `TERMS`; 0 is the spec.
        covariance: of them.
        widening: of what new presses are read to be, by the presses that the copy was found from.
        local_spreads: standard deviations of `LOCAL` from exposure on: by how much one press differs from
            what the terms say.
    """

    spec: PalmSpec
    terms: Terms
    covariance: Covariance
    widening: Widening = AS_SAID
    local_spreads: tuple[float, ...] = tuple(LOCAL_SPREADS.values())

    @property
    def modulus_pa(self) -> float:
        """E [Pa]."""
        return self.spec.youngs_modulus_pa * math.exp(self.terms[0])

    @property
    def coefficient_per_pa(self) -> float:
        """C [1/Pa]."""
        return self.spec.stress_optic.coefficient_per_pa * math.exp(self.terms[1] - self.terms[0])

    @property
    def modulus_share(self) -> float:
        """Standard deviation of E, as a share."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def coefficient_share(self) -> float:
        """Standard deviation of C, as a share."""
        towards = np.zeros(len(TERMS))
        towards[:2] = -1.0, 1.0
        return math.sqrt(towards @ self.covariance @ towards)

    @property
    def told(self) -> dict[str, dict[str, float]]:
        """Each term and its standard deviation."""
        return term_rows(TERMS, self.terms, self.covariance)

    @property
    def looks(self) -> PalmSpec:
        """Spec of a palm that looks as this copy does; its E is the design's, its C takes all the product."""
        at = dict(zip(TERMS, self.terms.tolist(), strict=True))
        spec, law = self.spec, self.spec.stress_optic
        size, axis = residual_of(spec, at["residual_along"], at["residual_aside"])
        mirror = _moved(spec.mirror, at["mirror_across_px"], at["mirror_down_px"])
        fringes = _moved(spec.fringes, at["fringes_across_px"], at["fringes_down_px"])
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
        """What is frozen in unevenly, beyond the design's, which is taken to have none."""
        along, aside = (
            tuple(self.terms[[AT[one] for one in RESIDUAL_MODES[part]]].tolist()) for part in PARTS
        )
        unit = self.spec.stress_optic.reference_wavelength_m / self.spec.diameter_m
        return ResidualMap(unit, modes=(along, aside)) if any(along + aside) else self.spec.residual

    def under(self, local: Local) -> PalmCopy:
        """The copy as one press finds it: even, with what the membrane is there; see `LOCAL`."""
        terms = self.terms.copy()
        for name, value in zip(LOCAL[5:], local[5:], strict=True):
            terms[AT["thickness" if name == "thicker" else name]] += value
        terms[AT["product"]] += harder_at(self, local)
        return replace(self, terms=terms)

    @property
    def as_spec(self) -> PalmSpec:
        """The copy's own spec, with its E and its C."""
        law = StressOpticLaw(self.coefficient_per_pa, self.spec.stress_optic.dispersion_m2)
        return replace(self.looks, youngs_modulus_pa=self.modulus_pa, stress_optic=law)


AT = {name: i for i, name in enumerate(TERMS)}
"""Place of each term among all."""


def harder_at(copy: PalmCopy, local: Local) -> float:
    """Logarithm of E at a press's place over the copy's own."""
    across, along = copy.terms[AT["harder_across"]], copy.terms[AT["harder_along"]]
    return float((across * local[0] + along * local[1]) / copy.spec.radius_m + local[4])


def residual_of(spec: PalmSpec, along: float, aside: float) -> tuple[float, float]:
    """Residual birefringence and its axis [rad] of a design, and of wavelengths over its diameter."""
    unit = spec.stress_optic.reference_wavelength_m / spec.diameter_m
    turn = 2 * spec.frozen_axis_rad
    u = spec.frozen_birefringence * math.cos(turn) + unit * along
    v = spec.frozen_birefringence * math.sin(turn) + unit * aside
    return math.hypot(u, v), math.atan2(v, u) / 2


def _moved(view: View, across_px: float, down_px: float) -> View:
    cx, cy = view.middle_px
    return replace(view, middle_px=(cx + across_px, cy + down_px))


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
"""By how much copies differ from their design, as standard deviations. Assumed."""
MAX_TIMES = 5.0  # a measured C may be as much more or less than its design's
BLUR_PX = 0.5  # of a lens, where nothing is known of it. Assumed.


def designed_copy(
    spec: PalmSpec, *, modulus_share: float = 0.25, coefficient_share: float = 0.25,
    spreads: Mapping[str, float] = SPREADS, local_spreads: Mapping[str, float] = LOCAL_SPREADS,
) -> PalmCopy:  # fmt: skip
    """What is known of a copy before it was pressed: its design, and how far copies differ.

    Args:
        spec: the design.
        modulus_share, coefficient_share: standard deviations of E and C, as shares.
        spreads: of all other terms, in their units.
        local_spreads: of what one press differs by; as small as can be, they say that the terms are all.
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
    """What is known of a copy whose stress-optic coefficient was measured.

    Args:
        spec: the design, whose E, lamp, mirror and regions are taken.
        coefficient_per_pa: C [1/Pa].
        coefficient_share, modulus_share: standard deviations of C and of the design's E, as shares.
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
    """A frame of the ball's press, and its force where it is known.

    Attributes:
        image: 8-bit sRGB, the whole frame ``[h w 3]``.
        reference: the same of the untouched skin, with which it is compared to find where the press is.
        force_n: None where it is not known [N].
        force_share: standard deviation of the known force, as a share of it.
        place_m: where a stage pressed, x and y; None where it is not known [m].
        place_sd_m: standard deviation of it, each way [m].
    """

    image: UInt8[ndarray, "h w 3"]
    reference: UInt8[ndarray, "h w 3"]
    force_n: float | None = None
    force_share: float = 0.01
    place_m: tuple[float, float] | None = None
    place_sd_m: float = 30e-6


class PressFound(NamedTuple):
    """What one picture tells.

    Attributes:
        x_m, y_m, depth_m, force_n: place, depth and force.
        x_sd_m, y_sd_m, depth_sd_m: standard deviations.
        force_share: standard deviation of the force's logarithm.
        off: root mean square of what the picture differs from the copy's, over white, away from edges.
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
        """Difference from the copy's picture over the stated error of a pixel."""
        return self.off / PIXEL_SD

    @property
    def pose(self) -> Pose:
        """Place and depth."""
        return Pose(self.x_m, self.y_m, self.depth_m)


@dataclass(frozen=True, eq=False)
class CopyFit:
    """A copy after its presses.

    Attributes:
        copy: as known now.
        presses: what each picture told.
        untold: terms of which the presses told less than a fifth of what was known before; the residual
            birefringence's variation is not listed.
    """

    copy: PalmCopy
    presses: tuple[PressFound, ...]
    untold: tuple[str, ...]
