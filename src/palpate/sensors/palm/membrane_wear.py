"""Wear of a clear membrane: haze, scratches, and yellowing in both views.

Each becomes light * keep + add per region. Scattered light is assumed wide and fully depolarised, so the
lifted dark field is an upper bound. All sizes are assumed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from palpate.core import Bool, Float, Float32, InputError, RangeError, ndarray
from palpate.optics.colour import Spectrum

MAX_SCRATCHES = 1000

VEIL_M = 10e-3  # half width of the tent over which scattered light spreads (assumed)

GLOW = 0.3  # fraction of scratch-scattered lamp light that joins the veil (assumed)

SCRATCH_M = (1e-3, 5e-3)  # half length of a scratch (assumed)

BEND_M = 25e-3  # minimum bend radius of a scratch (assumed)

YELLOW_AT_M, YELLOW_TAIL_M = 450e-9, 60e-9
"""Reference wavelength of `Wear.yellowing`, and e-folding length of the absorbance (assumed)."""

MAX_WORN_HAZE, MAX_WORN_SCRATCHES, PRESSES = 0.3, 24, 10_000.0
"""Limits of `worn`, and the number of presses that reach 63 % of them (assumed)."""


@dataclass(frozen=True, slots=True)
class Wear:
    """State of a worn membrane; new by default.

    Attributes:
        haze: Fraction of light scattered out of the beam, 0 to 1, as a haze meter measures it.
        scratches: Number of scratches in each region, 0 to 1000; more scratches of one seed include the
            fewer.
        scratch_width_m: Width of the widest scratch [m]; others have at least 0.3 of it.
        scratch_strength: Fraction of light the strongest scatters, 0 to 1; others have at least 0.3 of it.
        yellowing: Decadic absorbance at 450 nm along the diameter, 0 to 3.
    """

    haze: float = 0.0
    scratches: int = 0
    scratch_seed: int = 0
    scratch_width_m: float = 60e-6
    scratch_strength: float = 0.7
    yellowing: float = 0.0

    def __post_init__(self) -> None:
        for name, (least, greatest, unit) in _RANGES.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and least <= value <= greatest):
                raise RangeError(
                    f"the wear's {name} is {value}; give {least:g} to {greatest:g} {unit}", code="wear-range"
                )
        for name in ("scratches", "scratch_seed"):
            if not isinstance(getattr(self, name), int):
                raise InputError(f"the wear's {name} is {getattr(self, name)!r}; give a whole number")

    @property
    def shows(self) -> bool:
        return bool(self.haze or self.scratches or self.yellowing)


_RANGES = {
    "haze": (0.0, 1.0, "(a share of light)"),
    "scratches": (0, MAX_SCRATCHES, "scratches"),
    "scratch_seed": (0, 2**63, "(a whole number)"),
    "scratch_width_m": (1e-6, 1e-3, "m"),
    "scratch_strength": (0.0, 1.0, "(a share of light)"),
    "yellowing": (0.0, 3.0, "(an absorbance)"),
}


def worn(presses: float) -> Wear:
    """Return the wear after a number of presses by an assumed saturating law, without yellowing."""
    if not (math.isfinite(presses) and presses >= 0):
        raise RangeError(f"{presses} presses; give a finite number, 0 or more", code="press-count")
    share = -math.expm1(-presses / PRESSES)
    return Wear(haze=MAX_WORN_HAZE * share, scratches=round(MAX_WORN_SCRATCHES * share))


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """Effect of a worn membrane on one region's light."""

    keep: Float32[ndarray, "h w 3"]
    add: Float32[ndarray, "h w 3"]

    def over(self, light: Float32[ndarray, "h w 3"], lamp_gain: float) -> None:
        """Apply to light in place; scattered light scales with the lamp."""
        light *= self.keep
        light += self.add if lamp_gain == 1.0 else np.float32(lamp_gain) * self.add


def film(
    wear: Wear,
    scratched: Float[ndarray, "h w"],
    veil: Float[ndarray, "h w"],
    passed: Float[ndarray, "w 3"],
    covered: Bool[ndarray, "h w"],
    glow: float = GLOW,
) -> Film:
    """Combine haze, scratches, and yellowing.

    Args:
        wear: State of the membrane.
        scratched: Fraction of light scattered by scratches, from `scratches_over`.
        veil: Image of light that is scattered completely.
        passed: Transmission of the yellowed bulk, from `passed_by`.
        covered: Where the camera looks through the membrane.
        glow: Fraction of scratch-scattered light that joins the veil.
    """
    keep = np.where(covered, (1 - wear.haze) * (1 - scratched), 1.0)
    scattered = np.where(covered, wear.haze * (1 - scratched) + glow * scratched, 0.0) * veil
    colour = np.where(covered[..., None], passed, 1.0)
    return Film(
        (keep[..., None] * colour).astype(np.float32), (scattered[..., None] * colour).astype(np.float32)
    )


def spread(light: Float[ndarray, "h w"], pitches_m: tuple[float, float]) -> Float[ndarray, "h w"]:
    """Return the mean of light under a wide tent: what a scattering surface shows."""
    cells = [2 * round(VEIL_M / 2 / pitch) + 1 for pitch in reversed(pitches_m)]
    once = uniform_filter(np.asarray(light, dtype=float), cells, mode="constant")
    return np.asarray(uniform_filter(once, cells, mode="constant"))


def passed_by(yellowing: float, path: Float[ndarray, " w"], spectrum: Spectrum) -> Float[ndarray, "w 3"]:
    """Return the transmission of yellowed silicone in each channel by Beer's law, exact for the lamp's
    spectrum.

    Args:
        yellowing: Absorbance, see `Wear`.
        path: Path through the membrane over its diameter.
        spectrum: Lamp and camera.
    """
    absorbance = yellowing * np.exp((YELLOW_AT_M - spectrum.wavelength_m) / YELLOW_TAIL_M)
    return np.asarray(10 ** (-path[:, None] * absorbance) @ spectrum.weight)


def scratches_over(
    wear: Wear,
    stream: int,
    x_m: Float[ndarray, " w"],
    z_m: Float[ndarray, " h"],
    box_m: tuple[tuple[float, float], tuple[float, float]],
) -> Float[ndarray, "h w"]:
    """Return the fraction of light that scratches scatter, averaged over each pixel.

    Args:
        wear: State of the membrane.
        stream: Number of the region.
        x_m, z_m: Columns and rows on the surface, equally spaced [m].
        box_m: Bounds of x and z of the scratches' centers [m].
    """
    clear = np.ones((len(z_m), len(x_m)))
    drawn = np.random.default_rng([wear.scratch_seed, stream]).uniform(size=(wear.scratches, 7))
    for one in drawn:
        _scratch(clear, one, wear, x_m, z_m, box_m)
    return 1 - clear


def _scratch(
    clear: Float[ndarray, "h w"],
    drawn: Float[ndarray, " 7"],
    wear: Wear,
    x_m: Float[ndarray, " w"],
    z_m: Float[ndarray, " h"],
    box_m: tuple[tuple[float, float], tuple[float, float]],
) -> None:
    """Add one scratch: a slightly bent line that fades towards its ends."""
    x0, z0 = (low + (high - low) * part for (low, high), part in zip(box_m, drawn[:2], strict=True))
    cos, sin = math.cos(math.pi * drawn[2]), math.sin(math.pi * drawn[2])
    half = SCRATCH_M[0] * (SCRATCH_M[1] / SCRATCH_M[0]) ** drawn[3]
    bend = (2 * drawn[4] - 1) / BEND_M
    width = wear.scratch_width_m * (0.3 + 0.7 * drawn[5])
    strength = wear.scratch_strength * (0.3 + 0.7 * drawn[6])
    rows, columns = (
        slice(*np.searchsorted(axis, (middle - 1.1 * half, middle + 1.1 * half)))
        for axis, middle in ((z_m, z0), (x_m, x0))
    )
    dx, dz = x_m[columns] - x0, z_m[rows, None] - z0
    along = cos * dx + sin * dz
    aside = cos * dz - sin * dx - bend * along**2 / 2
    pixel = abs(sin) * (x_m[1] - x_m[0]) + abs(cos) * (z_m[1] - z_m[0])  # its width across the line
    share = np.clip((width + pixel) / 2 - np.abs(aside), 0, min(width, pixel)) / pixel
    clear[rows, columns] *= 1 - strength * share * np.clip(1 - (along / half) ** 2, 0, 1)
