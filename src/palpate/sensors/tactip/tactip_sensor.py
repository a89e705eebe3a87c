"""The TacTip as a `Sensor`. A pose (x, y) away from the apex is a face that tilts towards it.

Faces are rigid plates, the tables' cylinder, flat or domed, and layers on a rigid base.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from palpate.core import (
    FRESH,
    RIGID,
    SEATED,
    WORDS_OF_SPECIMENS,
    Box,
    Contact,
    Float,
    ForceLaw,
    Frame,
    ImageAxes,
    InputError,
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
from palpate.mechanics.axisymmetric.axisymmetric_fem import CreepingPress, Prony
from palpate.mechanics.axisymmetric.disc_table import SAME
from palpate.mechanics.axisymmetric.shape_table import shape_table
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress
from palpate.sensors.tactip import tactip_spec as specs
from palpate.sensors.tactip.inclined_press import MAX_TILT, inclined
from palpate.sensors.tactip.tactip_camera import projected, rendered
from palpate.sensors.tactip.tactip_press import (
    HeadOn,
    TipOnSpecimen,
    ViscousPress,
    modulus_pa,
    pictured,
    pixels_per_tangent,
)
from palpate.sensors.tactip.tactip_spec import TacTipSpec

FITTED = "331-fitted"
REGION = "pins"
PLATE, SPHERE = "plate", "sphere"
FLAT_SHAPES = (RIGID, "cylinder")  # shapes that can be inclined
MAX_LEAN = math.radians(2.0)  # maximum misalignment of a face, see `LeaningSkin`

REACH = 1.5  # half the grid of a contact, in contact radii
CELLS = 64
KNOTS = 1201  # points of a force law
WORDS = f"{WORDS_OF_SPECIMENS}; flat ones with @TILT [deg] where their top is inclined"


@dataclass(frozen=True)
class TacTip:
    """The TacTip of a spec, without lateral loads."""

    spec: TacTipSpec = field(default_factory=TacTipSpec)

    @property
    def name(self) -> str:
        return "tactip" if self.spec.pins == specs.PINS_127 else f"tactip-{self.spec.pins.count}"

    @property
    def frame_px(self) -> tuple[int, int]:
        return self.spec.camera.size_px, self.spec.camera.size_px

    @property
    def rectified_px(self) -> tuple[int, int]:
        return self.frame_px

    @property
    def rate_hz(self) -> float:
        return self.spec.camera.rate_hz

    @property
    def exposure_s(self) -> float:
        return self.spec.camera.exposure_s

    @property
    def moves(self) -> Literal["probe", "sensor"]:
        return "sensor"

    @property
    def outline(self) -> Outline:
        """Positions at which the face's tilt is within MAX_LEAN."""
        return Outline.disc(2 * self.spec.table.radius_m * math.sin(MAX_LEAN))

    @property
    def axes(self) -> ImageAxes:
        """Axes at the apex, x to the right and y down."""
        _, share = projected(np.zeros((1, 3)), self.spec.camera, self.spec.table.radius_m)
        scale = pixels_per_tangent(self.spec) * float(share[0])
        return ImageAxes(REGION, (scale, 0.0), (0.0, scale))

    @property
    def default_probe(self) -> str:
        return RIGID

    def regions(self) -> Mapping[str, Box]:
        return {REGION: (0, 0, *self.frame_px)}

    def probe(self, words: str) -> Probe:
        """Parse a face, upright or inclined towards +x as "S1=7.6@30"; see `Specimen.parse`."""
        specimen, tilt_deg = _read(words)
        if math.isfinite(specimen.radius_m):
            return Probe(SPHERE, specimen.radius_m)
        return Probe(PLATE, 0.0, tilt_rad=math.radians(tilt_deg))

    def specimen(self, words: str) -> Specimen | None:
        specimen, _ = _read(words)
        return None if is_rigid(specimen) or specimen.youngs_modulus_pa == math.inf else specimen

    def press(
        self, probe: Probe, pose: Pose, specimen: Specimen | None = None, history: PressHistory = FRESH
    ) -> Contact:
        """Press a face onto the dome.

        Force and area are of finite-strain tables or linear bodies, as the contact's `model` states; the
        pressure distribution is a sphere's.
        """
        if history.path_m or any(history.lateral_n or ()):
            raise RangeError("a load along the skin of the TacTip is not modelled; press straight down")
        if not self.outline.contains(pose.x_m, pose.y_m):
            raise RangeError(
                f"at ({1e3 * pose.x_m:.3g}, {1e3 * pose.y_m:.3g}) mm the face leans more than "
                f"{math.degrees(MAX_LEAN):g} degrees; touch within "
                f"{1e3 * self.outline.radius_m:.3g} mm of the apex, or incline the specimen"
            )
        tip = self.tip_on(probe, specimen)
        if not pose.depth_m <= tip.deepest_m * (1 + SAME):
            # seven digits: what is printed differs by more than SAME, and the limit as printed is allowed
            raise RangeError(
                f"an approach of {1e3 * pose.depth_m:.7g} mm; this contact is known to "
                f"{1e3 * tip.deepest_m:.7g} mm"
            )
        depth = np.array([min(max(pose.depth_m, 0.0), tip.deepest_m)])
        force_n = float(tip.force_n(depth)[0])
        viscous = self.viscous(probe, specimen)
        if viscous is not None:
            force_n = min(force_n * history.stiffening, viscous.most_n)
            area_m2 = max(viscous.area_m2(force_n, viscous.modulus_pa(float(depth[0]), force_n)), 0.0)
        else:
            area_m2 = float(tip.area_m2(np.array([force_n]))[0])
        radius_m = math.sqrt(area_m2 / math.pi)
        contact = self._contact(probe, pose, force_n, radius_m, tip.law)
        return replace(contact, specimen=specimen, history=history)

    def known_depth_m(
        self, probe: Probe, specimen: Specimen | None = None, *, lateral: bool = False
    ) -> float:
        return 0.0 if lateral else self.tip_on(probe, specimen).deepest_m

    def force_law(self, probe: Probe, specimen: Specimen | None = None) -> ForceLaw:
        tip = self.tip_on(probe, specimen)
        depth = np.linspace(0.0, tip.deepest_m, KNOTS)
        force = tip.force_n(depth)
        return ForceLaw(depth, force, np.sqrt(tip.area_m2(force) / math.pi), np.zeros(KNOTS))

    def render(self, contact: Contact, rng: np.random.Generator, seating: Seating = SEATED) -> Frame:
        image = rendered(*self.markers_px(contact, seating), self.spec.camera, rng, seating.light)
        return Frame(image, exposure_s=self.exposure_s, sensor=self.name)

    def markers_px(
        self, contact: Contact, seating: Seating = SEATED
    ) -> tuple[Float[ndarray, "p 2"], Float[ndarray, " p"]]:
        """True centres (x, y) and radii of the markers, the middle pin first [px]."""
        tip, pose = self.tip_on(contact.probe, contact.specimen), contact.pose
        viscous = self.viscous(contact.probe, contact.specimen)
        depth_m = max(pose.depth_m, 0.0)
        if viscous is not None:
            tip = viscous.on(viscous.modulus_pa(depth_m, contact.force_n))
            depth_m = min(depth_m, tip.deepest_m)
        return pictured(self.spec, tip.skin(depth_m, self.lean_rad(pose)), seating.shift_px)

    def lean_rad(self, pose: Pose) -> tuple[float, float]:
        """Tilt of a face that touches away from the apex, towards +x and -y [rad]."""
        return pose.x_m / self.spec.table.radius_m, -pose.y_m / self.spec.table.radius_m

    def rectify(self, frame: Frame) -> Frame:
        height, width = frame.image.shape[:2]
        if (width, height) != self.frame_px:
            raise InputError(
                f"a frame of {width} x {height} px; this TacTip's have {self.frame_px[0]} x "
                f"{self.frame_px[1]} px"
            )
        return frame

    def default_plan(self) -> Mapping[str, Any]:
        """The report's specimens and a rigid plate, five presses each at 5 mm/s to 5 N."""
        return {
            "kind": "swept",
            "name": "tactip",
            "places": {"kind": "listed", "at_mm": [[0.0, 0.0]]},
            "indenters": [RIGID, "S1=7.6", "S2=3.1", "S3=1.1", "new=5.3?"],
            "cycles": 5,
            "speed_mm_s": 1e3 * self.spec.speed_m_s,
            "until_N": 5.1,
            "depth_mm": 11.0,
            "threshold_N": 0.5,
            "wait_s": 1.0,
            "press_mm_s": 5.0,
            "seek_mm": 3.5,
            "tap_N": 2.0,
        }

    def variation(self) -> Mapping[str, Any]:
        seat, force = self.spec.seating, self.spec.force
        return {
            "seating_m": seat.position_m,
            "place_m": seat.tilt_rad * self.spec.table.radius_m,
            "tilt_rad": (0.0, 0.0),
            "lean": (0.0, 0.0),
            "lean_spread": (0.0, 0.0),
            "lamp": seat.light,
            "shift_px": seat.shift_px,
            "force_noise_n": force.noise_n,
            "force_step_n": force.resolution_n,
            "relaxation": (),
        }

    def on(self, words: str) -> TipOnSpecimen:
        return self.tip_on(self.probe(words), self.specimen(words))

    def tip_on(self, probe: Probe, specimen: Specimen | None) -> TipOnSpecimen:
        if probe.shape not in (PLATE, SPHERE):
            raise InputError(
                f"the TacTip is pressed onto a flat face or a sphere, not a {probe.shape}; give {WORDS}"
            )
        if probe.turn_rad:
            raise InputError("a face inclined towards another side than +x is not modelled; turn the tip")
        thickness_m = None if specimen is None else specimen.thickness_m
        modulus_pa = self._modulus_pa(specimen)
        if probe.shape == SPHERE or thickness_m is not None:
            if probe.tilt_rad:
                raise InputError("spheres and layers are pressed head-on; give no tilt")
            return _tip_on_shape(self.spec, modulus_pa, probe.radius_m or math.inf, thickness_m)
        return _tip_on(self.spec, modulus_pa, probe.tilt_rad)

    def viscous(self, probe: Probe, specimen: Specimen | None) -> ViscousPress | None:
        """The tip on a viscous specimen; None if it is elastic."""
        if specimen is None or not specimen.branches:
            return None
        if probe.tilt_rad:
            raise InputError("viscous specimens are pressed head-on; give no tilt")
        return _viscous(self, probe, specimen)

    def creeping(self, probe: Probe, specimen: Specimen | None) -> CreepingPress | None:
        """State of a press on a viscous specimen; None if it is elastic."""
        viscous = self.viscous(probe, specimen)
        return None if viscous is None else viscous.begun()

    def _modulus_pa(self, specimen: Specimen | None) -> float:
        if specimen is None:
            return math.inf
        if specimen.youngs_modulus_pa is not None:
            return specimen.youngs_modulus_pa
        if specimen.stiffness_n_m is None:
            raise InputError(f"the specimen {specimen.name!r} has neither a stiffness nor a modulus")
        return modulus_pa(self.spec.table, specimen.stiffness_n_m)

    def _contact(self, probe: Probe, pose: Pose, force_n: float, radius_m: float, law: str) -> Contact:
        a, R = radius_m, self.spec.table.radius_m
        R = 1 / (1 / R + 1 / probe.radius_m) if probe.shape == SPHERE else R
        half = REACH * a if a > 0 else 1e-3
        at = (np.arange(CELLS) + 0.5 - CELLS / 2) * 2 * half / CELLS
        r2 = at**2 + at[:, None] ** 2
        touching = r2 < a**2
        shape = np.sqrt(np.maximum(1 - r2 / a**2, 0.0)) if a > 0 else np.zeros_like(r2)
        cell = (at[1] - at[0]) ** 2
        whole = float(shape.sum()) * cell
        return Contact(
            x_m=pose.x_m + at,
            y_m=pose.y_m + at,
            pressure_pa=shape * (force_n / whole) if whole > 0 else shape,
            displacement_m=np.where(touching, (a**2 - r2) / (2 * R), 0.0),
            touching=touching,
            force_n=force_n,
            radius_m=a,
            probe=probe,
            pose=pose,
            model=f"a dome on a face, {law}; pressure drawn as a sphere's over the known force and area",
        )


def tactip(preset: str = "127") -> TacTip:
    """Return the TacTip with 127 or 331 pins, or "331-fitted"."""
    if preset == FITTED:
        return TacTip(specs.fitted_tactip())
    if not preset.isdecimal():
        raise InputError(
            f"there is no TacTip {preset!r}; there are 127 and 331, by their number of pins, and {FITTED}",
            code="unknown-name",
        )
    return TacTip(specs.tactip(int(preset)))


@lru_cache(maxsize=64)
def _tip_on(spec: TacTipSpec, specimen_pa: float, tilt_rad: float) -> TipOnSpecimen:
    if tilt_rad == 0:
        return HeadOn(spec.table.press(specimen_pa), spec.table.radius_m)
    return inclined(spec, specimen_pa, tilt_rad)


@lru_cache(maxsize=16)
def _viscous(sensor: TacTip, probe: Probe, specimen: Specimen) -> ViscousPress:
    assert specimen.youngs_modulus_pa is not None
    shape = probe.radius_m or math.inf, specimen.thickness_m

    def on(modulus_pa: float) -> HeadOn:
        return HeadOn(_pressed_shape(sensor.spec, modulus_pa, *shape), sensor.spec.table.radius_m)

    moduli, times = zip(*specimen.branches, strict=True)
    return ViscousPress(on, Prony(specimen.youngs_modulus_pa, moduli, times))


@lru_cache(maxsize=64)
def _tip_on_shape(
    spec: TacTipSpec, modulus_pa: float, radius_m: float, thickness_m: float | None
) -> TipOnSpecimen:
    return HeadOn(_pressed_shape(spec, modulus_pa, radius_m, thickness_m), spec.table.radius_m)


def _pressed_shape(
    spec: TacTipSpec, modulus_pa: float, radius_m: float, thickness_m: float | None
) -> HeadOnPress:
    if thickness_m is not None:
        return shape_table(spec.tip).layer(thickness_m, modulus_pa)
    if math.isinf(radius_m):
        return spec.table.press(modulus_pa)
    return shape_table(spec.tip).dome(radius_m, modulus_pa)


def _read(words: str) -> tuple[Specimen, float]:
    """Specimen and tilt [deg] of "S1=7.6@30"."""
    what, at, leaning = words.partition("@")
    specimen = Specimen.parse(what)
    try:
        tilt = float(leaning) if at else 0.0
    except ValueError:
        raise InputError(f"{words!r} is inclined by no number; give {WORDS}") from None
    if tilt and (specimen.shape not in FLAT_SHAPES or specimen.branches):
        what = "viscous specimen" if specimen.branches else specimen.shape
        raise InputError(f"{words!r}: a {what} is pressed head-on; give it no tilt")
    if not 0 <= math.radians(tilt) <= MAX_TILT:
        raise InputError(
            f"{words!r} is inclined by {tilt:g}; 0 to {math.degrees(MAX_TILT):g} degrees are modelled",
            code="tilt",
        )
    return specimen, tilt
