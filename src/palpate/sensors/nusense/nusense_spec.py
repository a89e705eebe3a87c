"""Specification of NUSense: a layered silicone pad with a tiled layer that a fisheye camera sees from below.

Source "N": the thesis "NUSense: Shear Based Robust Optical Tactile Sensor". Other values are assumed. Moduli
of Sorta-Clear 18 follow from its Shore hardness (A 18) by A. N. Gent, Rubber Chem. Technol. 31, 896 (1958),
doi:10.5254/1.3542351.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.core import Lens, RangeError
from palpate.mechanics.layers.stack import ElasticLayer, Stack

SORTA_CLEAR_18_PA = 0.66e6
POISSON = 0.499  # Poisson's ratio of every silicone (assumed)


@dataclass(frozen=True, slots=True)
class PadLayers:
    """Layers of the pad from the outside in, on rigid glass.

    Attributes:
        outer_m: Thickness of the black Sorta-Clear 18 [m].
        colour_m: Thickness of the tiled layer, whose lower face the camera sees [m].
        gel_m: Thickness of the soft clear gel RTV27905 [m]. N: 2.2 mm.
        clear_m: Thickness of the clear layer that seals the gel [m].
        pdms_m: Thickness of the PDMS on the glass [m].
        rubber_pa: Modulus of outer, tiled, and clear layers [Pa].
        gel_pa: Modulus of the gel [Pa], for 1.7 mm at 8 N under the round tip.
        pdms_pa: Modulus of the PDMS [Pa], Sylgard 184's usual 1.8 MPa.
    """

    outer_m: float = 0.8e-3
    colour_m: float = 0.7e-3
    gel_m: float = 2.2e-3
    clear_m: float = 0.5e-3
    pdms_m: float = 0.3e-3
    rubber_pa: float = SORTA_CLEAR_18_PA
    gel_pa: float = 0.2e6
    pdms_pa: float = 1.8e6
    poisson_ratio: float = POISSON

    @property
    def pattern_depth_m(self) -> float:
        """Depth of the tiles' lower face below the surface [m]."""
        return self.outer_m + self.colour_m

    @property
    def stack(self) -> Stack:
        rows = (
            (self.outer_m, self.rubber_pa),
            (self.colour_m, self.rubber_pa),
            (self.gel_m, self.gel_pa),
            (self.clear_m, self.rubber_pa),
            (self.pdms_m, self.pdms_pa),
        )
        return Stack(tuple(ElasticLayer(t, E, self.poisson_ratio) for t, E in rows))


@dataclass(frozen=True, slots=True)
class TilePattern:
    """Checkerboard of red and yellow tiles around the pad's centre, aligned with x and y.

    Attributes:
        pitch_m: Side of a tile [m].
        columns, rows: Number of tiles, which fill N's 50 x 38 mm with 168 yellow tiles; N counts 164.
        offset_m: Offset of the pattern's centre [m].
        scale: Scale of the pattern as cast over its design.
        yellow, red, border: Reflectance in the camera's red, green, and blue, 0 to 1.
    """

    pitch_m: float = 2.4e-3
    columns: int = 21
    rows: int = 16
    offset_m: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0
    yellow: tuple[float, float, float] = (0.86, 0.70, 0.13)
    red: tuple[float, float, float] = (0.62, 0.09, 0.08)
    border: tuple[float, float, float] = (0.05, 0.05, 0.05)

    @property
    def cast_pitch_m(self) -> float:
        """Side of a tile as cast [m]."""
        return self.pitch_m * self.scale


@dataclass(frozen=True, slots=True)
class PadLight:
    """White light through four diffused edges, and the camera's response.

    Attributes:
        level: Grey level of a white surface in the middle.
        edge_share: Additional brightness at an edge over that level.
        edge_m: Decay length of an edge's light [m].
        sides: Relative brightness of the edges at +x, -x, +y, -y.
        blur_px: Standard deviation of the lens blur [px].
        read_noise: Standard deviation in the dark [grey levels].
        shot_noise: Variance per grey level [grey levels].
    """

    level: float = 210.0
    edge_share: float = 0.25
    edge_m: float = 8e-3
    sides: tuple[float, float, float, float] = (1.1, 0.95, 1.0, 0.95)
    blur_px: float = 0.7
    read_noise: float = 1.2
    shot_noise: float = 0.015


@dataclass(frozen=True, slots=True)
class Tear:
    """A straight cut from the surface down. N mentions a cut pad without sizes.

    Attributes:
        at_m: Middle of the cut (x, y) [m].
        turn_rad: Direction from x towards y [rad].
        depth_m: Depth [m]; a cut that ends above the tiles' lower face is invisible but moves them.
        gap_m: Opening in the middle at rest [m].
        behind: Reflectance seen through the opening.
    """

    at_m: tuple[float, float] = (4e-3, 1e-3)
    turn_rad: float = math.radians(75.0)
    length_m: float = 12e-3
    depth_m: float = 1.8e-3
    gap_m: float = 0.15e-3
    behind: float = 0.02

    def __post_init__(self) -> None:
        if not (0 < self.length_m < math.inf and 0 < self.depth_m < math.inf and 0 <= self.gap_m < math.inf):
            raise RangeError(
                f"a cut is {1e3 * self.length_m:g} mm long, {1e3 * self.depth_m:g} mm deep, "
                f"{1e3 * self.gap_m:g} mm open; give a length and a depth above 0 and a gap of 0 or more"
            )


FISHEYE = Lens(
    "kannala-brandt",
    (333.0, 333.0),
    (319.5, 239.5),
    (-0.02, 0.003, 0.0, 0.0),
    (480, 640),
    math.radians(80.0),
    "nusense-fisheye",
)
"""Assumed: 110 degrees across 640 px. N states the camera, a HBVCAM-3M2111WA, without lens data."""


@dataclass(frozen=True, slots=True)
class NuSenseSpec:
    """NUSense. The image has x to the right and y up; refraction is part of the lens.

    Attributes:
        pad_m: Size of the pad [m]. N: 55 x 43 mm.
        effective_m: Size of the touched part [m]. N: 50 x 38 mm.
        camera_m: Distance of the lens from the resting pattern [m]. N: 55 mm from the elastomer.
        rate_hz: Frame rate. N: 12.
        friction: Coulomb coefficient of an indenter on the pad.
        relaxation: (fraction of the relaxed modulus, time [s]) of each branch.
        max_depth_m: Maximum depth, limited by small strain [m].
        max_force_n: Maximum force [N]. N: 8 N.
    """

    pad_m: tuple[float, float] = (55e-3, 43e-3)
    effective_m: tuple[float, float] = (50e-3, 38e-3)
    camera_m: float = 55e-3
    layers: PadLayers = field(default_factory=PadLayers)
    pattern: TilePattern = field(default_factory=TilePattern)
    light: PadLight = field(default_factory=PadLight)
    lens: Lens = FISHEYE
    tear: Tear | None = None
    rate_hz: float = 12.0
    exposure_s: float = 10e-3
    friction: float = 0.5
    relaxation: tuple[tuple[float, float], ...] = ((0.10, 0.3), (0.08, 4.0))
    max_depth_m: float = 2.2e-3
    max_force_n: float = 12.0
    name: str = "nusense"

    def __post_init__(self) -> None:
        covered = (self.pattern.columns, self.pattern.rows)
        for count, side in zip(covered, self.pad_m, strict=True):
            if not 0 < count * self.pattern.cast_pitch_m <= side:
                raise RangeError(
                    f"{count} tiles of {1e3 * self.pattern.cast_pitch_m:g} mm on a pad of {1e3 * side:g} mm; "
                    "give tiles that lie on the pad",
                    code="outside-pad",
                )
        if not self.camera_m > self.layers.gel_m + self.layers.clear_m + self.layers.pdms_m:
            raise RangeError(f"the camera is {1e3 * self.camera_m:g} mm below the pattern, inside the pad")
        if not self.friction > 0:
            raise RangeError(f"friction is {self.friction}; give a number above 0")
        if not 0 < self.max_depth_m < self.layers.stack.thickness_m:
            raise RangeError(f"a deepest press of {1e3 * self.max_depth_m:g} mm is not within the pad")


def fabricated(copy: int, spec: NuSenseSpec | None = None) -> NuSenseSpec:
    """Return one of many units made alike; the number is the seed.

    Standard deviations (assumed, truncated at two): moduli of rubber and gel 10 %, thicknesses 5 %, pattern
    0.3 mm and its scale 0.5 %.
    """
    if copy < 0:
        raise RangeError(f"copy {copy}; copies are numbered from 0")
    spec = spec or NuSenseSpec()
    layers, pattern = spec.layers, spec.pattern
    drawn = np.clip(np.random.default_rng([copy, 55]).standard_normal(8), -2, 2).tolist()
    return replace(
        spec,
        layers=replace(
            layers,
            outer_m=layers.outer_m * (1 + 0.05 * drawn[0]),
            colour_m=layers.colour_m * (1 + 0.05 * drawn[1]),
            gel_m=layers.gel_m * (1 + 0.05 * drawn[2]),
            rubber_pa=layers.rubber_pa * (1 + 0.10 * drawn[3]),
            gel_pa=layers.gel_pa * (1 + 0.10 * drawn[4]),
        ),
        pattern=replace(pattern, offset_m=(0.3e-3 * drawn[5], 0.3e-3 * drawn[6]), scale=1 + 0.005 * drawn[7]),
        name=f"{spec.name}-{copy}",
    )
