"""The contract of a sensor design with everything that uses one: rig, calibration, live loop, and pages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy import ndarray

from palpate.core.contact import FRESH, Contact, Outline, Pose, PressHistory, Probe, Specimen
from palpate.core.frame import Frame
from palpate.core.plugins import PluginRegistry
from palpate.core.shapes import Float

Box = tuple[int, int, int, int]
"""x, y, width, height [px]."""

Knots = Float[ndarray, " k"]

PRESSES = 25  # between which a force law is laid
KNOTS = 601  # of a force law, between which it is read along straight lines
MINDLIN = 2 / 3  # tangential over normal stiffness of an incompressible body under a rigid probe


@dataclass(frozen=True, slots=True)
class Seating:
    """Set-up of the sensor for one press, where that differs from press to press.

    A sensor whose design holds one of these fixed leaves it out, and its documentation says so.

    Attributes:
        light: over the light at set-up.
        shift_px: of the whole image, along columns and rows [px].
    """

    light: float = 1.0
    shift_px: tuple[float, float] = (0.0, 0.0)


SEATED = Seating()
"""The seating at set-up."""


@dataclass(frozen=True, slots=True)
class ImageAxes:
    """Directions of the skin in a region of the frame.

    Attributes:
        region: in which a contact is seen to move.
        across: columns by which it moves for a metre along the skin's x and y [px/m].
        down: rows by which it moves for the same [px/m].
    """

    region: str
    across: tuple[float, float]
    down: tuple[float, float]

    def moved_px(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Columns and rows by which a contact moves in the image [px]."""
        (xx, xy), (yx, yy) = self.across, self.down
        return xx * x_m + xy * y_m, yx * x_m + yy * y_m


class PlaceEffect(NamedTuple):
    """What places on a skin do to a force law that was found in its middle.

    Attributes:
        ratio: normal force over the law's.
        lateral_ratio: force of the probe on the skin along x and y, over the normal force there.
    """

    ratio: Float[ndarray, " n"]
    lateral_ratio: Float[ndarray, "n 2"]


@dataclass(frozen=True, slots=True, eq=False)
class ForceLaw:
    """Force of the relaxed skin on a probe, over depth, in the middle of the skin.

    Attributes:
        depth_m: ascending from 0, to the deepest that is known [m].
        force_n: normal force at each [N].
        radius_m: of the contact, or of a circle as large [m].
        lateral_n_m: force that builds up for a small shift along the skin, while the probe sticks [N/m].
        by_place: what places do to the force, at arrays of x, y and depth [m]; None for a skin that is
            everywhere the same.
    """

    depth_m: Knots
    force_n: Knots
    radius_m: Knots
    lateral_n_m: Knots
    by_place: Callable[[ndarray, ndarray, ndarray], PlaceEffect] | None = None

    @property
    def greatest_m(self) -> float:
        """The deepest that is known [m]."""
        return float(self.depth_m[-1])

    def at_places(
        self, x_m: Float[ndarray, " n"], y_m: Float[ndarray, " n"], depth_m: Float[ndarray, " n"]
    ) -> PlaceEffect:
        """What places do to the force at depths; nothing where the skin is everywhere the same."""
        if self.by_place is None:
            return PlaceEffect(np.ones(len(depth_m)), np.zeros((len(depth_m), 2)))
        return self.by_place(x_m, y_m, depth_m)


@runtime_checkable
class Sensor(Protocol):
    """One sensor design, at one size of its image. It is not changed by what is asked of it."""

    @property
    def name(self) -> str:
        """Name of it in its frames and runs."""

    @property
    def spec(self) -> Any:
        """Every number of it: a frozen dataclass."""

    @property
    def frame_px(self) -> tuple[int, int]:
        """(width, height) of its frames [px]."""

    @property
    def rectified_px(self) -> tuple[int, int]:
        """(width, height) of a rectified frame, see `rectify` [px]."""

    @property
    def rate_hz(self) -> float:
        """Frames a second."""

    @property
    def exposure_s(self) -> float:
        """Exposure of a frame [s]."""

    @property
    def moves(self) -> Literal["probe", "sensor"]:
        """Which of the two a stage moves; poses are the probe's either way."""

    @property
    def outline(self) -> Outline:
        """Part of the skin on which a probe may come down."""

    @property
    def axes(self) -> ImageAxes:
        """Directions of the skin in its image; `palpate.check` alone reads them so far."""

    @property
    def default_probe(self) -> str:
        """The words of the probe that its protocol presses."""

    def regions(self) -> Mapping[str, Box]:
        """Parts of the frame that matter, by name, (x, y, width, height) [px]."""

    def probe(self, words: str) -> Probe:
        """A probe from words, such as "sphere:10"."""

    def specimen(self, words: str) -> Specimen | None:
        """The compliant body that the same words name; None for a rigid probe."""

    def press(
        self, probe: Probe, pose: Pose, specimen: Specimen | None = None, history: PressHistory = FRESH
    ) -> Contact:
        """Press a probe into the skin, or a specimen.

        Args:
            probe: what touches.
            pose: where and how deep; at a depth of 0 or below nothing is touched.
            specimen: the compliant body, whose face the probe is; None for a rigid probe.
            history: the tangential path, and what was before.
        """

    def known_depth_m(
        self, probe: Probe, specimen: Specimen | None = None, *, lateral: bool = False
    ) -> float:
        """The deepest press that is known, with a lateral load or without; 0 for none [m]."""

    def render(self, contact: Contact, rng: np.random.Generator, seating: Seating = SEATED) -> Frame:
        """The camera's frame of a contact; `rng` is the only source of chance."""

    def rectify(self, frame: Frame) -> Frame:
        """A frame cut and scaled to `rectified_px`, without the distortion of a lens that has one.

        `palpate.check` alone calls it so far. An estimator is given whole frames, and cuts and scales them by
        its calibration's own `recordings.preparation.Preparation`.
        """

    def default_plan(self) -> Mapping[str, Any]:
        """The fields of a plan that records it by its own protocol, as in a plan's file."""


def force_law(sensor: Sensor, probe: Probe, specimen: Specimen | None = None) -> ForceLaw:
    """The force law of a sensor: its own `force_law(probe, specimen)`, or one laid through some presses.

    Between presses the force's two-thirds power is straight, which a ball's nearly is; its shear follows from
    its slope as it does under a ball on an incompressible skin.
    """
    own = getattr(sensor, "force_law", None)
    if own is not None:
        law: ForceLaw = own(probe, specimen)
        return law
    pressed_m = np.linspace(0.0, sensor.known_depth_m(probe, specimen), PRESSES)
    contacts = [sensor.press(probe, Pose(0.0, 0.0, float(d)), specimen) for d in pressed_m]
    depth = np.linspace(0.0, pressed_m[-1], KNOTS)
    root = np.array([max(contact.force_n, 0.0) ** (2 / 3) for contact in contacts])
    force = np.interp(depth, pressed_m, root) ** 1.5
    radius = np.interp(depth, pressed_m, [contact.radius_m for contact in contacts])
    return ForceLaw(depth, force, radius, MINDLIN * np.gradient(force, depth))


def variation_of(sensor: Sensor) -> Mapping[str, Any]:
    """Variation of a sensor's presses in the virtual rig's words: its own `variation()`, or nothing."""
    return (getattr(sensor, "variation", None) or dict)()


def plans_of(sensor: Sensor) -> Mapping[str, Mapping[str, Any]]:
    """Plans beside its default one, by its own `plans()`: name, begun as the sensor's -> a file's fields."""
    return (getattr(sensor, "plans", None) or dict)()


def own_plans_of(sensor: Sensor) -> Mapping[str, Mapping[str, Any]]:
    """All plans of a sensor, the default one first: name -> a file's fields."""
    default = sensor.default_plan()
    return {str(default.get("name", "plan")): default, **plans_of(sensor)}


def for_rig(sensor: Sensor) -> Sensor:
    """The same sensor at the size that a virtual rig films: its own `for_rig()`, or itself."""
    return (getattr(sensor, "for_rig", None) or (lambda: sensor))()


def for_live(sensor: Sensor) -> Sensor:
    """The same sensor, drawn as quickly as its camera films: its own `for_live()`, or as on a rig."""
    return (getattr(sensor, "for_live", None) or (lambda: for_rig(sensor)))()


def draw_ahead(sensor: Sensor, highest_m: float, deepest_m: float) -> None:
    """Let it draw, and keep, what its live frames are made of, by its own `draw_ahead()`, if it has one.

    Args:
        sensor: as `for_live` gives it.
        highest_m: of the probe over the skin [m].
        deepest_m: of the probe in the skin [m].
    """
    (getattr(sensor, "draw_ahead", None) or (lambda highest_m, deepest_m: None))(highest_m, deepest_m)


def dark_field_of(sensor: Sensor) -> Box | None:
    """Part of the frame that stays dark until the skin is stressed, by its own `dark_field()`; None for none.

    Of skins between crossed polarisers. What hangs before the skin is seen beside it, and never in it.
    """
    found: Box | None = (getattr(sensor, "dark_field", None) or (lambda: None))()
    return found


def untouched(sensor: Sensor) -> Contact:
    """The skin at rest, with no probe in sight."""
    return sensor.press(sensor.probe(sensor.default_probe), Pose(0.0, 0.0, 0.0))


def is_rigid(specimen: Specimen | None) -> bool:
    """True where the body that is pressed does not yield."""
    return specimen is None or (specimen.stiffness_n_m == math.inf and specimen.youngs_modulus_pa is None)


_MEMBERS = {name: member for name, member in vars(Sensor).items() if not name.startswith("_")}
METHODS = tuple(name for name, member in _MEMBERS.items() if callable(member))
VALUES = tuple(name for name in _MEMBERS if name not in METHODS)


def contract_faults(design: Any) -> list[str]:
    """The laws of the contract that can be told without pressing, of those that an object breaks."""
    missing = [name for name in (*VALUES, *METHODS) if not hasattr(design, name)]
    missing += [name for name in METHODS if hasattr(design, name) and not callable(getattr(design, name))]
    if missing:
        return [f"a sensor has {', '.join(missing)}"]
    return list(_faults(design))


def _faults(design: Sensor) -> Iterator[str]:
    if not (isinstance(design.name, str) and design.name):
        yield f"its name is a word, not {design.name!r}"
    params = getattr(design.spec, "__dataclass_params__", None)
    if not (is_dataclass(design.spec) and params is not None and params.frozen):
        yield "its spec is a frozen dataclass"
    for what in ("frame_px", "rectified_px"):
        size = getattr(design, what)
        whole = isinstance(size, tuple) and len(size) == 2 and all(isinstance(n, int) and n > 0 for n in size)
        if not whole:
            yield f"{what} is (width, height), two whole numbers of pixels above 0, not {size!r}"
            return
    for what, unit in (("rate_hz", "Hz"), ("exposure_s", "s")):
        value = getattr(design, what)
        if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
            yield f"{what} is a number above 0 {unit}, not {value!r}"
    if design.moves not in ("probe", "sensor"):
        yield f'moves is "probe" or "sensor", not {design.moves!r}'
    if not isinstance(design.outline, Outline):
        yield "its outline is an Outline"
    if not isinstance(design.default_plan(), Mapping):
        yield "default_plan() is a mapping of a plan's fields"
    yield from _region_faults(design)


def _region_faults(design: Sensor) -> Iterator[str]:
    (width, height), regions = design.frame_px, design.regions()
    for name, (x, y, w, h) in regions.items():
        if min(x, y) < 0 or min(w, h) < 1 or x + w > width or y + h > height:
            yield f"its regions lie in its frame of {width} x {height} px; {name} {(x, y, w, h)} does not"
    if not (isinstance(design.axes, ImageAxes) and design.axes.region in regions):
        yield f"its axes are ImageAxes of one of its regions, {', '.join(regions) or 'of which it has none'}"


def frame_faults(design: Sensor) -> list[str]:
    """The laws that a skin at rest and its frame break; cheap enough for every start."""
    rest = untouched(design)
    frame = design.render(rest, np.random.default_rng(0))
    faults = []
    if not isinstance(rest, Contact):
        return [f"press() returns a Contact, not a {type(rest).__name__}"]
    if rest.force_n != 0 or rest.touching.any():
        faults.append(f"an untouched skin carries no force, not {rest.force_n:g} N")
    if not isinstance(frame, Frame):
        return [*faults, f"render() returns a Frame, not a {type(frame).__name__}"]
    height, width = frame.image.shape[:2]
    if (width, height) != design.frame_px:
        faults.append(
            "a frame has its stated size, "
            f"{design.frame_px[0]} x {design.frame_px[1]} px, not {width} x {height}"
        )
    return faults


DEFAULT_SENSOR = "palm"
"""The sensor of rigs and plans that name none: until there was a second, all were of it."""

SENSORS = PluginRegistry(
    "sensor",
    "palpate.sensors",
    {
        "palm": "palpate.sensors.palm.palm_sensor:palm",
        "tactip": "palpate.sensors.tactip.tactip_sensor:tactip",
        "nusense": "palpate.sensors.nusense.nusense_sensor:nusense",
    },
    contract_faults,
)

MODELS_OF_SENSORS = {"palm": "palpate.sensors.palm.networks:MODELS"}
"""Models that a built-in sensor brings along, by the sensor's name, with which theirs begin."""


def sensor(name: str = DEFAULT_SENSOR) -> Sensor:
    """A sensor by name: a built-in one or another package's, with a preset after it as in "palm-small"."""
    design: Sensor = SENSORS.make(name)
    return design
