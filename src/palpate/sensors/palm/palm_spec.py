"""Specification of the photoelastic palm: a clear disc between crossed polarisers, with a mirror beneath it.

Sources: "R", the palm's report (Photoelastic Tactile Sensor for a Robotic Palm, 2026); "D", the data layout
of its code release (github.com/Spades2002/Photoelastic-Palm-Sensor).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.optics.colour import MIN_BANDS
from palpate.optics.image_chain import AutoExposure, CameraResponse, ImageChain, LedStrip
from palpate.optics.stress_optic import StressOpticLaw
from palpate.sensors.palm.membrane_faults import Glare, MirrorDirt, ResidualMap, UnevenGel, Wear


@dataclass(frozen=True, slots=True)
class View:
    """One region of the camera's frame.

    Attributes:
        box_px: (x, y, width, height) in the frame [px].
        pitch_m: Column pitch on the membrane [m].
        middle_px: (x, y) of the membrane's axis from the region's corner [px]: at the rest surface in the
            fringe view, at the underside in the mirror's.
        row_pitch_m: Row pitch [m]; None for square pixels.
        turn_rad: Rotation of the image about its middle, from right towards down [rad].
        shift_px: Translation after the rotation, right and down [px].
    """

    box_px: tuple[int, int, int, int]
    pitch_m: float
    middle_px: tuple[float, float]
    row_pitch_m: float | None = None
    turn_rad: float = 0.0
    shift_px: tuple[float, float] = (0.0, 0.0)

    @property
    def size_px(self) -> tuple[int, int]:
        return self.box_px[2:]

    def moved(self, across_px: float, down_px: float) -> View:
        """The region with its middle moved in the image [px]."""
        cx, cy = self.middle_px
        return replace(self, middle_px=(cx + float(across_px), cy + float(down_px)))

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns in the frame."""
        x, y, w, h = self.box_px
        return slice(y, y + h), slice(x, x + w)

    @property
    def pitches_m(self) -> tuple[float, float]:
        return self.pitch_m, self.pitch_m if self.row_pitch_m is None else self.row_pitch_m

    @property
    def x_m(self) -> Float[ndarray, " w"]:
        """Column centres from the axis [m]."""
        return (np.arange(self.box_px[2]) + 0.5 - self.middle_px[0]) * self.pitch_m

    @property
    def down_m(self) -> Float[ndarray, " h"]:
        """Row centres from the middle, down the image [m]."""
        return (np.arange(self.box_px[3]) + 0.5 - self.middle_px[1]) * self.pitches_m[1]

    def sampled(self, across: float, down: float) -> View:
        """Scale the number of columns and rows, rounded down."""
        x, y, w, h = (int(part * by + 1e-6) for part, by in zip(self.box_px, (across, down) * 2, strict=True))
        (cx, cy), (wide, high) = self.middle_px, self.pitches_m
        square = across == down and self.row_pitch_m is None
        pitch_m = None if square else high / down
        shift = self.shift_px[0] * across, self.shift_px[1] * down
        return View((x, y, w, h), wide / across, (cx * across, cy * down), pitch_m, self.turn_rad, shift)

    @property
    def upright(self) -> View:
        """The region without rotation and translation."""
        return replace(self, turn_rad=0.0, shift_px=(0.0, 0.0))


FRINGES = View((380, 60, 1420, 420), 44e-6, (710.0, 110.0))
"""Box from D; pitch and surface row are assumed."""

MIRROR = View((700, 560, 700, 420), 100e-6, (350.0, 210.0))
"""Box from D; the pitch is assumed."""

RIMS = ("applied", "stated")
MAX_TURN_RAD = 0.2
MAX_SHIFT_PX = 50.0


@dataclass(frozen=True, slots=True)
class PalmSpec:
    """Specification of the palm. "R:" is from the report; most other values are assumed.

    Attributes:
        diameter_m: Membrane diameter [m]. R: 57 mm.
        thickness_m: Membrane thickness [m], chosen with the modulus to match the report's forces.
        youngs_modulus_pa: Small-strain modulus [Pa], between silicones of Shore 10A and 20A.
        max_strain: Limit of mean contact pressure over E. Solaris: elongation at break of its data sheet, 290
            %.
        friction: Coulomb coefficient between ball and membrane.
        stress_optic: C and its dispersion. The report ranks Solaris above a casting resin and Sylgard 184 at
            equal load, which requires about 1e-9 1/Pa.
        refractive_index: Manufacturer's value for Solaris.
        frozen_birefringence, frozen_axis_rad: Uniform residual birefringence and its axis from x to z [rad].
        residual: Residual birefringence that varies over the side view.
        gel: Variation of modulus and thickness over the disc.
        indenter_radius_m: Ball radius [m]. R: 5 mm.
        rim: "applied" corrects presses of the ball near the free rim; "stated" only reports the correction.
        rim_refracts: Whether the round rim acts as a cylindrical lens; False for flat windows.
        polariser_rad: Angle of the first polariser from x to z [rad]; R: "crossed".
        extinction: Crossed over parallel transmission of the polarisers.
        frame_px: (width, height) of the frame [px].
        mirror_elevation_rad: Elevation of the mirror's line of sight [rad].
        lamp_gain: Lamp brightness relative to set-up.
        lamp_mired: Color shift of the lamp [mired], positive for warmer.
        ambient: Unpolarized room light in the upper left corner, over the lamp's maximum.
        corner_loss: Vignetting at half the region's diagonal, fraction of light.
        inside_light: Scattered light in the housing over the lamp's.
        opaque_underside: Whether a dark layer hides ball and dimple from the mirror.
        probe_in_mirror, probe_edge_on: Whether each view shows the probe's body.
        membrane: False for the empty housing with the ball in the air.
        bands: Number of wavelength bands from 400 to 700 nm; 31 or more.
        rays_per_pixel: (across, down) rays averaged per pixel of the fringe view.
        auto_exposure: Automatic exposure in steps; None for a fixed one.
    """

    diameter_m: float = 57e-3
    thickness_m: float = 10e-3
    youngs_modulus_pa: float = 0.32e6
    max_strain: float = 2.9
    poisson_ratio: float = 0.49
    friction: float = 0.0
    stress_optic: StressOpticLaw = field(default_factory=lambda: StressOpticLaw(1e-9))
    refractive_index: float = 1.41
    frozen_birefringence: float = 0.0
    frozen_axis_rad: float = 0.0
    residual: ResidualMap = field(default_factory=ResidualMap)
    gel: UnevenGel = field(default_factory=UnevenGel)
    indenter_radius_m: float = 5e-3
    rim: str = "stated"
    rim_refracts: bool = True
    polariser_rad: float = math.pi / 4
    extinction: float = 0.01
    membrane_transmission: float = 0.9
    frame_px: tuple[int, int] = (1920, 1080)
    fringes: View = FRINGES
    mirror: View = MIRROR
    mirror_elevation_rad: float = math.radians(60.0)
    lamp: LedStrip = field(default_factory=LedStrip)
    lamp_gain: float = 1.0
    lamp_mired: float = 0.0
    ambient: float = 0.0
    corner_loss: float = 0.3
    inside_light: float = 1.0
    ball_albedo: float = 0.5
    opaque_underside: bool = False
    probe_in_mirror: bool = True
    probe_edge_on: bool = True
    membrane: bool = True
    wear: Wear = field(default_factory=Wear)
    dirt: MirrorDirt = field(default_factory=MirrorDirt)
    glare: Glare = field(default_factory=Glare)
    bands: int = MIN_BANDS
    rays_per_pixel: tuple[int, int] = (1, 1)
    camera: CameraResponse = field(default_factory=CameraResponse)
    chain: ImageChain = field(default_factory=ImageChain)
    auto_exposure: AutoExposure | None = None
    exposure_s: float = 0.02
    name: str = "palm"

    def __post_init__(self) -> None:
        for name, (least, greatest, unit) in _RANGES.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and least <= value <= greatest):
                raise RangeError(
                    f"the palm's {name} is {value}; it must lie within {least:g} to {greatest:g} {unit}",
                    code="spec-range",
                )
        if not self.poisson_ratio < 0.5:
            raise RangeError(
                f"Poisson's ratio {self.poisson_ratio} must be below 0.5, at which layers have no solution; "
                "silicones have 0.49",
                code="poisson-ratio",
            )
        if self.rim not in RIMS:
            raise InputError(f"rim {self.rim!r}; give one of {', '.join(RIMS)}", code="rim-kind")
        if min(self.rays_per_pixel) < 1:
            raise RangeError(f"{self.rays_per_pixel} rays a pixel; give 1 or more", code="ray-count")
        for view in (self.fringes, self.mirror):
            _check_view(view, self.frame_px)

    @property
    def unlit(self) -> PalmSpec:
        """The palm with nominal lamp and camera; the key of cached marches and traces."""
        later = {name: getattr(_NOMINAL, name) for name in _LATER}
        return replace(self, fringes=self.fringes.upright, mirror=self.mirror.upright, **later)

    @property
    def rim_index(self) -> float:
        """Refractive index at the rim; 1 for flat windows."""
        return self.refractive_index if self.rim_refracts else 1.0

    @property
    def radius_m(self) -> float:
        return self.diameter_m / 2


def _check_view(view: View, frame_px: tuple[int, int]) -> None:
    x, y, w, h = view.box_px
    if min(x, y) < 0 or min(w, h) < 8 or x + w > frame_px[0] or y + h > frame_px[1]:
        raise InputError(
            f"region {view.box_px} does not fit a frame of {frame_px[0]} x {frame_px[1]} px with 8 px or "
            "more each way",
            code="view-outside-frame",
        )
    if not abs(view.turn_rad) <= MAX_TURN_RAD:
        raise RangeError(f"a region turned by {view.turn_rad} rad; within {MAX_TURN_RAD:g} rad")
    if not all(abs(part) <= MAX_SHIFT_PX for part in view.shift_px):
        raise RangeError(f"a region moved by {view.shift_px} px; within {MAX_SHIFT_PX:g} px each way")
    if not all(math.isfinite(pitch) and pitch > 0 for pitch in view.pitches_m):
        raise RangeError(f"pixels of {view.pitches_m} m; give sizes above 0 m", code="pixel-size")


_RANGES = {
    "diameter_m": (1e-3, 1.0, "m"),
    "thickness_m": (1e-4, 1.0, "m"),
    "youngs_modulus_pa": (1e2, 1e12, "Pa"),
    "max_strain": (1e-4, 10.0, "(a ratio)"),
    "poisson_ratio": (0.0, 0.5, "(below 0.5)"),
    "friction": (0.0, 10.0, "(a ratio of forces)"),
    "refractive_index": (1.0, 3.0, "(air has 1, silicones 1.4)"),
    "frozen_birefringence": (-1e-2, 1e-2, "(a difference of indices)"),
    "frozen_axis_rad": (-math.tau, math.tau, "rad"),
    "indenter_radius_m": (1e-4, 1.0, "m"),
    "polariser_rad": (-math.tau, math.tau, "rad"),
    "extinction": (0.0, 1.0, "(a share)"),
    "membrane_transmission": (0.0, 1.0, "(a share)"),
    "mirror_elevation_rad": (0.1, math.pi / 2, "rad"),
    "lamp_gain": (0.0, 100.0, "(over the light at set-up)"),
    "lamp_mired": (-200.0, 200.0, "mired"),
    "ambient": (0.0, 10.0, "(over the lamp's brightest)"),
    "corner_loss": (0.0, 1.0, "(a share)"),
    "inside_light": (0.0, 100.0, "(over the lamp's)"),
    "ball_albedo": (0.0, 1.0, "(a share)"),
    "bands": (MIN_BANDS, 1000, "bands"),
    "exposure_s": (1e-6, 100.0, "s"),
}
_LATER = (
    "lamp",
    "lamp_gain",
    "lamp_mired",
    "ambient",
    "corner_loss",
    "membrane_transmission",
    "probe_edge_on",
    "wear",
    "dirt",
    "glare",
    "auto_exposure",
    "camera",
    "exposure_s",
    "name",
    "chain",
)
_NOMINAL = PalmSpec()


def palm() -> PalmSpec:
    """Return the palm at full size."""
    return PalmSpec()


def small() -> PalmSpec:
    """Return the palm with a quarter of the pixels in each direction (network input)."""
    return scaled_down(palm(), 4, "palm-small")


def demo() -> PalmSpec:
    """Return the palm with a sixth of the pixels in each direction."""
    return scaled_down(palm(), 6, "palm-demo")


def debug() -> PalmSpec:
    """Return the palm with a tenth of the pixels in each direction, for tests."""
    return scaled_down(palm(), 10, "palm-debug")


def crops() -> PalmSpec:
    """Return both regions side by side at 224 px: the input of the report's networks."""
    return cropped(palm(), 224, "palm-crops")


def solaris() -> PalmSpec:
    """Return the report's material, the same as `palm`."""
    return replace(palm(), name="palm-solaris")


def sylgard_184() -> PalmSpec:
    """Return a palm of Sylgard 184; E, C, and strain limit are typical published values."""
    return replace(
        palm(),
        youngs_modulus_pa=1.8e6,
        max_strain=1.0,
        stress_optic=StressOpticLaw(1.7e-10),
        name="palm-sylgard-184",
    )


def casting_resin() -> PalmSpec:
    """Return a palm of cast epoxy; E, C, and strain limit are typical published values."""
    return replace(
        palm(),
        youngs_modulus_pa=2.5e9,
        max_strain=0.04,
        stress_optic=StressOpticLaw(5.5e-11),
        refractive_index=1.55,
        name="palm-casting-resin",
    )


def scaled_down(spec: PalmSpec, by: int, name: str) -> PalmSpec:
    """Return the palm with fewer pixels, each the mean of four rays."""
    w, h = spec.frame_px
    return replace(
        spec,
        frame_px=(w // by, h // by),
        fringes=spec.fringes.sampled(1 / by, 1 / by),
        mirror=spec.mirror.sampled(1 / by, 1 / by),
        rays_per_pixel=(2, 2),
        name=name,
    )


def cropped(spec: PalmSpec, side_px: int, name: str) -> PalmSpec:
    """Return the palm with both regions as squares that fill the frame: fringes left, mirror right."""
    views = (
        replace(
            view.sampled(side_px / view.size_px[0], side_px / view.size_px[1]),
            box_px=(left, 0, side_px, side_px),
        )
        for left, view in ((0, spec.fringes), (side_px, spec.mirror))
    )
    fringes, mirror = views
    across, down = (max(2, round(size / side_px / 2)) for size in spec.fringes.size_px)
    return replace(
        spec,
        frame_px=(2 * side_px, side_px),
        fringes=fringes,
        mirror=mirror,
        rays_per_pixel=(across, down),
        name=name,
    )


PRESETS: dict[str, Callable[[], PalmSpec]] = {
    "palm": palm,
    "small": small,
    "demo": demo,
    "debug": debug,
    "crops": crops,
    "solaris": solaris,
    "sylgard-184": sylgard_184,
    "casting-resin": casting_resin,
}


def preset(name: str) -> PalmSpec:
    """Return a palm specification by name."""
    if name not in PRESETS:
        raise InputError(f"there is no palm {name!r}; there are {', '.join(PRESETS)}", code="unknown-name")
    return PRESETS[name]()
