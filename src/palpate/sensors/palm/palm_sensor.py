"""The photoelastic palm under the contract of every sensor."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from scipy.interpolate import PchipInterpolator

from palpate.core import (
    FRESH,
    SEATED,
    Box,
    Contact,
    Float32,
    ForceLaw,
    Frame,
    ImageAxes,
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
from palpate.mechanics.axisymmetric.disc_table import DiscTable
from palpate.mechanics.axisymmetric.pulled_sphere import pulled_sphere_table
from palpate.mechanics.half_space.hertz import tangential_stiffness
from palpate.mechanics.probe_contact import probe_law
from palpate.mechanics.probe_table import ProbeTable
from palpate.recordings.preparation import Preparation
from palpate.sensors.palm import palm_spec
from palpate.sensors.palm.membrane_faults import EVEN, thickness_range
from palpate.sensors.palm.palm_press import (
    FRICTION,
    LINEAR_DEPTH_M,
    has_table,
    is_pulled_deep,
    load_with_rim,
    own_ball,
    press,
    press_layers,
    pull_of_shift,
    table_of,
)
from palpate.sensors.palm.palm_render import expose, is_ball, render, render_clean
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.press_corrections import rim_by_place
from palpate.sensors.palm.probe_shapes import (
    as_pair,
    has_probe_table,
    parse_probe,
    probe_table_of,
    upright_ball,
)

RATE_HZ = 30.0  # frame rate of the report

RECTIFIED_PX = 224
"""Maximum side of a rectified region [px], the input size of the report's networks."""

RIG_PX = 128  # side of both regions on a virtual rig
KNOTS = 1201  # depths of a force law
PLACES = 7  # sampled thicknesses of an uneven membrane
PRESSES = 13  # presses of linear layers for a force law
FIRST = np.array([1 / 16, 1 / 8, 1 / 4, 1 / 2])  # additional depths of narrow probes, over the first press
LEVEL_M = 50e-6
"""Depth step between cached live images [m]; 99 % of pixels lie within 0.004 of the lamp's light."""
NO_DEPTH_M = 1e-9  # depth of a touching probe; at exactly 0 none is drawn
PICTURES = 64  # cached images under other probes and lateral loads

Picture = tuple[Float32[ndarray, "h w 3"], Float32[ndarray, "u v 3"]]


@dataclass(frozen=True)
class Palm:
    """The photoelastic palm. A `Seating` changes its lamp only, since the camera is fixed to the housing.

    Attributes:
        level_m: Depth step between which images of the own ball are interpolated [m]; 0 renders each depth.
    """

    spec: PalmSpec = field(default_factory=PalmSpec)
    level_m: float = 0.0
    _slow: OrderedDict[Hashable, Any] = field(default_factory=OrderedDict, repr=False, compare=False)

    @property
    def name(self) -> str:
        return self.spec.name

    @property
    def frame_px(self) -> tuple[int, int]:
        return self.spec.frame_px

    @property
    def rectified_px(self) -> tuple[int, int]:
        side = min(RECTIFIED_PX, *self.spec.fringes.size_px, *self.spec.mirror.size_px)
        return 2 * side, side

    @property
    def rate_hz(self) -> float:
        return RATE_HZ

    @property
    def exposure_s(self) -> float:
        return self.spec.exposure_s

    @property
    def moves(self) -> Literal["probe", "sensor"]:
        return "probe"

    @property
    def outline(self) -> Outline:
        return Outline.disc(self.spec.diameter_m)

    @property
    def axes(self) -> ImageAxes:
        wide, high = self.spec.mirror.pitches_m
        return ImageAxes("mirror", (1 / wide, 0.0), (0.0, math.sin(self.spec.mirror_elevation_rad) / high))

    @property
    def default_probe(self) -> str:
        return f"sphere:{round(2e3 * self.spec.indenter_radius_m, 9):g}"

    def regions(self) -> Mapping[str, Box]:
        return {"fringes": self.spec.fringes.box_px, "mirror": self.spec.mirror.box_px}

    def dark_field(self) -> Box:
        """Fringe region below the membrane's surface, lit by stress alone."""
        view = self.spec.fringes
        x, y, wide, high = view.box_px
        lowered = view.middle_px[1] + view.shift_px[1] + wide / 2 * abs(math.sin(view.turn_rad))
        top = math.ceil(lowered) + 1
        return x, y + top, wide, high - top

    def probe(self, words: str) -> Probe:
        return parse_probe(words)

    def specimen(self, words: str) -> Specimen | None:
        return None

    def press(
        self, probe: Probe, pose: Pose, specimen: Specimen | None = None, history: PressHistory = FRESH
    ) -> Contact:
        if not is_rigid(specimen):
            raise RangeError("soft specimens are not modeled on the palm", code="soft-specimen")
        if probe != self._ball:
            history = replace(history, stiffening=1.0)  # all but the ball know the relaxed skin alone
        lateral_n = self._lateral_n(probe, pose, history)
        if lateral_n == (0.0, 0.0) and probe == self._ball:
            contact = press(self._stiffened(history), pose)
        else:
            load_n = load_with_rim(self.spec, pose, probe, lateral_n)
            key = ("press", pose, probe, load_n)
            contact = self._kept(key, lambda: press(self.spec, pose, probe, load_n))
        return replace(contact, history=replace(history, lateral_n=lateral_n))

    def known_depth_m(
        self, probe: Probe, specimen: Specimen | None = None, *, lateral: bool = False
    ) -> float:
        """Return the maximum depth that `press` accepts at every position; 0 if the own ball has no table
        [m].
        """
        if not is_rigid(specimen):
            return 0.0
        even = replace(self.spec, gel=EVEN)
        each = np.linspace(*thickness_range(self.spec), PLACES if self.spec.gel.thickness else 1)
        return min(_deepest(replace(even, thickness_m=float(h)), probe, lateral) for h in each)

    def force_law(self, probe: Probe, specimen: Specimen | None = None) -> ForceLaw:
        """Return the table's force law, or one interpolated between presses of linear layers."""
        return force_law_of(self.spec, probe)

    def render(self, contact: Contact, rng: np.random.Generator, seating: Seating = SEATED) -> Frame:
        gain = self.spec.lamp_gain * seating.light
        if is_ball(contact, self.spec):
            spec = replace(self._stiffened(contact.history), lamp_gain=gain)
            if self.level_m > 0 and contact.pose.depth_m != 0:
                return expose(self._mixed(contact, spec), spec, rng)
            return render(contact, spec, rng)
        at_setup = replace(self.spec, lamp_gain=1.0)
        key = ("picture", contact.pose, contact.probe, contact.lateral_n, contact.moment_nm)
        fringes, below = self._kept(key, lambda: render_clean(contact, at_setup))
        light = np.float32(gain)
        return expose((light * fringes, light * below), self.spec, rng)

    def rectify(self, frame: Frame) -> Frame:
        width, height = self.rectified_px
        regions = self.regions()
        cut = Preparation(regions["fringes"], (height, width), 3, regions["mirror"])
        return replace(frame, image=cut.apply(frame.image))

    def default_plan(self) -> Mapping[str, Any]:
        return {
            "kind": "stepped",
            "name": "palm",
            "places": {"kind": "grid", "per_side": 15, "pitch_mm": 7.0},
            "cycles": 5,
            "depth_mm": 5.0,
            "step_mm": 0.1,
            "frames": 25,
        }

    def plans(self) -> Mapping[str, Mapping[str, Any]]:
        short = {"kind": "stepped", "cycles": 1, "frames": 5, "reference_frames": 5, "step_mm": 0.5}
        centre = {"kind": "listed", "at_mm": [[0.0, 0.0]]}
        dwell = {"depths_mm": [4.0], "seconds": 60.0, "frames": 60}
        sideways = [[0.3, 0.0], [0.0, 0.3], [-0.3, 0.0], [0.0, -0.3]]
        plans = {
            "palm-reduced": short | {"depth_mm": 4.0, "step_mm": 1.0, "frames": 2, "reference_frames": 1},
            "palm-validation": short
            | {"places": {"kind": "scattered", "count": 20, "apart_mm": 3.0, "seed": 1}},
            "palm-lateral": short
            | {
                "places": {"kind": "grid", "pitch_mm": 12.0},
                "depth_mm": 1.5,
                "lateral": {"depths_mm": [1.0], "to_mm": sideways},
            },
            "palm-creep": short
            | {"places": centre, "depth_mm": 4.0, "step_mm": 1.0, "unloading": True, "dwell": dwell},
        }
        return {name: {"name": name} | fields for name, fields in plans.items()}

    def for_rig(self) -> Palm:
        """Reduce both regions to squares of 128 px."""
        small = max(self.frame_px) <= 2 * RIG_PX
        return self if small else Palm(palm_spec.cropped(self.spec, RIG_PX, f"{self.spec.name}-rig"))

    def for_live(self) -> Palm:
        """Reduce both regions as on a rig and interpolate the ball's images between cached depths."""
        return replace(self.for_rig(), level_m=LEVEL_M, _slow=OrderedDict())

    def draw_ahead(self, highest_m: float, deepest_m: float) -> None:
        """Cache the ball's centred images from a height above the membrane to a depth [m]."""
        if self.level_m <= 0:
            return
        contact = self.press(self._ball, Pose(0.0, 0.0, 0.0))
        most = math.floor(self.force_law(self._ball).greatest_m / self.level_m)
        last = min(math.ceil(deepest_m / self.level_m), most)
        for level in range(math.floor(-highest_m / self.level_m), last + 1):
            pose = Pose(0.0, 0.0, level * self.level_m or NO_DEPTH_M)
            render_clean(replace(contact, pose=pose), self.spec)

    def _mixed(self, contact: Contact, spec: PalmSpec) -> Picture:
        pose = contact.pose
        place = pose.depth_m / self.level_m
        most = self.force_law(self._ball).greatest_m / self.level_m
        lower = math.floor(min(place, most - 1))
        share = np.float32(place - lower)
        (light, below), (deeper, deeper_below) = (
            self._at_level(contact, spec, k) for k in (lower, lower + 1)
        )
        return light + share * (deeper - light), below + share * (deeper_below - below)

    def _at_level(self, contact: Contact, spec: PalmSpec, level: int) -> Picture:
        pose = contact.pose
        here = Pose(round(pose.x_m, 6), round(pose.y_m, 6), level * self.level_m or NO_DEPTH_M)
        key = ("level", here, spec.lamp_gain, spec.youngs_modulus_pa)
        return self._kept(key, lambda: render_clean(replace(contact, pose=here), spec))

    @property
    def _ball(self) -> Probe:
        return own_ball(self.spec)

    def _stiffened(self, history: PressHistory) -> PalmSpec:
        """The palm before stress relaxation; light depends on stress, which relaxes with the force."""
        if history.stiffening == 1.0:
            return self.spec
        return replace(self.spec, youngs_modulus_pa=self.spec.youngs_modulus_pa * history.stiffening)

    def _lateral_n(self, probe: Probe, pose: Pose, history: PressHistory) -> tuple[float, float]:
        """Lateral force of the path: given, from the pulled ball's table, or from Mindlin's law."""
        if history.lateral_n is not None:
            return history.lateral_n
        if not history.path_m or pose.depth_m <= 0:
            return 0.0, 0.0
        x, y = history.path_m[-1]
        shift, law = math.hypot(x, y), self.force_law(probe)
        most = FRICTION * float(np.interp(pose.depth_m, law.depth_m, law.force_n))
        stiff = float(np.interp(pose.depth_m, law.depth_m, law.lateral_n_m))
        if shift == 0 or most == 0:
            return 0.0, 0.0
        if probe == self._ball and is_pulled_deep(self.spec):
            pull = pull_of_shift(self.spec, pose, shift)
            return pull * x / shift, pull * y / shift
        free = 1.0 - 2 * stiff * shift / (3 * most)
        if free <= 0:
            raise RangeError(
                f"shifted by {1e3 * shift:.3g} mm at {1e3 * pose.depth_m:.3g} mm the probe slips over the "
                "palm; shift less, or press deeper"
            )
        pull = most * (1.0 - free**1.5)
        return pull * x / shift, pull * y / shift

    def _kept(self, key: Hashable, make: Any) -> Any:
        if key not in self._slow:
            self._slow[key] = make()
            while len(self._slow) > 2 * PICTURES:
                self._slow.popitem(last=False)
        return self._slow[key]


def palm(preset: str = "palm") -> Palm:
    """Return the palm of a named preset."""
    return Palm(palm_spec.preset(preset))


def _deepest(spec: PalmSpec, probe: Probe, lateral: bool) -> float:
    """Maximum depth that `palm_press.press` accepts on an even membrane [m]."""
    probe = as_pair(upright_ball(probe))
    own = probe == own_ball(spec)
    if not lateral or (own and is_pulled_deep(spec)):
        if has_table(spec, probe):
            return table_of(spec, probe).greatest_depth * probe.radius_m
        if own:
            return 0.0
    if not lateral and has_probe_table(spec, probe):
        return probe_table_of(spec, probe).greatest_depth * spec.thickness_m
    return LINEAR_DEPTH_M


@lru_cache(maxsize=16)
def force_law_of(spec: PalmSpec, probe: Probe) -> ForceLaw:
    """Return the force law of a palm under a probe."""
    probe = as_pair(upright_ball(probe))
    own = probe == own_ball(spec)
    even, alike = replace(spec, gel=EVEN), spec.gel.thickness == 0.0
    if own or (alike and has_table(even, probe)):
        depth, force, radius = _of_table(even, table_of(even, probe), probe.radius_m)
    elif alike and has_probe_table(even, probe):
        depth, force, radius = _of_probe_table(even, probe_table_of(even, probe))
    else:
        depth, force, radius = _of_layers(even, probe)
    lateral = radius * tangential_stiffness(1.0, spec.youngs_modulus_pa, spec.poisson_ratio)
    if own and is_pulled_deep(spec):
        R = spec.indenter_radius_m
        ratio = pulled_sphere_table().stiffness_ratio(depth / R, spec.thickness_m / R)
        lateral = lateral * ratio
    by_place = rim_by_place(spec) if own else None
    return ForceLaw(depth, force, radius, lateral, by_place)


def _of_table(spec: PalmSpec, table: DiscTable, R: float) -> tuple[ndarray, ndarray, ndarray]:
    depth = np.linspace(0.0, table.greatest_depth * R, KNOTS)
    force = table.force_at(depth / R) * spec.youngs_modulus_pa * R**2
    return depth, force, np.interp(depth, table.depth * R, table.contact_radius * R)


def _of_probe_table(spec: PalmSpec, table: ProbeTable) -> tuple[ndarray, ndarray, ndarray]:
    h = spec.thickness_m
    depth = np.linspace(0.0, table.greatest_depth * h, KNOTS)
    force, area, _ = probe_law(table, depth / h)
    return depth, force * spec.youngs_modulus_pa * h**2, np.sqrt(area / math.pi) * h


def _of_layers(spec: PalmSpec, probe: Probe) -> tuple[ndarray, ndarray, ndarray]:
    pressed = np.linspace(0.0, LINEAR_DEPTH_M, PRESSES)
    if press_layers(spec, Pose(0.0, 0.0, float(pressed[1])), probe).is_narrow:
        pressed = np.insert(pressed, 1, pressed[1] * FIRST)
    presses = [press_layers(spec, Pose(0.0, 0.0, float(d)), probe) for d in pressed]
    depth = np.linspace(0.0, LINEAR_DEPTH_M, KNOTS)
    force = PchipInterpolator(pressed, [one.contact.force_n for one in presses])(depth)
    radius = PchipInterpolator(pressed, np.sqrt(np.array([p.area_m2 for p in presses]) / math.pi))(depth)
    return depth, np.asarray(force), np.asarray(radius)
