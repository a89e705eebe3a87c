"""Variation between palm units of one design, and with temperature. The distribution is assumed and wide.

Distribution of palms and presses from which networks are trained. It is assumed, wide, and shares no value
with the virtual rig or the presets.

Units differ in modulus, stress-optic coefficient, thickness, polariser, and mirror; presses on one unit in
lamp, camera, registration, dirt, glare, and detected contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palpate.core import RangeError
from palpate.optics.image_chain import AutoExposure, CameraResponse, ImageChain
from palpate.sensors.palm.membrane_faults import Glare, MirrorDirt, ResidualMap, UnevenGel
from palpate.sensors.palm.palm_press import has_table
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.press_corrections import rim_reach

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


Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class PressLaw:
    """Uniform ranges; those of factors and noise are log-uniform. All assumed.

    Attributes:
        copies: Maximum number of palm units.
        modulus, coefficient, thickness, lamp: Factors over the design.
        stiffening: Stiffness of a fresh press over a relaxed one.
        hang_mm: Height of the probe over the untouched membrane [mm].
        threshold_n: Contact threshold of a rig [N].
        late_mm: Additional depth at detected contact [mm].
        jpeg_quality: 1 to 100; half of the presses are not compressed.
        shift_px, turn_deg: Registration of each region [px, degrees].
        residual, frozen: Residual birefringence, varying and uniform.
        corner_loss: Vignetting beyond the design's.
        stops: Change of automatic exposure, either way.
    """

    copies: int = 16
    modulus: Range = (0.55, 1.6)
    coefficient: Range = (0.6, 1.9)
    thickness: Range = (0.91, 1.08)
    stiffening: Range = (1.0, 1.25)
    polariser_deg: Range = (-3.0, 4.0)
    elevation_deg: Range = (-3.0, 2.0)
    hang_mm: Range = (0.6, 1.9)
    threshold_n: Range = (0.015, 0.3)
    late_mm: Range = (0.0, 0.045)
    lamp: Range = (0.7, 1.25)
    mired: Range = (-15.0, 25.0)
    full_well_e: Range = (3_000.0, 32_000.0)
    read_noise_e: Range = (2.0, 16.0)
    blur_px: Range = (0.0, 0.7)
    jpeg_quality: tuple[int, int] = (75, 99)
    shift_px: Range = (-0.25, 0.35)
    turn_deg: Range = (-0.6, 0.8)
    residual: Range = (0.0, 2.5e-7)
    frozen: Range = (0.0, 2.5e-7)
    ambient: Range = (0.0, 0.02)
    corner_loss: Range = (-0.15, 0.25)
    specks: tuple[int, int] = (0, 25)
    texture: Range = (0.0, 0.07)
    spots: tuple[int, int] = (0, 3)
    glare: Range = (0.0, 0.1)
    stops: Range = (0.0, 1 / 3)

    def copy(self, design: PalmSpec, rng: np.random.Generator) -> PalmSpec:
        """Draw a palm unit."""
        law = design.stress_optic
        made = replace(
            design,
            youngs_modulus_pa=design.youngs_modulus_pa * _factor(self.modulus, rng),
            stress_optic=replace(
                law, coefficient_per_pa=law.coefficient_per_pa * _factor(self.coefficient, rng)
            ),
            polariser_rad=design.polariser_rad + math.radians(rng.uniform(*self.polariser_deg)),
            mirror_elevation_rad=design.mirror_elevation_rad + math.radians(rng.uniform(*self.elevation_deg)),
        )
        thick = replace(made, thickness_m=design.thickness_m * _factor(self.thickness, rng))
        return thick if has_table(thick) else made

    def view(self, design: PalmSpec, rng: np.random.Generator) -> dict[str, Any]:
        """Draw the fields of a spec by which a press's frames differ."""
        seeds = [int(seed) for seed in rng.integers(2**31, size=3)]
        quality = int(rng.integers(self.jpeg_quality[0], self.jpeg_quality[1] + 1))
        corner = design.corner_loss + rng.uniform(*self.corner_loss)
        return {
            "lamp_gain": design.lamp_gain * _factor(self.lamp, rng),
            "lamp_mired": design.lamp_mired + rng.uniform(*self.mired),
            "ambient": design.ambient + rng.uniform(*self.ambient),
            "corner_loss": float(np.clip(corner, 0.0, 1.0)),
            "camera": self.camera(design.camera, rng),
            "chain": ImageChain(rng.uniform(*self.blur_px), 0.0, quality if rng.uniform() < 0.5 else None),
            "fringes": replace(design.fringes, **self.registration(rng)),
            "mirror": replace(design.mirror, **self.registration(rng)),
            "residual": ResidualMap(rng.uniform(*self.residual), seeds[0]),
            "frozen_birefringence": rng.uniform(*self.frozen),
            "frozen_axis_rad": rng.uniform(0.0, math.pi),
            "dirt": MirrorDirt(
                int(rng.integers(self.specks[0], self.specks[1] + 1)),
                texture=rng.uniform(*self.texture),
                seed=seeds[1],
            ),
            "glare": Glare(
                int(rng.integers(self.spots[0], self.spots[1] + 1)), rng.uniform(*self.glare), seed=seeds[2]
            ),
            "auto_exposure": AutoExposure(_factor(LIGHT_RANGE, rng), max_stops=rng.uniform(*self.stops)),
        }

    def camera(self, design: CameraResponse, rng: np.random.Generator) -> CameraResponse:
        return replace(
            design,
            full_well_e=_factor(self.full_well_e, rng),
            read_noise_e=_factor(self.read_noise_e, rng),
        )

    def registration(self, rng: np.random.Generator) -> dict[str, Any]:
        shift = float(rng.uniform(*self.shift_px)), float(rng.uniform(*self.shift_px))
        return {"shift_px": shift, "turn_rad": math.radians(rng.uniform(*self.turn_deg))}

    def zero(self, rng: np.random.Generator) -> tuple[float, float]:
        """Draw a contact threshold [N] and additional depth [mm]."""
        return _factor(self.threshold_n, rng), float(rng.uniform(*self.late_mm))

    def lamp_now(self, rng: np.random.Generator) -> float:
        return _factor(self.lamp, rng)


LIGHT_RANGE: Range = (0.01, 0.05)  # target of the automatic exposure


def _factor(within: Range, rng: np.random.Generator) -> float:
    return math.exp(rng.uniform(math.log(within[0]), math.log(within[1])))


PRESS_LAW = PressLaw()
