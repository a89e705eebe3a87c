"""Every number of NUSense: a layered silicone pad with a tiled layer that a fisheye camera sees from below.

Source "N": the thesis "NUSense: Shear Based Robust Optical Tactile Sensor". What it does not tell is marked
assumed. Moduli of Sorta-Clear 18 are read off its Shore hardness (A 18) by A. N. Gent, Rubber Chem. Technol.
31, 896 (1958), doi:10.5254/1.3542351.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.core import Lens, RangeError
from palpate.mechanics.layers.stack import ElasticLayer, Stack

SORTA_CLEAR_18_PA = 0.66e6
POISSON = 0.499
"""Of every silicone: assumed, nearly incompressible."""


@dataclass(frozen=True, slots=True)
class PadLayers:
    """Layers of the pad from the outside in, on glass that does not yield.

    Attributes:
        outer_m: of the black Sorta-Clear 18 that is touched [m]. Assumed.
        colour_m: of the tiled layer below it [m]; its lower face is what the camera sees. Assumed.
        gel_m: of the soft clear gel RTV27905 [m]. N: 2.2 mm.
        clear_m: of the clear layer that seals the gel [m]. Assumed.
        pdms_m: of the PDMS that holds the pad on the glass [m]. Assumed.
        rubber_pa: Young's modulus of the outer, tiled and clear layers [Pa]: Sorta-Clear 18, by hardness.
        gel_pa: of the gel [Pa]. Assumed: so soft that 8 N under the round tip are 1.7 mm.
        pdms_pa: of the PDMS [Pa]. Assumed: Sylgard 184's usual 1.8 MPa.
        poisson_ratio: of all of them. Assumed.
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
        """Depth of the tiles' lower face below the touched surface [m]."""
        return self.outer_m + self.colour_m

    @property
    def stack(self) -> Stack:
        """The layers as the contact mechanics takes them."""
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
    """Checkerboard of red and yellow tiles about the pad's centre; its sides run along x and y.

    Attributes:
        pitch_m: side of a tile [m]. Assumed.
        columns, rows: of tiles. Assumed: they fill the 50 x 38 mm in which N's pad is touched with 168
            yellow tiles, where N counts 164 quadrilaterals.
        offset_m: of the pattern's centre beside the pad's, along x and y [m]; 0 by design.
        scale: of the pattern as cast over its design.
        yellow, red: reflectance in the camera's red, green and blue, of 1. Assumed.
        border: the same of the black rubber around. Assumed.
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
    """White light from LEDs through four diffused edges, and what the camera makes of it.

    Attributes:
        level: grey level of a white surface in the pad's middle. Assumed.
        edge_share: how much brighter it is at an edge, of that level. N: LEDs at four edges; size assumed.
        edge_m: over which an edge's light fades [m]. Assumed.
        sides: brightness of the edges at +x, -x, +y, -y over their mean. Assumed.
        blur_px: standard deviation of the lens blur [px]. Assumed.
        read_noise: of a pixel in the dark, standard deviation [grey levels]. Assumed.
        shot_noise: variance that a grey level adds [grey levels]. Assumed.
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
    """A straight cut in the skin, from the touched surface down. N tells that a pad was cut, and no size.

    Attributes:
        at_m: middle of the cut, (x, y) from the pad's centre [m]. Assumed: beside a tip in the middle.
        turn_rad: of its line from x towards y [rad]. Assumed.
        length_m: of the cut [m]. Assumed.
        depth_m: of the cut [m]. Assumed: through the black and the tiled layer and 0.3 mm into the gel. One
            that ends above the tiles' lower face is not seen, and still changes how they move.
        gap_m: between the faces in the middle of its length, at rest [m]. Assumed: what a blade takes away.
        behind: reflectance of what is seen through the opening. Assumed: as dark as a probe that no light
            reaches.
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
"""Assumed: 110 degrees across 640 px. N names the camera, a HBVCAM-3M2111WA, and no number of its lens."""


@dataclass(frozen=True, slots=True)
class NuSenseSpec:
    """The sensor.

    The camera's image has x to the right and the skin's y upwards: it looks at the pattern from below. Rays
    are straight; what glass and gel bend is taken as part of the lens, as a calibration through them has it.

    Attributes:
        pad_m: size of the pad along x and y [m]. N: 55 x 43 mm.
        effective_m: of the part that is touched [m]. N: 50 x 38 mm.
        camera_m: distance of the lens from the resting pattern [m]. N: 55 mm from the elastomer's surface.
        layers, pattern, light, lens: see there.
        tear: of the skin; None for a whole pad.
        rate_hz: frames a second. N: 12.
        exposure_s: of a frame [s]. Assumed.
        friction: Coulomb's, of an indenter on the pad. Assumed: the virtual rig's.
        relaxation: for each branch of the pad's memory its share of the relaxed modulus, and its time [s].
            Assumed.
        max_depth_m: deepest press that is answered [m]. Assumed: what small strain bears, see the
            explanation.
        max_force_n: largest force that is answered [N]. N: up to 8 N; a press overshoots.
        name: goes into each frame.
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
    """One of many pads made alike: the same number, the same pad.

    Moduli and the pattern's place vary as hand-cast silicone does: moduli of rubber and gel by 10 %,
    thicknesses by 5 %, the pattern by 0.3 mm and its scale by 0.5 %; standard deviations, assumed, and cut
    off at twice their size.

    Args:
        copy: its number, 0 or more.
        spec: what was designed; None for `NuSenseSpec()`.
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
