"""Where to press: the candidate grid clipped by membrane and probe, or seeded random places."""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from palpate.core.errors import InputError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
ROUNDING_MM = 1e-9
WAYS = {"+x": (1, 0), "-x": (-1, 0), "+y": (0, 1), "-y": (0, -1)}
MOST_TRIES = 1000  # for each random place


class Place(NamedTuple):
    """One place on the skin.

    Attributes:
        name: unique in its plan, such as "r3c7".
        x_mm, y_mm: from the layer's centre, x right, y towards the viewer.
    """

    name: str
    x_mm: float
    y_mm: float


class Grid(BaseModel):
    """Square candidates, of which those stay whose probe lies wholly on the layer.

    Attributes:
        per_side: candidates along each side; odd, so that one is the centre.
        pitch_mm: between neighbours.
        layer_mm, probe_mm: diameters.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["grid"] = "grid"
    per_side: Annotated[int, Field(ge=1, le=999)] = 15
    pitch_mm: Positive = 7.0
    layer_mm: Positive = 57.0
    probe_mm: Positive = 10.0

    def places(self) -> tuple[Place, ...]:
        """Row by row, from the top left, as the camera sees it.

        Raises:
            InputError: none is left.
        """
        reach = reach_mm(self.layer_mm, self.probe_mm)
        middle = (self.per_side - 1) / 2
        found = [
            Place(f"r{row}c{column}", (column - middle) * self.pitch_mm, (row - middle) * self.pitch_mm)
            for row in range(self.per_side)
            for column in range(self.per_side)
            if math.hypot(column - middle, row - middle) * self.pitch_mm <= reach + ROUNDING_MM
        ]
        if not found:
            raise InputError(
                f"no place of the grid, {self.pitch_mm:g} mm apart, lies within {reach:g} mm of the centre; "
                "use an odd number of places a side, or a smaller pitch"
            )
        return tuple(found)


class Scattered(BaseModel):
    """Random places off the grid, evenly over the area, the same for the same seed.

    Attributes:
        count: how many.
        layer_mm, probe_mm: diameters.
        apart_mm: least distance between two.
        seed: of the places.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["scattered"]
    count: Annotated[int, Field(ge=1, le=100_000)]
    layer_mm: Positive = 57.0
    probe_mm: Positive = 10.0
    apart_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    seed: int = 0

    def places(self) -> tuple[Place, ...]:
        """In the order they were drawn.

        Raises:
            InputError: they cannot lie so far apart.
        """
        reach, rng = reach_mm(self.layer_mm, self.probe_mm), np.random.default_rng(self.seed)
        found: list[Place] = []
        for _ in range(MOST_TRIES * self.count):
            if len(found) == self.count:
                break
            away, angle = reach * math.sqrt(rng.uniform()), rng.uniform(0, math.tau)
            # To a micrometre, so that the name, the label and the stage agree.
            x, y = round(away * math.cos(angle), 3), round(away * math.sin(angle), 3)
            if all(math.hypot(x - p.x_mm, y - p.y_mm) >= self.apart_mm for p in found):
                found.append(Place(f"s{len(found)}", x, y))
        if len(found) < self.count:
            raise InputError(
                f"{self.count} places {self.apart_mm:g} mm apart do not fit within {reach:g} mm of the "
                f"centre; {len(found)} were found"
            )
        return tuple(found)


class Listed(BaseModel):
    """Places by hand.

    Attributes:
        at_mm: (x, y) of each.
        layer_mm, probe_mm: diameters.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["listed"]
    at_mm: Annotated[tuple[tuple[float, float], ...], Field(min_length=1)]
    layer_mm: Positive = 57.0
    probe_mm: Positive = 10.0

    def places(self) -> tuple[Place, ...]:
        """In the order given.

        Raises:
            InputError: one at which the probe reaches over the rim.
        """
        reach = reach_mm(self.layer_mm, self.probe_mm)
        for x, y in self.at_mm:
            if not math.hypot(x, y) <= reach + ROUNDING_MM:
                raise InputError(
                    f"at ({x:g}, {y:g}) mm the probe reaches over the layer's rim; within {reach:g} mm of "
                    "the centre it does not"
                )
        return tuple(Place(f"l{i}", x, y) for i, (x, y) in enumerate(self.at_mm))


class Around(BaseModel):
    """The middle, four places about it, and four just beyond the rim: from where a layer lies can be told.

    Attributes:
        layer_mm, probe_mm: diameters; the probe is a ball.
        inside_mm: of the four about the middle, from it.
        beyond_mm: of the four outside, from the rim as it is expected; a little less than the ball's radius,
            and more than the layer may lie askew.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["around"]
    layer_mm: Positive = 57.0
    probe_mm: Positive = 10.0
    inside_mm: Positive = 15.0
    beyond_mm: Positive = 2.0

    def places(self) -> tuple[Place, ...]:
        """The middle, then inside and outside along +x, -x, +y, -y.

        Raises:
            InputError: the probe reaches over the rim inside, or passes beside it outside.
        """
        reach = reach_mm(self.layer_mm, self.probe_mm)
        if self.inside_mm > reach + ROUNDING_MM:
            raise InputError(
                f"inside_mm is {self.inside_mm:g}; the probe reaches over the rim from {reach:g}"
            )
        if self.beyond_mm >= self.probe_mm / 2:
            raise InputError(
                f"beyond_mm is {self.beyond_mm:g}: a ball of {self.probe_mm:g} mm passes the rim without "
                f"touching it; give less than {self.probe_mm / 2:g}"
            )
        outside = self.layer_mm / 2 + self.beyond_mm
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
    """How far from the layer's centre the probe's axis may lie.

    Raises:
        InputError: the probe is wider than the layer.
    """
    if probe_mm > layer_mm:
        raise InputError(f"a probe of {probe_mm:g} mm is wider than the layer, {layer_mm:g} mm")
    return (layer_mm - probe_mm) / 2
