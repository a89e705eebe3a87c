"""NUSense as a `Sensor`, ground truth of its control points, and plans of the thesis's experiments (chapter
4).

A plan turns around at a force or the pad's known depth, whichever comes first. Speeds that the thesis does
not state are those of its hysteresis experiment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from palpate.core import (
    FRESH,
    SEATED,
    Box,
    Contact,
    Float,
    Frame,
    ImageAxes,
    InputError,
    Int,
    Outline,
    Pose,
    PressHistory,
    Probe,
    RangeError,
    Seating,
    Specimen,
    is_rigid,
    ndarray,
)
from palpate.estimators.shear import TiledSkin
from palpate.estimators.surface_strain import PatternedSkin
from palpate.sensors.nusense.nusense_spec import NuSenseSpec, Tear, fabricated
from palpate.sensors.nusense.pad_contact import greatest_depth_m, pad_contact, parse_indenter
from palpate.sensors.nusense.pad_view import clean_view, exposed, exposed_by_table, pad_window, seen_px
from palpate.sensors.nusense.pattern_motion import (
    PatternMotion,
    PressLevels,
    goes_straight_down,
    pattern_motion,
)
from palpate.sensors.nusense.torn_pad import TornMotion, torn_contact, torn_motion, torn_view

SPEED_MM_S = 0.5  # speed of the hysteresis experiment, section 4.4
MIDDLE: Mapping[str, Any] = {"kind": "listed", "at_mm": [[0.0, 0.0]]}
COLUMNS, ROWS, APART_MM = 6, 4, (6.4, 7.0)
ANGLES_DEG = tuple(range(0, 180, 15))
EDGE_MM = 25
FIRM_TAPS: Mapping[str, Any] = {"taps": 8, "tap_N": 4.0}
"""Taps of flat and long tips; 0.5 N taps are too short on them for clock synchronization."""
_SWEPT: Mapping[str, Any] = {
    "kind": "swept",
    "speed_mm_s": SPEED_MM_S,
    "depth_mm": 2.0,
    "threshold_N": 0.1,
    "seek_mm": 2.0,
    "reference_frames": 12,
    "places": MIDDLE,
}


def _grid() -> Mapping[str, Any]:
    """24 positions: 6 x 4, 6.4 mm apart along x and 7 mm along y."""
    return {
        "kind": "listed",
        "at_mm": [
            [round((i - (COLUMNS - 1) / 2) * APART_MM[0], 3), round((j - (ROWS - 1) / 2) * APART_MM[1], 3)]
            for j in range(ROWS)
            for i in range(COLUMNS)
        ],
    }


def _swept(name: str, until_n: float, **fields: Any) -> dict[str, Any]:
    return {**_SWEPT, "name": name, "until_N": until_n, **fields}


DEFAULT_PLAN: Mapping[str, Any] = {
    "kind": "stepped",
    "name": "nusense",
    "places": _grid(),
    "indenters": ["round"],
    "cycles": 1,
    "depth_mm": 1.6,
    "step_mm": 0.2,
    "frames": 2,
    "threshold_N": 0.1,
    "reference_frames": 12,
}
"""Plan for a calibration of depth, force, and position together."""

PLANS: Mapping[str, Mapping[str, Any]] = {
    "nusense-force": _swept("nusense-force", 8.0, indenters=["flat", "round"], cycles=5, **FIRM_TAPS),
    "nusense-places": _swept("nusense-places", 6.0, indenters=["round"], places=_grid(), cycles=3),
    "nusense-hysteresis": _swept("nusense-hysteresis", 8.0, indenters=["round"], cycles=3),
    "nusense-cycles": _swept("nusense-cycles", 8.0, indenters=["round"], cycles=70),
    "nusense-edges": _swept(
        "nusense-edges",
        8.0,
        indenters=[f"edge:{EDGE_MM}:{turn}" for turn in ANGLES_DEG],
        cycles=1,
        **FIRM_TAPS,
    ),
    "nusense-damage": _swept("nusense-damage", 4.0, indenters=["round"], cycles=4),
}
"""Sections 4.2 to 4.7: force, places, hysteresis, 70 cycles, edges at all angles, 1 to 4 N on each pad."""


REGION = "pad"
ABOVE_THE_TILES = 2  # layers
SOFT_GEL_PA = 0.1e6  # gel of the preset "soft"
ARM_M = 0.033e-3  # standard deviation of a position: a third of the arm's repeatability
BEYOND = 1 + 1e-9  # tolerance of the known depth for rounding


@dataclass(frozen=True, slots=True, eq=False)
class TileCorners:
    """True positions of the lattice's inner corners, where four tiles meet.

    Attributes:
        cells: (column, row) of the tile whose corner at +x and +y it is.
        rest_m: Position on the resting pad from its centre [m].
        skin_m: Present position, z from the resting pattern towards the camera [m].
        seen_m: Intersection of the ray with the resting pattern [m].
        places_px: Position in the image [px].
    """

    cells: Int[ndarray, "n 2"]
    rest_m: Float[ndarray, "n 2"]
    skin_m: Float[ndarray, "n 3"]
    seen_m: Float[ndarray, "n 2"]
    places_px: Float[ndarray, "n 2"]


@dataclass(frozen=True)
class NuSense:
    """NUSense of a spec.

    Attributes:
        live: Whether to interpolate straight presses of a round tip and draw noise from a table, which is
            five times as fast.
    """

    spec: NuSenseSpec = field(default_factory=NuSenseSpec)
    live: bool = False

    @property
    def name(self) -> str:
        return self.spec.name

    @property
    def frame_px(self) -> tuple[int, int]:
        height, width = self.spec.lens.size_px
        return width, height

    @property
    def rectified_px(self) -> tuple[int, int]:
        return self.frame_px

    @property
    def rate_hz(self) -> float:
        return self.spec.rate_hz

    @property
    def exposure_s(self) -> float:
        return self.spec.exposure_s

    @property
    def moves(self) -> Literal["probe", "sensor"]:
        return "sensor"

    @property
    def outline(self) -> Outline:
        return Outline.rectangle(*self.spec.effective_m)

    @property
    def axes(self) -> ImageAxes:
        """Axes in the image's middle: x to the right, y up."""
        scale = self.spec.lens.focal_px[0] / self.spec.camera_m
        return ImageAxes(REGION, (scale, 0.0), (0.0, -scale))

    @property
    def default_probe(self) -> str:
        return "round"

    def regions(self) -> Mapping[str, Box]:
        window = pad_window(self.spec, (0.0, 0.0))
        return {REGION: (window.left, window.top, window.right - window.left, window.bottom - window.top)}

    def probe(self, words: str) -> Probe:
        return parse_indenter(words)

    def specimen(self, words: str) -> Specimen | None:
        parse_indenter(words)
        return None

    def press(
        self, probe: Probe, pose: Pose, specimen: Specimen | None = None, history: PressHistory = FRESH
    ) -> Contact:
        if not is_rigid(specimen):
            raise RangeError(
                "NUSense is pressed by rigid indenters; a specimen that yields is not modelled",
                code="soft-specimen",
            )
        if not self.outline.contains(float(pose.x_m), float(pose.y_m)):
            half = [500 * side for side in self.spec.effective_m]
            raise RangeError(
                f"a press at ({1e3 * pose.x_m:.4g}, {1e3 * pose.y_m:.4g}) mm is beside the pad; press within "
                f"{half[0]:g} mm of its centre along x and {half[1]:g} mm along y",
                code="outside-pad",
            )
        known = self.known_depth_m(probe)
        if not pose.depth_m <= known * BEYOND:
            raise RangeError(
                f"a press of {1e3 * pose.depth_m:.6g} mm; this indenter is known to {1e3 * known:.6g} mm",
                code="outside-table",
            )
        if not 0 < history.stiffening < math.inf:
            raise RangeError(
                f"a stiffening of {history.stiffening}; give a number above 0, 1 for relaxed",
                code="not-positive",
            )
        spec = self.spec
        if self.live and spec.tear is None and pose.depth_m > 0 and goes_straight_down(probe, history):
            return replace(self._levels(probe).contact(pose, history), specimen=specimen)
        contact = (
            pad_contact(spec.layers.stack, spec.friction, probe, pose, history)
            if spec.tear is None
            else torn_contact(spec, spec.tear, probe, pose, history)
        )
        return replace(contact, specimen=specimen)

    def known_depth_m(
        self, probe: Probe, specimen: Specimen | None = None, *, lateral: bool = False
    ) -> float:
        """Depth at the maximum force or depth, whichever comes first [m]."""
        if not is_rigid(specimen):
            return 0.0
        return greatest_depth_m(self.spec.layers.stack, probe, self.spec.max_depth_m, self.spec.max_force_n)

    def render(self, contact: Contact, rng: np.random.Generator, seating: Seating = SEATED) -> Frame:
        view = self.view(contact, seating.shift_px)
        image = (exposed_by_table if self.live else exposed)(self.spec, view, rng, seating.light)
        return Frame(image, exposure_s=self.exposure_s, sensor=self.name)

    def view(self, contact: Contact, shift_px: tuple[float, float] = (0.0, 0.0)) -> Float[ndarray, "h w 3"]:
        """Frame without noise [grey levels]."""
        motion, tear = self.motion(contact), self.spec.tear
        if tear is None or isinstance(motion, PatternMotion):
            return clean_view(self.spec, motion if isinstance(motion, PatternMotion) else None, shift_px)
        return torn_view(self.spec, tear, motion, shift_px)

    def motion(self, contact: Contact) -> PatternMotion | TornMotion | None:
        """Motion of the tiles' lower face; None at rest."""
        if contact.force_n == 0:
            return None
        if self.spec.tear is not None:
            return torn_motion(self.spec, self.spec.tear, ABOVE_THE_TILES, contact)
        if self.live and contact.shear_pa is None and goes_straight_down(contact.probe, contact.history):
            return self._levels(contact.probe).motion(contact.pose)
        return pattern_motion(self.spec.layers.stack, ABOVE_THE_TILES, contact)

    def tile_corners(self, contact: Contact, seating: Seating = SEATED) -> TileCorners:
        """True positions of all inner corners under a contact."""
        pattern, D = self.spec.pattern, self.spec.camera_m
        columns, rows = np.meshgrid(np.arange(pattern.columns - 1), np.arange(pattern.rows - 1))
        cells = np.column_stack([columns.ravel(), rows.ravel()])
        middle = np.array([pattern.columns, pattern.rows]) / 2
        rest = (cells + 1 - middle) * pattern.cast_pitch_m + np.array(pattern.offset_m)
        motion = self.motion(contact)
        moved = np.zeros((3, len(rest))) if motion is None else motion.at(*rest.T)
        skin = np.column_stack([rest + moved[:2].T, moved[2]])
        seen = skin[:, :2] * (D / (D - skin[:, 2:]))
        return TileCorners(cells, rest, skin, seen, seen_px(self.spec, skin, seating.shift_px))

    def rectify(self, frame: Frame) -> Frame:
        """Frame of a pinhole camera with the same axis and scale."""
        import cv2

        lens = self.spec.lens
        lens.check_size((frame.image.shape[0], frame.image.shape[1]))
        width, height = self.rectified_px
        flat = lens.flat()
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)
        source = lens.project(flat.rays(pixels)).astype(np.float32)
        image = cv2.remap(frame.image, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
        return replace(frame, image=image)

    def shear_skin(self) -> TiledSkin:
        """Known properties for the shear reader: pattern, camera, lens, and layers."""
        spec = self.spec
        contact = self.press(self.probe(self.default_probe), Pose(0.0, 0.0, spec.max_depth_m / 2))
        moved = pattern_motion(spec.layers.stack, ABOVE_THE_TILES, contact).moved_m
        return TiledSkin(
            spec.pattern.pitch_m,
            spec.pattern.columns,
            spec.pattern.rows,
            spec.camera_m,
            spec.lens,
            sinking=float(moved[2].max() / np.hypot(moved[0], moved[1]).max()),
            layers=PatternedSkin(spec.layers.stack, ABOVE_THE_TILES, spec.camera_m, spec.friction),
            name=spec.name,
        )

    def for_live(self) -> NuSense:
        return replace(self, live=True)

    def draw_ahead(self, highest_m: float, deepest_m: float) -> None:
        """Solve the presses that live frames interpolate, and render one of each kind."""
        if not self.live:
            return
        probe, rng = self.probe(self.default_probe), np.random.default_rng(0)
        if self.spec.tear is None:
            self._levels(probe).solve()
        for depth_m in (-highest_m, deepest_m):
            self.render(self.press(probe, Pose(0.0, 0.0, depth_m)), rng)

    def _levels(self, probe: Probe) -> PressLevels:
        return PressLevels(self.spec.layers.stack, ABOVE_THE_TILES, probe, self.known_depth_m(probe))

    def default_plan(self) -> Mapping[str, Any]:
        return DEFAULT_PLAN

    def plans(self) -> Mapping[str, Mapping[str, Any]]:
        return PLANS

    def variation(self) -> Mapping[str, Any]:
        """Relaxation of the pad, and the arm's repeatability of 0.1 mm as three sigma."""
        return {"relaxation": self.spec.relaxation, "place_m": ARM_M, "tilt_rad": (0.0, 0.0)}


def nusense(preset: str = "") -> NuSense:
    """Return NUSense as designed, "soft" with half the gel's modulus, "torn" with a cut, or unit "7" or
    "torn-7".
    """
    spec = NuSenseSpec()
    if preset == "soft":
        return NuSense(replace(spec, layers=replace(spec.layers, gel_pa=SOFT_GEL_PA), name="nusense-soft"))
    if preset == "torn":
        return NuSense(replace(spec, tear=Tear(), name="nusense-torn"))
    if preset.startswith("torn-"):
        spec, preset = (
            replace(spec, tear=Tear(), name="nusense-torn"),
            preset.removeprefix("torn-") or "torn-",
        )
    if preset.isdecimal() and len(preset) < 7:
        return NuSense(fabricated(int(preset), spec))
    if preset:
        raise InputError(
            f"there is no NUSense {preset!r}; there are soft, torn, and copies by number, as 7 or torn-7",
            code="unknown-name",
        )
    return NuSense(spec)
