"""Distribution of palms and presses from which networks are trained. It is assumed, wide, and shares no value
with the virtual rig or the presets.

Units differ in modulus, stress-optic coefficient, thickness, polariser, and mirror; presses on one unit in
lamp, camera, registration, dirt, glare, and detected contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palpate.optics.camera_response import AutoExposure, CameraResponse
from palpate.optics.image_chain import ImageChain
from palpate.sensors.palm.palm_press import has_table
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.uneven_membrane import ResidualMap
from palpate.sensors.palm.view_faults import Glare, MirrorDirt

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
            "auto_exposure": AutoExposure(_factor(MEAN_LIGHT, rng), max_stops=rng.uniform(*self.stops)),
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


MEAN_LIGHT: Range = (0.01, 0.05)  # target of the automatic exposure


def _factor(within: Range, rng: np.random.Generator) -> float:
    return math.exp(rng.uniform(math.log(within[0]), math.log(within[1])))


PRESS_LAW = PressLaw()
