"""Wear of a clear membrane: haze, scratches and yellowing, and what they do to both views.

Use leaves a clouded surface, scratches and yellowed silicone. Each thins the light that comes straight
through and adds some that does not, so both regions of the frame become light * keep + add, with two pictures
that are made once. Light that a surface scatters is taken as spread wide and wholly depolarised: the analyser
passes half of it, also where the field was dark. Real scratches and haze keep part of the polarisation, so
the lifted dark field is an upper bound.

Nobody has measured how this palm wears: its report leaves that to future work. All sizes are assumed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from palpate.core import Bool, Float, Float32, InputError, RangeError, ndarray
from palpate.optics.colour import Spectrum

MAX_SCRATCHES = 1000

VEIL_M = 10e-3
"""Half the width of the tent over which scattered light is spread, on the membrane. Assumed."""

GLOW = 0.3
"""Of the lamp's light that a scratch scatters, what goes into that wide veil: a groove throws most of it
further aside, past the camera. Assumed. Light from all round, as in the mirror's view, has no aside."""

SCRATCH_M = (1e-3, 5e-3)
"""Half the length of a scratch. Assumed."""

BEND_M = 25e-3
"""Radius of the most bent scratch. Assumed."""

YELLOW_AT_M, YELLOW_TAIL_M = 450e-9, 60e-9
"""Where `Wear.yellowing` is stated, and the step in wavelength over which absorbance falls e-fold: the tail
of an absorption in the ultraviolet, as aged polymers have. The step is assumed."""

MAX_WORN_HAZE, MAX_WORN_SCRATCHES, PRESSES = 0.3, 24, 10_000.0
"""Of `worn`: what very many presses end at, and how many presses make 63 % of it. Assumed, not measured."""


@dataclass(frozen=True, slots=True)
class Wear:
    """State of a worn membrane; by default not at all.

    Attributes:
        haze: share of the light that clouded surfaces scatter out of the beam, 0 to 1, as a haze meter counts
            it; 0.01 is clear, 0.3 frosted.
        scratches: how many fine scratches there are in each region, 0 to 1000.
        scratch_seed: which ones; of one seed, more scratches are the same and some more.
        scratch_width_m: of the widest [m]; the others have 0.3 of it and more.
        scratch_strength: share of light that the strongest scatters in its middle, 0 to 1; the others have
            0.3 of it and more.
        yellowing: decadic absorbance at 450 nm along the membrane's diameter, 0 to 3.
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
        """Tell whether a camera would see any of it."""
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
    """A membrane after so many presses, by an assumed law: clouding and scratches that saturate.

    1 - exp(-presses / 10 000) of the most there is. Nothing of this was measured on any membrane; it is for
    drawing how a reading would suffer, not for telling when a membrane must be replaced. Yellowing is left
    out: silicone yellows with time and light, and not with presses.

    Args:
        presses: 0 or more.
    """
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
        """Seen through it, in place; what is scattered is the lamp's, so it goes with the lamp."""
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
    """Haze, scratches and yellowing as one.

    Args:
        wear: how worn.
        scratched: share of the light that scratches scatter, from `scratches_over`.
        veil: what the camera would see of light all of which is scattered.
        passed: by the yellowed bulk, from `passed_by`.
        covered: where the camera looks through the membrane.
        glow: share of what scratches scatter that joins the veil.
    """
    keep = np.where(covered, (1 - wear.haze) * (1 - scratched), 1.0)
    scattered = np.where(covered, wear.haze * (1 - scratched) + glow * scratched, 0.0) * veil
    colour = np.where(covered[..., None], passed, 1.0)
    return Film(
        (keep[..., None] * colour).astype(np.float32), (scattered[..., None] * colour).astype(np.float32)
    )


def spread(light: Float[ndarray, "h w"], pitches_m: tuple[float, float]) -> Float[ndarray, "h w"]:
    """Light as a scattering surface before it shows it: its mean under a wide tent, with none from beyond."""
    cells = [2 * round(VEIL_M / 2 / pitch) + 1 for pitch in reversed(pitches_m)]
    once = uniform_filter(np.asarray(light, dtype=float), cells, mode="constant")
    return np.asarray(uniform_filter(once, cells, mode="constant"))


def passed_by(yellowing: float, path: Float[ndarray, " w"], spectrum: Spectrum) -> Float[ndarray, "w 3"]:
    """Share of the bare lamp's light that yellowed silicone passes in each channel, by Beer's law.

    Right for the lamp's own spectrum. Interference colours have another, of which each channel is taken to
    lose as much: at an absorbance of 0.3 that is wrong by 0.005 of the light (rms), in places by 0.03.

    Args:
        yellowing: see `Wear`.
        path: through the membrane, over its diameter.
        spectrum: of lamp and camera.
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
    """Share of light that scratches scatter, each pixel the mean over its area: fewer pixels show them paler.

    Args:
        wear: how many, and which.
        stream: 0, 1, ... for regions whose scratches differ.
        x_m, z_m: of the columns and rows on the surface, equally spaced [m].
        box_m: least and greatest x, and z, of the scratches' middles [m].
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
    """One of them: a slightly bent line that fades towards its ends."""
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
