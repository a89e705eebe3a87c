"""Wear of a clear membrane: haze, scratches, and yellowing in both views.

Each becomes light * keep + add per region. Scattered light is assumed wide and fully depolarised, so the
lifted dark field is an upper bound. All sizes are assumed.

Spatial variation of one membrane's modulus, thickness, and residual birefringence.

Each varies in a few low-order modes drawn by a seed, with a given rms and zero mean. A press uses the modulus
and thickness under its axis, which assumes that both are constant over one or two contact radii.

Imperfections of the views: dirt and texture under the mirror's view, and glare. All sizes are assumed.

Dirt and texture dim what the mirror shows at fixed positions. Glare adds lamp light at fixed image positions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.polynomial import legendre
from scipy.ndimage import map_coordinates, uniform_filter

from palpate.core import Bool, Float, Float32, InputError, RangeError, ndarray
from palpate.optics.colour import Spectrum

if TYPE_CHECKING:
    from palpate.sensors.palm.palm_spec import PalmSpec, View

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


MAX_SHARE = 0.1  # maximum rms of modulus and thickness
MAX_BIREFRINGENCE = 1e-5  # maximum rms of the residual birefringence
SIDE_MODES = tuple((i, j) for i in range(4) for j in range(3) if i + j > 0)

Field = Float[ndarray, "..."]


@dataclass(frozen=True, slots=True)
class UnevenGel:
    """Membrane whose modulus and thickness vary over its disc. Sizes are assumed.

    Attributes:
        modulus, thickness: Rms of the logarithm, 0 to 0.1.
    """

    modulus: float = 0.0
    thickness: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("modulus", "thickness"):
            value = getattr(self, name)
            if not 0 <= value <= MAX_SHARE:
                raise RangeError(
                    f"an uneven gel's {name} of {value}; 0 to {MAX_SHARE:g}, as a share",
                    code="modulus-variation",
                )
        _check_seed(self.seed)


@dataclass(frozen=True, slots=True)
class ResidualMap:
    """Residual birefringence that varies over the side view, in addition to the uniform one. Assumed.

    Attributes:
        birefringence: Rms of each component (along the axes, along the diagonals) of the mean along a ray, 0
            to 1e-5.
        modes: Weights of the first `side_modes` of each component instead of drawn ones.
    """

    birefringence: float = 0.0
    seed: int = 0
    modes: tuple[tuple[float, ...], tuple[float, ...]] | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.birefringence <= MAX_BIREFRINGENCE:
            raise RangeError(
                f"a residual birefringence of {self.birefringence}; 0 to {MAX_BIREFRINGENCE:g}, a difference "
                "of indices",
                code="residual-birefringence",
            )
        for one in self.modes or ():
            if not (len(one) <= len(SIDE_MODES) and all(map(math.isfinite, one))):
                raise InputError(
                    f"weights {one}; give up to {len(SIDE_MODES)} finite numbers of each component"
                )
        _check_seed(self.seed)

    def weights(self, component: int) -> tuple[float, ...]:
        """Weights of the first modes of the axial (0) or diagonal (1) component."""
        if self.modes is None:
            return _weights(self.seed, component, len(SIDE_MODES))
        return self.modes[component]


def _check_seed(seed: int) -> None:
    if not isinstance(seed, int) or seed < 0:
        raise InputError(f"the seed is {seed!r}; give a whole number, 0 or more", code="seed")


def disc_modes(x: Field, y: Field) -> Float[ndarray, "7 ..."]:
    """Return Zernike modes of orders 1 to 3 without trefoils; positions are in disc radii.

    They are orthonormal over the disc. Reference: R. J. Noll, J. Opt. Soc. Am. 66 (1976) 207,
    doi:10.1364/JOSA.66.000207.
    """
    r2 = x**2 + y**2
    return np.stack([
        2 * x, 2 * y, math.sqrt(3) * (2 * r2 - 1), math.sqrt(6) * (x**2 - y**2), math.sqrt(6) * 2 * x * y,
        math.sqrt(8) * (3 * r2 - 2) * x, math.sqrt(8) * (3 * r2 - 2) * y,
    ])  # fmt: skip


def side_modes(across: Field, down: Field) -> Float[ndarray, "11 ..."]:
    """Return products of Legendre polynomials, orthonormal over a square of -1 to 1."""
    return np.stack([_legendre(i, across) * _legendre(j, down) for i, j in SIDE_MODES])


def _legendre(order: int, at: Field) -> Field:
    return np.asarray(math.sqrt(2 * order + 1) * legendre.legval(at, np.eye(order + 1)[order]))


@lru_cache(maxsize=64)
def _weights(seed: int, stream: int, modes: int) -> tuple[float, ...]:
    """Weights whose squares sum to 1."""
    drawn = np.random.default_rng([seed, stream]).standard_normal(modes)
    return tuple((drawn / np.linalg.norm(drawn)).tolist())


def modulus_ratio(spec: PalmSpec, x_m: float, y_m: float) -> float:
    """Return the modulus at a position over the membrane's."""
    return math.exp(spec.gel.modulus * _at(spec, 0, x_m, y_m)) if spec.gel.modulus else 1.0


def modulus_ratios(spec: PalmSpec, x_m: Field, y_m: Field) -> Field:
    """Return the modulus at many positions over the membrane's."""
    modes = disc_modes(x_m / spec.radius_m, y_m / spec.radius_m)
    weights = np.array(_weights(spec.gel.seed, 0, len(modes)))
    return np.asarray(np.exp(spec.gel.modulus * np.tensordot(weights, modes, axes=1)))


def thickness_at(spec: PalmSpec, x_m: float, y_m: float) -> float:
    """Return the thickness at a position [m]."""
    share = spec.gel.thickness
    return spec.thickness_m * math.exp(share * _at(spec, 1, x_m, y_m)) if share else spec.thickness_m


def thickness_range(spec: PalmSpec) -> tuple[float, float]:
    """Return the minimum and maximum thickness [m]."""
    if not spec.gel.thickness:
        return spec.thickness_m, spec.thickness_m
    away, angle = np.linspace(0.0, 1.0, 41), np.linspace(0.0, 2 * np.pi, 120, endpoint=False)
    modes = disc_modes(np.outer(away, np.cos(angle)), np.outer(away, np.sin(angle)))
    field = np.tensordot(np.array(_weights(spec.gel.seed, 1, len(modes))), modes, axes=1)
    thinnest, thickest = spec.thickness_m * np.exp(spec.gel.thickness * np.array([field.min(), field.max()]))
    return float(thinnest), float(thickest)


def _at(spec: PalmSpec, stream: int, x_m: float, y_m: float) -> float:
    R = spec.radius_m
    modes = disc_modes(np.asarray(x_m / R), np.asarray(y_m / R))
    return float(np.dot(_weights(spec.gel.seed, stream, len(modes)), modes))


def pressed_at(spec: PalmSpec, x_m: float, y_m: float) -> PalmSpec:
    """Return the even palm with the modulus and thickness at a position."""
    if spec.gel == EVEN:
        return spec
    return replace(
        spec,
        youngs_modulus_pa=spec.youngs_modulus_pa * modulus_ratio(spec, x_m, y_m),
        thickness_m=thickness_at(spec, x_m, y_m),
        gel=EVEN,
    )


def frozen_at(spec: PalmSpec, impact_m: Field, z_m: Field) -> tuple[Field, Field]:
    """Return the residual birefringence of rays by distance from the membrane's axis and depth [m].

    Returns:
        Axial and diagonal parts: n1 - n2 times cosine and sine of twice the angle of the larger index from x
            to
        z, including the uniform part.
    """
    uniform = (
        spec.frozen_birefringence * math.cos(2 * spec.frozen_axis_rad),
        spec.frozen_birefringence * math.sin(2 * spec.frozen_axis_rad),
    )
    size = spec.residual.birefringence
    across, down = np.broadcast_arrays(impact_m / spec.radius_m, 2 * z_m / spec.thickness_m - 1)
    if not size:
        return np.full(across.shape, uniform[0]), np.full(across.shape, uniform[1])
    modes, weights = (
        side_modes(across, np.clip(down, -1.0, 1.0)),
        [spec.residual.weights(k) for k in range(2)],
    )
    parts = [np.tensordot(one, modes[: len(one)], axes=1) for one in weights]
    return uniform[0] + size * parts[0], uniform[1] + size * parts[1]


EVEN = UnevenGel()


MAX_SPECKS = 500
MAX_SPOTS = 20
SPECK_DIMS = 0.6  # light lost in the middle of the darkest speck; others lose at least 0.3 of it (assumed)
FRINGES, MIRROR = 0, 1  # random streams of the two regions

Grey = Float32[ndarray, "h w"]
Light = Float32[ndarray, "h w 3"]


@dataclass(frozen=True, slots=True)
class MirrorDirt:
    """Dust and texture in the mirror's view.

    Attributes:
        specks: Number of dust specks, 0 to 500.
        speck_m: Half-strength radius of the largest speck [m]; others have at least 0.3 of it.
        texture: Rms relative change of brightness by a mottled surface, 0 to 0.3.
        texture_m: Correlation length of the texture [m].
    """

    specks: int = 0
    speck_m: float = 0.4e-3
    texture: float = 0.0
    texture_m: float = 2e-3
    seed: int = 0

    def __post_init__(self) -> None:
        _check_whole("specks", self.specks, MAX_SPECKS)
        sizes = 1e-5 <= self.speck_m <= 1e-2 and 2e-4 <= self.texture_m <= 0.1
        if not (sizes and 0 <= self.texture <= 0.3):
            raise RangeError(
                f"dirt of specks to {self.speck_m} m and texture {self.texture} over {self.texture_m} m; "
                "give 1e-5 to 1e-2 m, 0 to 0.3 and 2e-4 to 0.1 m",
                code="dirt-range",
            )


@dataclass(frozen=True, slots=True)
class Glare:
    """Reflections of the lamp in both regions.

    Attributes:
        spots: Number in each region, 0 to 20.
        peak: Maximum light of the brightest spot over the lamp's maximum; others have at least 0.3 of it.
        width_m: Standard deviation of the widest spot on the membrane [m]; others have at least 0.3 of it.
    """

    spots: int = 0
    peak: float = 0.1
    width_m: float = 1.5e-3
    seed: int = 0

    def __post_init__(self) -> None:
        _check_whole("spots", self.spots, MAX_SPOTS)
        if not (0 <= self.peak <= 10 and 1e-5 <= self.width_m <= 0.1):
            raise RangeError(
                f"glare of {self.peak} and {self.width_m} m; give 0 to 10 over the lamp's, and 1e-5 to 0.1 m",
                code="glare-range",
            )


def _check_whole(name: str, value: int, greatest: int) -> None:
    if not (isinstance(value, int) and 0 <= value <= greatest):
        raise InputError(f"{name} are {value!r}; give a whole number, 0 to {greatest}", code="spot-count")


def dirt_over(spec: PalmSpec) -> Grey:
    """Return the transmission of dirt and texture in the mirror's region."""
    sine = math.sin(spec.mirror_elevation_rad)
    return _dirt(spec.dirt, spec.mirror, sine, spec.radius_m)


@lru_cache(maxsize=8)
def _dirt(dirt: MirrorDirt, view: View, sine: float, radius_m: float) -> Grey:
    x, y = np.meshgrid(view.x_m, view.down_m / sine)
    left = np.ones(x.shape)
    for across, down, size, strength in np.random.default_rng([dirt.seed, 0]).uniform(size=(dirt.specks, 4)):
        radius = dirt.speck_m * (0.3 + 0.7 * size)
        away2 = (x - radius_m * (2 * across - 1)) ** 2 + (y - radius_m * (2 * down - 1)) ** 2
        left *= 1 - SPECK_DIMS * (0.3 + 0.7 * strength) * 0.5 ** (away2 / radius**2)
    if dirt.texture:
        left *= np.maximum(1 + dirt.texture * mottled(dirt, x, y, radius_m), 0.0)
    return np.asarray(left, np.float32)


def mottled(dirt: MirrorDirt, x_m: ndarray, y_m: ndarray, radius_m: float) -> ndarray:
    """Return the texture at positions on the underside, with zero mean and unit variance
    over many membranes.
    """
    half = math.ceil(1.2 * radius_m / dirt.texture_m) + 2
    knots = np.random.default_rng([dirt.seed, 1]).standard_normal((2 * half + 1, 2 * half + 1))
    at = np.stack([y_m / dirt.texture_m + half, x_m / dirt.texture_m + half])
    # Linear interpolation between independent knots loses variance, which is restored here.
    share = at - np.floor(at)
    kept = np.prod(share**2 + (1 - share) ** 2, axis=0)
    return np.asarray(map_coordinates(knots, at, order=1, mode="nearest") / np.sqrt(kept))


def glare_in(glare: Glare, view: View, stream: int) -> Grey:
    """Return the light that reflections add in one region, over the lamp's maximum."""
    return _glare(glare, view, stream)


@lru_cache(maxsize=8)
def _glare(glare: Glare, view: View, stream: int) -> Grey:
    x, z = view.x_m[None, :], view.down_m[:, None]
    light = np.zeros((view.size_px[1], view.size_px[0]))
    drawn = np.random.default_rng([glare.seed, stream]).uniform(size=(glare.spots, 5))
    for across, down, strength, wide, high in drawn:
        at_x, at_z = (
            axis.min() + (axis.max() - axis.min()) * part for axis, part in ((x, across), (z, down))
        )
        sx, sz = (glare.width_m * (0.3 + 0.7 * part) for part in (wide, high))
        shape = np.exp(-(((x - at_x) / sx) ** 2 + ((z - at_z) / sz) ** 2) / 2)
        light += glare.peak * (0.3 + 0.7 * strength) * shape
    return light.astype(np.float32)


def registered(light: Light, view: View) -> Light:
    """Return a region's image rotated and translated as its view specifies."""
    if not (view.turn_rad or any(view.shift_px)):
        return light
    (cx, cy), c, s = view.middle_px, math.cos(view.turn_rad), math.sin(view.turn_rad)
    middle = np.array([cx - 0.5, cy - 0.5])
    turn = np.array([[c, -s], [s, c]])
    move = np.column_stack([turn, middle - turn @ middle + np.array(view.shift_px)])
    return np.asarray(
        cv2.warpAffine(light, move, view.size_px, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        np.float32,
    )
