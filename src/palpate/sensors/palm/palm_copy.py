"""One copy of the palm, found from its own pictures: what it is, and how far presses tell.

A picture of the ball's press depends on place and depth, on the product of modulus and stress-optic
coefficient, E C, since the stress that turns the light is E times a function of shape, and on lamp,
polariser and mirror. The force is E times a function of depth. So with C known a picture tells the force
whatever E is; with both unknown it tells no more than their product, and one known force tells both.

All of it is one estimate: terms of the copy with a prior, place and depth of each press, pixels as they were
measured, and known forces where there are any. A calibration, a reading and a check with a known weight
differ in what is known beforehand, and in nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palpate.core import Float, Pose, RangeError, UInt8, ndarray
from palpate.estimators.known_terms import term_rows
from palpate.optics.stress_optic import StressOpticLaw
from palpate.sensors.palm.palm_spec import PalmSpec, View

TERMS = (
    "modulus", "product", "lamp", "polariser_rad", "elevation_rad", "mirror_across_px", "mirror_down_px",
    "fringes_across_px", "fringes_down_px", "ambient", "corner_loss", "mired", "blur_px",
)  # fmt: skip
"""Logarithms of E, of E C and of the lamp's light over the design's; turns of polariser and of the mirror's
line of sight; shifts of both regions in the frame; room light and corner loss beyond the design's; the lamp's
colour; and the lens's blur."""

Terms = Float[ndarray, " t"]
Covariance = Float[ndarray, "t t"]


@dataclass(frozen=True, eq=False)
class PalmCopy:
    """A copy of the palm: a spec, and terms by which it differs from it.

    Attributes:
        spec: the palm as designed.
        terms: see `TERMS`; 0 is the spec.
        covariance: of them.
    """

    spec: PalmSpec
    terms: Terms
    covariance: Covariance

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
        law = self.spec.stress_optic
        return replace(
            self.spec,
            stress_optic=replace(law, coefficient_per_pa=law.coefficient_per_pa * math.exp(at["product"])),
            lamp_gain=self.spec.lamp_gain * math.exp(at["lamp"]),
            polariser_rad=self.spec.polariser_rad + at["polariser_rad"],
            mirror_elevation_rad=self.spec.mirror_elevation_rad + at["elevation_rad"],
            mirror=_moved(self.spec.mirror, at["mirror_across_px"], at["mirror_down_px"]),
            fringes=_moved(self.spec.fringes, at["fringes_across_px"], at["fringes_down_px"]),
            ambient=max(self.spec.ambient + at["ambient"], 0.0),
            corner_loss=min(max(self.spec.corner_loss + at["corner_loss"], 0.0), 1.0),
            lamp_mired=self.spec.lamp_mired + at["mired"],
            chain=replace(self.spec.chain, blur_px=max(at["blur_px"], 0.0)),
        )

    @property
    def as_spec(self) -> PalmSpec:
        """The copy's own spec, with its E and its C."""
        law = StressOpticLaw(self.coefficient_per_pa, self.spec.stress_optic.dispersion_m2)
        return replace(self.looks, youngs_modulus_pa=self.modulus_pa, stress_optic=law)


def _moved(view: View, across_px: float, down_px: float) -> View:
    cx, cy = view.middle_px
    return replace(view, middle_px=(cx + across_px, cy + down_px))


SPREADS = {
    "lamp": 0.1, "polariser_rad": math.radians(2.0), "elevation_rad": math.radians(1.5),
    "mirror_across_px": 1.0, "mirror_down_px": 1.0, "fringes_across_px": 0.5, "fringes_down_px": 0.5,
    "ambient": 0.01, "corner_loss": 0.1, "mired": 8.0, "blur_px": 0.4,
}  # fmt: skip
"""By how much copies differ from their design, as standard deviations. Assumed."""
BLUR_PX = 0.5  # of a lens, where nothing is known of it. Assumed.


def designed_copy(
    spec: PalmSpec, *, modulus_share: float = 0.25, coefficient_share: float = 0.25,
    spreads: Mapping[str, float] = SPREADS,
) -> PalmCopy:  # fmt: skip
    """What is known of a copy before it was pressed: its design, and how far copies differ.

    Args:
        spec: the design.
        modulus_share, coefficient_share: standard deviations of E and C, as shares.
        spreads: of all other terms, in their units.

    Raises:
        RangeError: a spread that is not finite or not above 0.
    """
    others = [spreads[name] for name in TERMS[2:]]
    if not all(math.isfinite(one) and one > 0 for one in (modulus_share, coefficient_share, *others)):
        raise RangeError(
            f"spreads of copies: modulus {modulus_share}, coefficient {coefficient_share}, {dict(spreads)}; "
            "each has to be finite and above 0"
        )
    covariance = np.diag(np.square([modulus_share, math.hypot(modulus_share, coefficient_share), *others]))
    covariance[0, 1] = covariance[1, 0] = modulus_share**2  # E C holds E
    terms = np.zeros(len(TERMS))
    terms[TERMS.index("blur_px")] = BLUR_PX
    return PalmCopy(spec, terms, covariance)


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
        off: root mean square of what the picture differs from the copy's, over white.
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
    def pose(self) -> Pose:
        """Place and depth."""
        return Pose(self.x_m, self.y_m, self.depth_m)


@dataclass(frozen=True, eq=False)
class CopyFit:
    """A copy after its presses.

    Attributes:
        copy: as known now.
        presses: what each picture told.
        untold: terms of which the presses told less than a fifth of what was known before.
    """

    copy: PalmCopy
    presses: tuple[PressFound, ...]
    untold: tuple[str, ...]
