"""Recording plan: presses in an order, each a few keyed shots and the steps that record them."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from palpate.core import InputError, Sensor, Specimen
from palpate.core.sensor import sensor as sensor_of
from palpate.rig.plans.press_places import Grid, Place, Places, Positive, StepMm


class Shot(NamedTuple):
    """Keyed group of frames, by which a resumed recording finds what is missing.

    Attributes:
        place: its name.
        cycle: which press at this place, from 1.
        phase: such as "reference", "down", "up", "hold", "lateral" or "sweep".
        depth_um: below the local zero, as commanded [um]: whole, so that keys compare.
        turn: which step of the phase at this depth, from 0.
    """

    place: str
    cycle: int
    phase: str
    depth_um: int
    turn: int = 0

    @property
    def key(self) -> str:
        """Name of the shot, unique in its plan."""
        return f"{self.place}/{self.cycle}/{self.phase}/{self.depth_um}/{self.turn}"


@dataclass(frozen=True, slots=True)
class Over:
    """Travel over a place, lifted to the clearance."""

    x_m: float
    y_m: float


@dataclass(frozen=True, slots=True)
class TareStep:
    """Measure the force sensor's zero, in the air."""


@dataclass(frozen=True, slots=True)
class Seek:
    """Step down until the normal force passes the threshold: the local zero."""


@dataclass(frozen=True, slots=True)
class Depth:
    """Go to a depth below the local zero, guarded where it leads into the skin."""

    depth_m: float
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Aside:
    """Shift by so much from the place's own x and y, at the depth there is."""

    x_m: float
    y_m: float
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class Pause:
    """Wait of so many seconds."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Burst:
    """Record frames of one shot; those in `missing` alone.

    Attributes:
        missing: which of its frames, counted from 0.
        every_s: between frames; 0 for as fast as the camera gives them.
    """

    shot: Shot
    missing: tuple[int, ...]
    every_s: float = 0.0
    labels: dict[str, float | str | bool] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Sweep:
    """Move down at one speed to a force or a depth, recording all the while; then back up alike.

    Attributes:
        until_n: force at which it turns round; None for at the depth alone.
        depth_m: at which it turns round at the latest, below where it started.
    """

    shot: Shot
    speed_m_s: float
    depth_m: float
    until_n: float | None = None
    labels: dict[str, float | str | bool] = field(default_factory=dict)


Step = Over | TareStep | Seek | Depth | Aside | Pause | Burst | Sweep
Steps = Iterator[Step]
Done = dict[str, frozenset[int]]
"""Shot's key -> which of its frames are recorded."""


MM = 1e-3
Count = Annotated[int, Field(ge=1, le=1_000_000)]
ROUND_ONE = re.compile(r"(?:sphere|punch|flat):(\d+(?:\.\d+)?)")
LESS = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class PlannedPress(NamedTuple):
    """Approach of one place."""

    place: Place
    cycle: int
    indenter: str


def _check_width(indenters: tuple[str, ...], probe_mm: float) -> None:
    for indenter in indenters:
        wide = ROUND_ONE.fullmatch(indenter)
        if wide and float(wide[1]) > probe_mm:
            raise InputError(
                f"the indenter {indenter} is wider than the probe of {probe_mm:g} mm that places are clipped "
                "for; give places.probe_mm as wide as the widest",
                code="probe-too-wide",
            )


def _check_stiffness(indenters: tuple[str, ...]) -> None:
    """Refuse one name for two specimens, whose presses could not be told apart."""
    first: dict[str, tuple[str, float | None]] = {}
    for indenter in indenters:
        try:
            specimen = Specimen.parse(indenter.partition("@")[0])
        except InputError:
            continue  # a rigid probe; the sensor says later whether it knows it
        words, stiffness_n_m = first.setdefault(specimen.name, (indenter, specimen.stiffness_n_m))
        if stiffness_n_m != specimen.stiffness_n_m:
            raise InputError(
                f"the indenters {words} and {indenter} give the specimen {specimen.name} two stiffnesses; "
                "give each specimen a name of its own"
            )


AnyPlan = TypeVar("AnyPlan", bound="RecordingPlan")


class RecordingPlan(BaseModel):
    """Places, cycles, and how contact is found; what is done there is its kind's.

    Attributes:
        name: goes into the run.
        places: where.
        cycles: presses at each place.
        order: "cycles" presses a place so many times before it goes on; "rounds" goes round all places before
            the next cycle; "shuffled" is seeded by `seed`.
        seed: of a shuffled order.
        indenters: all of the plan is done with each of them in turn.
        threshold_N: normal force that says contact; it sets the local zero.
        seek_step_mm: of the search for contact.
        seek_mm: how far below the expected surface contact is searched for.
        clearance_mm: above the expected surface, between presses.
        travel_mm_s, seek_mm_s, press_mm_s: speeds in the air, of the search, and into the skin.
        reference_frames: of the untouched skin, before each press.
        taps: before the first press, and whenever a recording goes on, to set the frames' clock against the
            force's; 0 for none.
        tap_N: how hard.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(min_length=1, max_length=100)] = "plan"
    places: Places = Field(default_factory=Grid)
    cycles: Count = 5
    order: Literal["cycles", "rounds", "shuffled"] = "cycles"
    seed: int = 0
    indenters: Annotated[tuple[str, ...], Field(min_length=1)] = ("sphere:10",)
    threshold_N: Positive = 0.05  # noqa: N815 - the unit is part of the name
    seek_step_mm: StepMm = 0.02
    seek_mm: Positive = 2.0
    clearance_mm: Positive = 1.0
    travel_mm_s: Positive = 20.0
    seek_mm_s: Positive = 2.0
    press_mm_s: Positive = 2.0
    reference_frames: Annotated[int, Field(ge=0, le=100_000)] = 25
    taps: Annotated[int, Field(ge=0, le=100)] = 4
    tap_N: Positive = 0.5  # noqa: N815

    @model_validator(mode="after")
    def _check_indenters(self) -> RecordingPlan:
        _check_stiffness(self.indenters)
        if self.places.probe_mm is not None:
            _check_width(self.indenters, self.places.probe_mm)
        return self

    def on(self: AnyPlan, sensor: Sensor) -> AnyPlan:
        """The same plan for a sensor: its outline and its probe where the plan gives none."""
        fields: dict[str, Any] = {"places": self.places.laid_on(sensor)}
        if "indenters" not in self.model_fields_set:
            fields["indenters"] = (sensor.default_probe,)
        elif self.places.probe_mm is None:
            _check_width(self.indenters, fields["places"].probe_mm)
        return self.model_copy(update=fields)

    @property
    def hash(self) -> str:
        """SHA-256 of all that decides what is recorded; on the usual sensor where it is laid on none yet."""
        bare = self.places.layer_mm is None or self.places.probe_mm is None
        plan = self.on(sensor_of()) if bare else self
        text = json.dumps(plan.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def deepest_mm(self) -> float:
        """The greatest depth below a local zero."""
        raise NotImplementedError

    @property
    def pressed_mm(self) -> float:
        """The depth that it goes to whatever the force: 0 where a force turns it round."""
        return self.deepest_mm

    def presses(self) -> Iterator[PlannedPress]:
        """Presses of the plan, in order."""
        places = self.places.places()
        for indenter in self.indenters:
            presses = [
                PlannedPress(place, cycle, indenter)
                for place in places
                for cycle in range(1, self.cycles + 1)
            ]
            if self.order == "rounds":
                presses.sort(key=lambda press: press.cycle)
            if self.order == "shuffled":
                np.random.default_rng(self.seed).shuffle(presses)
            yield from presses

    def shots(self, press: PlannedPress) -> tuple[tuple[Shot, int], ...]:
        """The shots of a press, each with how many frames it has, in order."""
        reference = Shot(self._named(press), press.cycle, "reference", 0)
        own = self._shots(press)
        return ((reference, self.reference_frames), *own) if self.reference_frames else own

    def steps(self, press: PlannedPress, done: Done) -> Steps:
        """Steps that record the missing frames of a press; none where none is missing.

        Over the place, the zero, the frames of the untouched skin, and then what is the kind's own.
        """
        left = self.missing(press, done)
        if not left:
            return
        yield Over(press.place.x_mm * MM, press.place.y_mm * MM)
        yield TareStep()
        for shot in [one for one in left if one.phase == "reference"]:
            yield Burst(shot, left.pop(shot))
        if left:
            yield from self._own_steps(left)

    def missing(self, press: PlannedPress, done: Done) -> dict[Shot, tuple[int, ...]]:
        """The frames that are not recorded yet, by shot."""
        return {
            shot: left
            for shot, frames in self.shots(press)
            if (left := tuple(sorted(set(range(frames)) - done.get(shot.key, frozenset()))))
        }

    def _own_steps(self, left: dict[Shot, tuple[int, ...]]) -> Steps:
        """The steps of this kind of plan, with at least one of its shots left."""
        raise NotImplementedError

    def _shots(self, press: PlannedPress) -> tuple[tuple[Shot, int], ...]:
        raise NotImplementedError

    def _named(self, press: PlannedPress) -> str:
        return press.place.name if len(self.indenters) == 1 else f"{press.place.name}@{press.indenter}"
