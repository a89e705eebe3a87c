"""How palms of one design differ: copies drawn from a law of their own, and temperature.

The law is assumed, and wider than what one workshop would make: it is for tests of what holds on any copy,
and for what a network is to have seen. It shares no constant with the virtual rig's `Variation`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from palpate.core import RangeError
from palpate.optics.camera_response import AutoExposure
from palpate.optics.image_chain import ImageChain
from palpate.sensors.palm.palm_rim import rim_reach
from palpate.sensors.palm.palm_spec import PalmSpec, View
from palpate.sensors.palm.uneven_membrane import ResidualMap, UnevenGel
from palpate.sensors.palm.view_faults import Glare, MirrorDirt

ROOM_K = 296.0
MAX_WARMER_K = 60.0
MEAN_LIGHT = 0.025  # that an automatic exposure aims at: of most frames. Assumed.


@dataclass(frozen=True, slots=True)
class CopySpread:
    """Standard deviations of copies about their design; ranges are even. All assumed.

    Attributes:
        modulus_share, coefficient_share: of the logarithms of E and C.
        lamp_share: of the lamp's logarithm.
        mired: of the lamp's colour.
        polariser_rad, elevation_rad: of the first polariser and of the mirror's line of sight [rad].
        region_px: of where either region lies in the frame, along either axis [px].
        ambient: of the room's light, half of a normal law, over the lamp at its brightest.
        corner_loss: of the loss of light at the corner.
        blur_px: least and greatest of the lens's blur [px].
        distortion: of the lens, at the corner.
        jpeg_quality: least and greatest.
        thickness_share: of the logarithm of the membrane's thickness.
        kelvin: of the temperature about that at which E and C are stated [K].
        gel_modulus, gel_thickness: greatest root mean square by which either varies over a disc.
        residual: greatest root mean square of the birefringence frozen in, of each component.
        frozen: of the uniform part of it; its axis is any.
        specks, texture: most specks of dirt, and greatest texture, in the mirror's view.
        spots, glare: most reflections, and the greatest light of one.
        turn_rad: by which either region is turned in the frame [rad].
        stops: greatest change of exposure that the camera makes by itself, either way; below half a step of a
            third of a stop it makes none.
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
"""Copies with every fault that a membrane, a mirror, a window and a camera are given here. All assumed."""


def drawn_palm(design: PalmSpec, rng: np.random.Generator, spread: CopySpread | None = None) -> PalmSpec:
    """One copy of a design, whose skin gives way near its rim where that was solved.

    Args:
        design: what copies are made after.
        rng: the only source of chance.
        spread: how far copies differ; None for the law as it is stated.
    """
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
        fringes=_moved(design.fringes, s.region_px * z[6], s.region_px * z[7]),
        mirror=_moved(design.mirror, s.region_px * z[8], s.region_px * z[9]),
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
    """A copy with what differs from place to place in it, and its temperature."""
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


def _moved(view: View, across_px: float, down_px: float) -> View:
    cx, cy = view.middle_px
    return replace(view, middle_px=(cx + float(across_px), cy + float(down_px)))


def warmed(
    spec: PalmSpec,
    temperature_k: float,
    calibrated_k: float = ROOM_K,
    *,
    modulus_per_k: float | None = None,
    coefficient_per_k: float | None = None,
) -> PalmSpec:
    """The palm at another temperature: E grows as it, and C falls as it, as of an ideal rubber.

    Their product stays, so that a press to one depth looks the same, and only its force changes: by a third
    of a per cent a kelvin. Of real silicones neither is exact: fillers and free chains change both. What was
    measured of one is given in place of the law.

    Args:
        spec: at the temperature at which its E and C were found.
        temperature_k: now [K].
        calibrated_k: then [K].
        modulus_per_k, coefficient_per_k: change of the logarithm of E, and of C, with temperature [1/K]; None
            for the ideal rubber's.
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
