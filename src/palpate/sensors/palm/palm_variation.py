"""Variation between palm units of one design, and with temperature. The distribution is assumed and wide."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from palpate.core import RangeError
from palpate.optics.camera_response import AutoExposure
from palpate.optics.image_chain import ImageChain
from palpate.sensors.palm.palm_rim import rim_reach
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.uneven_membrane import ResidualMap, UnevenGel
from palpate.sensors.palm.view_faults import Glare, MirrorDirt

ROOM_K = 296.0
MAX_WARMER_K = 60.0
MEAN_LIGHT = 0.025  # target of the automatic exposure (assumed)


@dataclass(frozen=True, slots=True)
class CopySpread:
    """Spread of palm units about their design: standard deviations, or uniform ranges. All assumed.

    Attributes:
        modulus_share, coefficient_share, lamp_share, thickness_share: Standard deviations of logarithms.
        region_px: Position of either region in the frame [px].
        ambient: Scale of the half-normal room light, over the lamp's maximum.
        blur_px, jpeg_quality: Minimum and maximum.
        kelvin: Deviation of the temperature from calibration [K].
        gel_modulus, gel_thickness, residual: Maximum rms variation over a disc.
        frozen: Uniform residual birefringence; its axis is uniform.
        specks, texture, spots, glare: Maximum values.
        stops: Maximum change of automatic exposure, either way.
    """

    modulus_share: float = 0.15
    coefficient_share: float = 0.15
    lamp_share: float = 0.08
    mired: float = 5.0
    polariser_rad: float = math.radians(1.5)
    elevation_rad: float = math.radians(1.0)
    region_px: float = 0.3
    ambient: float = 0.003
    corner_loss: float = 0.05
    blur_px: tuple[float, float] = (0.2, 0.8)
    distortion: float = 0.0
    jpeg_quality: tuple[int, int] = (92, 98)
    thickness_share: float = 0.0
    kelvin: float = 0.0
    gel_modulus: float = 0.0
    gel_thickness: float = 0.0
    residual: float = 0.0
    frozen: float = 0.0
    specks: int = 0
    texture: float = 0.0
    spots: int = 0
    glare: float = 0.0
    turn_rad: float = 0.0
    stops: float = 0.0


IMPERFECT = CopySpread(
    thickness_share=0.02,
    kelvin=3.0,
    gel_modulus=0.03,
    gel_thickness=0.01,
    residual=1e-7,
    frozen=1e-7,
    specks=12,
    texture=0.03,
    spots=2,
    glare=0.05,
    turn_rad=math.radians(0.3),
    stops=1 / 3,
)
"""Units with imperfections of membrane, mirror, window, and camera."""


def drawn_palm(design: PalmSpec, rng: np.random.Generator, spread: CopySpread | None = None) -> PalmSpec:
    """Draw one palm unit of a design, with an applied rim where it was solved."""
    s = CopySpread() if spread is None else spread
    law, z = design.stress_optic, rng.standard_normal(13)
    even = replace(
        design,
        youngs_modulus_pa=design.youngs_modulus_pa * math.exp(s.modulus_share * z[0]),
        stress_optic=replace(
            law, coefficient_per_pa=law.coefficient_per_pa * math.exp(s.coefficient_share * z[1])
        ),
        lamp_gain=design.lamp_gain * math.exp(s.lamp_share * z[2]),
        lamp_mired=design.lamp_mired + s.mired * float(z[3]),
        polariser_rad=design.polariser_rad + s.polariser_rad * float(z[4]),
        mirror_elevation_rad=design.mirror_elevation_rad + s.elevation_rad * float(z[5]),
        fringes=design.fringes.moved(s.region_px * z[6], s.region_px * z[7]),
        mirror=design.mirror.moved(s.region_px * z[8], s.region_px * z[9]),
        ambient=design.ambient + s.ambient * abs(float(z[10])),
        rim="applied" if rim_reach(design) is not None else design.rim,
        corner_loss=float(np.clip(design.corner_loss + s.corner_loss * z[11], 0.0, 1.0)),
        chain=ImageChain(
            blur_px=float(rng.uniform(*s.blur_px)),
            distortion=s.distortion * float(z[12]),
            jpeg_quality=int(rng.integers(s.jpeg_quality[0], s.jpeg_quality[1] + 1)),
        ),
    )
    return _with_faults(even, s, rng)


def _with_faults(design: PalmSpec, s: CopySpread, rng: np.random.Generator) -> PalmSpec:
    z, u = rng.standard_normal(5), rng.uniform(size=9)
    drawn = (s.gel_modulus + s.gel_thickness, s.residual, s.specks + s.texture, s.spots)
    gel, residual, dirt, glare = (int(rng.integers(2**31)) if size else 0 for size in drawn)
    copy = replace(
        design,
        thickness_m=design.thickness_m * math.exp(s.thickness_share * z[0]),
        frozen_birefringence=design.frozen_birefringence + s.frozen * float(z[1]),
        frozen_axis_rad=design.frozen_axis_rad + (math.pi * float(u[0]) if s.frozen else 0.0),
        gel=UnevenGel(s.gel_modulus * float(u[1]), s.gel_thickness * float(u[2]), gel),
        residual=ResidualMap(s.residual * float(u[3]), residual),
        dirt=MirrorDirt(round(s.specks * u[4]), texture=s.texture * float(u[5]), seed=dirt),
        glare=Glare(round(s.spots * u[6]), s.glare * float(u[7]), seed=glare) if s.spots else design.glare,
        fringes=replace(design.fringes, turn_rad=design.fringes.turn_rad + s.turn_rad * float(z[2])),
        mirror=replace(design.mirror, turn_rad=design.mirror.turn_rad + s.turn_rad * float(z[3])),
        auto_exposure=_exposure(s.stops * float(u[8])) if s.stops else design.auto_exposure,
    )
    return warmed(copy, ROOM_K + s.kelvin * float(z[4]))


def _exposure(stops: float) -> AutoExposure:
    return AutoExposure(MEAN_LIGHT, max_stops=stops)


def warmed(
    spec: PalmSpec,
    temperature_k: float,
    calibrated_k: float = ROOM_K,
    *,
    modulus_per_k: float | None = None,
    coefficient_per_k: float | None = None,
) -> PalmSpec:
    """Return the palm at another temperature; E is proportional to temperature and C inversely (ideal
    rubber).

    Args:
        spec: Palm at `calibrated_k`.
        temperature_k: Temperature [K], within 60 K of `calibrated_k`.
        calibrated_k: Temperature at which E and C were measured [K].
        modulus_per_k, coefficient_per_k: Measured logarithmic change of E and C [1/K]; None for the ideal
            rubber.
    """
    if not abs(temperature_k - calibrated_k) <= MAX_WARMER_K:
        raise RangeError(
            f"{temperature_k} K, and {calibrated_k} K at calibration; {MAX_WARMER_K:g} K apart at most",
            code="temperature-range",
        )
    share, law, warmer = temperature_k / calibrated_k, spec.stress_optic, temperature_k - calibrated_k
    stiffer = share if modulus_per_k is None else math.exp(modulus_per_k * warmer)
    stronger = 1 / share if coefficient_per_k is None else math.exp(coefficient_per_k * warmer)
    return replace(
        spec,
        youngs_modulus_pa=spec.youngs_modulus_pa * stiffer,
        stress_optic=replace(law, coefficient_per_pa=law.coefficient_per_pa * stronger),
    )
