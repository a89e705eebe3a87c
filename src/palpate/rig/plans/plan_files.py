"""Plans by name or from a TOML file, and what one asks for in all.

Kinds of recording plan: stepped presses with holds, ramps at one speed, and surface probes.

A ramp's sweep is one shot: frames of one that was interrupted belong to no shot, and it is done again from
the air.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from palpate.core import DEFAULT_SENSOR, SENSORS, InputError, Sensor
from palpate.core.parsing import parser
from palpate.core.plugins import PATH
from palpate.core.sensor import own_plans_of, plans_of, sensor as sensor_of
from palpate.devices.device_plugins import read_toml
from palpate.rig.plans.press_places import Around, Listed, Positive, StepMm
from palpate.rig.plans.recording_plan import (
    LESS,
    MM,
    Aside,
    Burst,
    Count,
    Depth,
    Pause,
    PlannedPress,
    RecordingPlan,
    Seek,
    Shot,
    Steps,
    Sweep,
)

UM = 1000  # micrometres in a millimetre


class Lateral(BaseModel):
    """Controlled lateral load: at some depths the probe is shifted, in steps, in some directions.

    Attributes:
        depths_mm: of the press's own depths.
        to_mm: (x, y) shifts, each reached from the middle.
        steps: stands on the way to each.
        speed_mm_s: of the shift.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    depths_mm: Annotated[tuple[Positive, ...], Field(min_length=1)]
    to_mm: Annotated[tuple[tuple[float, float], ...], Field(min_length=1)]
    steps: Annotated[int, Field(ge=1, le=1000)] = 5
    speed_mm_s: Positive = 0.5

    def shifts_mm(self) -> tuple[tuple[float, float], ...]:
        """Lateral shifts at which it stands, in order."""
        return tuple(
            (x * i / self.steps, y * i / self.steps) for x, y in self.to_mm for i in range(1, self.steps + 1)
        )


class Dwell(BaseModel):
    """Stand long at some depths, to see the skin creep: frames spread over the time.

    Attributes:
        depths_mm: of the press's own depths.
        seconds: at each.
        frames: over that time.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    depths_mm: Annotated[tuple[Positive, ...], Field(min_length=1)]
    seconds: Positive
    frames: Annotated[int, Field(ge=2, le=1_000_000)] = 50


class StepHold(RecordingPlan):
    """Find contact, go down step by step, and record a burst at each depth.

    Attributes:
        depth_mm: of the deepest.
        step_mm: between depths.
        frames: at each depth.
        settle_s: between arriving and the first frame.
        unloading: record the way back up as well.
        lateral: shift the probe at some depths.
        dwell: stand long at some depths.
    """

    kind: Literal["stepped"] = "stepped"
    depth_mm: Positive = 5.0
    step_mm: StepMm = 0.1
    frames: Count = 25
    settle_s: LESS = 0.0
    unloading: bool = False
    lateral: Lateral | None = None
    dwell: Dwell | None = None

    @property
    def deepest_mm(self) -> float:
        """The greatest depth below a local zero."""
        return self.depth_mm

    def depths_um(self) -> tuple[int, ...]:
        """Depths from the first to the deepest, to the micrometre."""
        count = round(self.depth_mm / self.step_mm)
        return tuple(round(self.step_mm * i * UM) for i in range(1, max(1, count) + 1))

    def _own_steps(self, left: dict[Shot, tuple[int, ...]]) -> Steps:
        """Find contact, descend to the deepest shot that is missing, and record those that are."""
        yield Seek()
        up = any(shot.phase == "up" for shot in left)
        deepest = max(self.depths_um()) if up else max(shot.depth_um for shot in left)
        for depth in (d for d in self.depths_um() if d <= deepest):
            yield Depth(depth * 1e-6, self.press_mm_s * MM)
            yield from self._at(depth, False, left)
        for depth in (d for d in reversed(self.depths_um()[:-1]) if up):
            yield Depth(depth * 1e-6, self.press_mm_s * MM)
            yield from self._at(depth, True, left)

    def _at(self, depth_um: int, up: bool, left: dict[Shot, tuple[int, ...]]) -> Steps:
        here = {
            shot: frames
            for shot, frames in left.items()
            if shot.depth_um == depth_um and (shot.phase == "up") is up
        }
        if here and self.settle_s:
            yield Pause(self.settle_s)
        shifted = False
        for shot, frames in here.items():
            if shot.phase == "lateral" and self.lateral:
                x, y = self.lateral.shifts_mm()[shot.turn]
                if shot.turn % self.lateral.steps == 0 and shifted:
                    yield Aside(0.0, 0.0, self.lateral.speed_mm_s * MM)
                yield Aside(x * MM, y * MM, self.lateral.speed_mm_s * MM)
                shifted = True
            every = self.dwell.seconds / self.dwell.frames if shot.phase == "hold" and self.dwell else 0.0
            yield Burst(shot, frames, every)
        if shifted and self.lateral:
            yield Aside(0.0, 0.0, self.lateral.speed_mm_s * MM)

    def _shots(self, press: PlannedPress) -> tuple[tuple[Shot, int], ...]:
        place, depths = self._named(press), self.depths_um()
        shots: list[tuple[Shot, int]] = []
        for depth in depths:
            shots.append((Shot(place, press.cycle, "down", depth), self.frames))
            if self.dwell and depth in [round(d * UM) for d in self.dwell.depths_mm]:
                shots.append((Shot(place, press.cycle, "hold", depth), self.dwell.frames))
            if self.lateral and depth in [round(d * UM) for d in self.lateral.depths_mm]:
                turns = range(len(self.lateral.shifts_mm()))
                shots += [(Shot(place, press.cycle, "lateral", depth, i), self.frames) for i in turns]
        if self.unloading:
            shots += [(Shot(place, press.cycle, "up", depth), self.frames) for depth in reversed(depths[:-1])]
        return tuple(shots)


class Ramp(RecordingPlan):
    """Sweep from the clearance, one at each place and cycle.

    Attributes:
        speed_mm_s: down and up.
        until_N: force at which it turns round; None for at the depth alone.
        depth_mm: below the expected surface, at which it turns round at the latest.
        wait_s: after each sweep.
    """

    kind: Literal["swept"]
    speed_mm_s: Positive = 5.0
    until_N: Positive | None = None  # noqa: N815 - the unit is part of the name
    depth_mm: Positive = 5.0
    wait_s: LESS = 0.0
    reference_frames: int = 0

    @property
    def deepest_mm(self) -> float:
        """The greatest depth below the expected surface."""
        return self.depth_mm

    @property
    def pressed_mm(self) -> float:
        """None of it, where a force turns it round."""
        return self.depth_mm if self.until_N is None else 0.0

    def _own_steps(self, left: dict[Shot, tuple[int, ...]]) -> Steps:
        """The sweep, the wait."""
        for shot in left:
            yield Sweep(shot, self.speed_mm_s * MM, self.depth_mm * MM, self.until_N)
            yield Pause(self.wait_s)

    def _shots(self, press: PlannedPress) -> tuple[tuple[Shot, int], ...]:
        return ((Shot(self._named(press), press.cycle, "sweep", round(self.depth_mm * 1000)), 1),)


class SurfaceSearch(RecordingPlan):
    """Search for contact, one at each place and cycle, and a frame or more where it was found.

    Attributes:
        frames: at contact.
    """

    kind: Literal["touched"]
    cycles: Count = 1
    seek_mm: Positive = 3.0
    reference_frames: int = 0
    frames: Count = 1

    @property
    def deepest_mm(self) -> float:
        """Zero: it goes no deeper than contact."""
        return 0.0

    def _own_steps(self, left: dict[Shot, tuple[int, ...]]) -> Steps:
        """Contact, frames."""
        yield Seek()
        for shot, frames in left.items():
            yield Burst(shot, frames)

    def _shots(self, press: PlannedPress) -> tuple[tuple[Shot, int], ...]:
        return ((Shot(self._named(press), press.cycle, "touch", 0), self.frames),)


Known = StepHold | Ramp | SurfaceSearch
AnyPlan = Annotated[Known, Field(discriminator="kind")]
_ADAPTER: TypeAdapter[Known] = TypeAdapter(AnyPlan)

_CENTRE = Listed(kind="listed", at_mm=((0.0, 0.0),))
_PLANS: tuple[Known, ...] = (
    SurfaceSearch(name="layer", kind="touched", places=Around(kind="around"), taps=0),
    Ramp(
        name="tactip-press",
        kind="swept",
        places=_CENTRE,
        speed_mm_s=5.0,
        until_N=5.0,
        depth_mm=5.5,
        wait_s=5.0,
        threshold_N=0.5,
    ),
    Ramp(name="repeated", kind="swept", places=_CENTRE, cycles=70, speed_mm_s=5.0, depth_mm=2.0),
    Ramp(name="slow", kind="swept", places=_CENTRE, cycles=3, speed_mm_s=0.5, depth_mm=2.0),
)
_OWN = {plan.name: plan for plan in _PLANS}


class _Plans(Mapping[str, Known]):
    """Plans by name, laid on the usual sensor; a sensor's own plan has its sensor's name before its own."""

    def __getitem__(self, name: str) -> Known:
        if (plan := _named(name)) is None:
            raise KeyError(name)
        return plan

    def __iter__(self) -> Iterator[str]:
        first, *general = _OWN
        others = (name for name in SENSORS.names() if name != DEFAULT_SENSOR)
        return iter((DEFAULT_SENSOR, first, *plans_of(sensor_of()), *general, *others))

    def __len__(self) -> int:
        return len(tuple(iter(self)))


def _named(name: str, sensor: Sensor | None = None) -> Known | None:
    """The plan of a name, laid on a sensor unless it is a sensor's own protocol; None where there is none."""
    if name in _OWN:
        return _OWN[name].on(sensor or sensor_of())
    if name in SENSORS.names():
        return plan_of_sensor(name)
    owner = next((owner for owner in SENSORS.names() if name.startswith(f"{owner}-")), None)
    plans = {} if owner is None else plans_of(sensor_of(owner))
    if name not in plans and sensor is not None:
        plans = own_plans_of(sensor)  # of one that is registered under no name, or another
    return plan_from(plans[name], sensor) if name in plans else None


PLANS: Mapping[str, Known] = _Plans()
"""The usual sensor's protocol first; one that finds where a layer lies; the sensor's other plans, and general
ones; then the protocols of the other sensors. "tactip-press" and the two after it are those of the TacTip's
and NUSense's reports, on the usual skin."""


class Size(NamedTuple):
    """What a plan asks for.

    Attributes:
        points: places. presses: approaches. shots: without references. frames: of them.
        reference_frames: of the untouched skin. seconds: about so long.
    """

    points: int
    presses: int
    shots: int
    frames: int
    reference_frames: int
    seconds: float


def plan_of_sensor(sensor: Sensor | str | None = None) -> Known:
    """The default plan of a sensor, or of the sensor of a name; of the usual one where there is none.

    Raises:
        InputError: there is no such sensor, or its plan is none.
    """
    named = DEFAULT_SENSOR if sensor is None else sensor
    design = sensor_of(named) if isinstance(named, str) else named
    return plan_from(design.default_plan(), design)


@parser("recording plan", InputError)
def plan_of(text: str | Path, sensor: Sensor | None = None) -> Known:
    """A plan by its name, or from a TOML file.

    Args:
        text: a name of `PLANS` or of the sensor's own plans, a file's path, or ``module:Class`` of a sensor,
            whose default plan is meant.
        sensor: whose outline and probe it is laid on where it gives none; None for the usual one.

    Raises:
        InputError: neither; or a field that is not one, or out of range: the message lists them.
        StorageError: the file cannot be read.
    """
    if (plan := _named(str(text), sensor)) is not None:
        return plan
    path = Path(text)
    if not path.exists():
        if PATH.fullmatch(str(text)):
            return plan_of_sensor(str(text))
        raise InputError(f"{text} is no file, and none of the plans {', '.join(PLANS)}")
    fields = read_toml(path)
    try:
        return plan_from(fields, sensor)
    except InputError as e:
        raise InputError(f"{path}: {e}") from e


def plan_from(fields: Mapping[str, Any], sensor: Sensor | None = None) -> Known:
    """A plan from plain values, laid on a sensor; on the usual one without.

    Raises:
        InputError: a field that is not one, or out of range.
    """
    try:
        plan = _ADAPTER.validate_python({"kind": "stepped", **fields}).on(sensor or sensor_of())
        plan.places.places()
    except ValidationError as e:
        problems = "; ".join(f"{'.'.join(map(str, d['loc'][1:])) or 'plan'}: {d['msg']}" for d in e.errors())
        raise InputError(problems, code="plan-field") from e
    return plan


def size_of(plan: RecordingPlan, rate_hz: float = 30.0) -> Size:
    """Count a plan's shots and frames, and say about how long they take at a frame rate."""
    presses = list(plan.presses())
    shots = frames = references = 0
    seconds = 0.0
    for press in presses[: plan.cycles * len(plan.places.places())]:
        for shot, count in plan.shots(press):
            if shot.phase == "reference":
                references += count
            else:
                shots, frames = shots + 1, frames + count
    shots, frames, references = (n * len(plan.indenters) for n in (shots, frames, references))
    away_mm = 2 * (plan.clearance_mm + plan.deepest_mm)
    per_press = away_mm / plan.press_mm_s + plan.seek_mm / plan.seek_mm_s + 0.5
    seconds = (frames + references) / rate_hz + len(presses) * per_press
    return Size(len(plan.places.places()), len(presses), shots, frames, references, seconds)
