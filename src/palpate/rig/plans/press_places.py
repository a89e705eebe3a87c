"""Places to press: the candidate grid clipped by the skin's outline and the probe, or random places.

Outline and probe are the sensor's where a plan does not give them: `laid_on` writes them into the places.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_serializer

from palpate.core import DEFAULT_SENSOR, InputError, Outline, Sensor
from palpate.core.sensor import sensor as sensor_of

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
StepMm = Annotated[float, Field(ge=0.001, allow_inf_nan=False)]
"""A step of the stage [mm]: a micrometre at least, below which no stage moves."""
ROUNDING_MM = 1e-9
WAYS = {"+x": (1, 0), "-x": (-1, 0), "+y": (0, 1), "-y": (0, -1)}
MAX_TRIES = 1000  # for each random place


class Place(NamedTuple):
    """Place on the skin.

    Attributes:
        name: unique in its plan, such as "r3c7".
        x_mm, y_mm: from the layer's centre, x right, y towards the viewer.
    """

    name: str
    x_mm: float
    y_mm: float


Laid = TypeVar("Laid", bound="OnSkin")


class OnSkin(BaseModel):
    """Places on a skin.

    Attributes:
        layer_mm: diameter of the skin, or of the circle around a polygon's corners; None for the sensor's.
        probe_mm: diameter of the probe; None for that of the sensor's own.
        corners_mm: (x, y) of a convex polygon, from +x towards +y; empty for a disc of `layer_mm`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    layer_mm: Positive | None = None
    probe_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    corners_mm: tuple[tuple[float, float], ...] = ()

    @model_serializer(mode="wrap")
    def _without_corners(self, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """A disc's plan is written, and hashed, as it was before there were other outlines."""
        fields = handler(self)
        if not self.corners_mm:
            fields.pop("corners_mm", None)
        return fields

    def laid_on(self: Laid, sensor: Sensor) -> Laid:
        """The same places with the sensor's outline and probe, where they give none of their own."""
        fields: dict[str, Any] = {}
        if self.layer_mm is None:
            outline = sensor.outline
            fields["layer_mm"] = _mm(2 * outline.radius_m)
            fields["corners_mm"] = tuple((_mm(x), _mm(y)) for x, y in outline.corners_m)
        if self.probe_mm is None:
            fields["probe_mm"] = _mm(2 * sensor.probe(sensor.default_probe).radius_m)
        return self.model_copy(update=fields)

    def sizes_mm(self) -> tuple[float, float]:
        """Diameters of skin and probe, the usual sensor's where none are given."""
        layer, probe = self.layer_mm, self.probe_mm
        if layer is None or probe is None:
            usual = _usual()
            layer, probe = usual[0] if layer is None else layer, usual[1] if probe is None else probe
        return layer, probe

    @property
    def outline(self) -> Outline:
        """The skin's outline."""
        if self.corners_mm:
            return Outline.polygon(tuple((1e-3 * x, 1e-3 * y) for x, y in self.corners_mm))
        return Outline.disc(1e-3 * self.sizes_mm()[0])

    @property
    def reach_mm(self) -> float:
        """Greatest distance of the probe's axis from the skin's centre."""
        return reach_mm(*self.sizes_mm())

    def holds(self, x_mm: float, y_mm: float) -> bool:
        """Whether the probe lies wholly on the skin."""
        if not self.corners_mm:
            return math.hypot(x_mm, y_mm) <= self.reach_mm + ROUNDING_MM
        return self.outline.contains(1e-3 * x_mm, 1e-3 * y_mm, 0.5e-3 * self.sizes_mm()[1])


class Grid(OnSkin):
    """Square candidates, of which those stay whose probe lies wholly on the skin.

    Attributes:
        per_side: candidates along each side; odd, so that one is the centre.
        pitch_mm: between neighbours.
    """

    kind: Literal["grid"] = "grid"
    per_side: Annotated[int, Field(ge=1, le=999)] = 15
    pitch_mm: Positive = 7.0

    def places(self) -> tuple[Place, ...]:
        """Row by row, from the top left, as the camera sees it."""
        reach = self.reach_mm
        middle = (self.per_side - 1) / 2
        places = [
            Place(f"r{row}c{column}", (column - middle) * self.pitch_mm, (row - middle) * self.pitch_mm)
            for row in range(self.per_side)
            for column in range(self.per_side)
            if self.holds((column - middle) * self.pitch_mm, (row - middle) * self.pitch_mm)
        ]
        if not places:
            raise InputError(
                f"no place of the grid, {self.pitch_mm:g} mm apart, lies within {reach:g} mm of the centre; "
                "use an odd number of places a side, or a smaller pitch",
                code="no-positions",
            )
        return tuple(places)


class Scattered(OnSkin):
    """Random places off the grid, evenly over the area, the same for the same seed.

    Attributes:
        count: how many.
        apart_mm: least distance between two.
        seed: of the places.
    """

    kind: Literal["scattered"]
    count: Annotated[int, Field(ge=1, le=100_000)]
    apart_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    seed: int = 0

    def places(self) -> tuple[Place, ...]:
        """Places in the order they were drawn."""
        reach, rng = self.reach_mm, np.random.default_rng(self.seed)
        places: list[Place] = []
        for _ in range(MAX_TRIES * self.count):
            if len(places) == self.count:
                break
            away, angle = reach * math.sqrt(rng.uniform()), rng.uniform(0, math.tau)
            # To a micrometre, so that the name, the label and the stage agree.
            x, y = round(away * math.cos(angle), 3), round(away * math.sin(angle), 3)
            if self.corners_mm and not self.holds(x, y):
                continue
            if all(math.hypot(x - p.x_mm, y - p.y_mm) >= self.apart_mm for p in places):
                places.append(Place(f"s{len(places)}", x, y))
        if len(places) < self.count:
            raise InputError(
                f"{self.count} places {self.apart_mm:g} mm apart do not fit within {reach:g} mm of the "
                f"centre; {len(places)} were found",
                code="too-many-positions",
            )
        return tuple(places)


class Listed(OnSkin):
    """Places by hand.

    Attributes:
        at_mm: (x, y) of each.
    """

    kind: Literal["listed"]
    at_mm: Annotated[tuple[tuple[float, float], ...], Field(min_length=1)]

    def places(self) -> tuple[Place, ...]:
        """Places in the order of the plan."""
        reach = self.reach_mm
        for x, y in self.at_mm:
            if not self.holds(x, y):
                raise InputError(
                    f"at ({x:g}, {y:g}) mm the probe reaches over the layer's rim; within {reach:g} mm of "
                    "the centre it does not",
                    code="position-outside",
                )
        return tuple(Place(f"l{i}", x, y) for i, (x, y) in enumerate(self.at_mm))


class Around(OnSkin):
    """The middle, four places about it, and four just beyond the rim: from where a layer lies can be told.

    The skin is a disc and the probe a ball.

    Attributes:
        inside_mm: of the four about the middle, from it.
        beyond_mm: of the four outside, from the rim as it is expected; a little less than the ball's radius,
            and more than the layer may lie askew.
    """

    kind: Literal["around"]
    inside_mm: Positive = 15.0
    beyond_mm: Positive = 2.0

    def places(self) -> tuple[Place, ...]:
        """The middle, then inside and outside along +x, -x, +y, -y."""
        if self.corners_mm:
            raise InputError("layer plans need a round skin; this is a polygon", code="not-round")
        (layer_mm, probe_mm), reach = self.sizes_mm(), self.reach_mm
        if self.inside_mm > reach + ROUNDING_MM:
            raise InputError(
                f"inside_mm is {self.inside_mm:g}; the probe reaches over the rim from {reach:g}",
                code="position-outside",
            )
        if self.beyond_mm >= probe_mm / 2:
            raise InputError(
                f"beyond_mm is {self.beyond_mm:g}: a ball of {probe_mm:g} mm passes the rim without "
                f"touching it; give less than {probe_mm / 2:g}",
                code="rim-not-touched",
            )
        outside = layer_mm / 2 + self.beyond_mm
        return (
            Place("middle", 0.0, 0.0),
            *(
                Place(f"inside{name}", x * self.inside_mm, y * self.inside_mm)
                for name, (x, y) in WAYS.items()
            ),
            *(Place(f"rim{name}", x * outside, y * outside) for name, (x, y) in WAYS.items()),
        )


Places = Annotated[Grid | Scattered | Listed | Around, Field(discriminator="kind")]


def reach_mm(layer_mm: float, probe_mm: float) -> float:
    """Greatest distance of the probe's axis from the layer's centre."""
    if probe_mm > layer_mm:
        raise InputError(f"the probe, {probe_mm:g} mm, is wider than {layer_mm:g} mm", code="probe-too-wide")
    return (layer_mm - probe_mm) / 2


def _mm(metres: float) -> float:
    """Length in millimetres, to a picometre, so that 57 mm are 57.0."""
    return round(1e3 * float(metres), 9)


@lru_cache(maxsize=1)
def _usual() -> tuple[float, float]:
    """Diameters of the usual sensor's skin and probe [mm]."""
    usual = sensor_of(DEFAULT_SENSOR)
    return _mm(2 * usual.outline.radius_m), _mm(2 * usual.probe(usual.default_probe).radius_m)
