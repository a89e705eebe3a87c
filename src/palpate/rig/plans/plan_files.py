"""Plans by name or from a TOML file, and what one asks for in all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field, TypeAdapter, ValidationError

from palpate.core import DEFAULT_SENSOR, SENSORS, InputError, Sensor
from palpate.core.parsing import parser
from palpate.core.plugins import PATH
from palpate.core.sensor import own_plans_of, plans_of, sensor as sensor_of
from palpate.devices.file_fields import read_toml
from palpate.rig.plans.plan_kinds import Ramp, StepHold, SurfaceSearch
from palpate.rig.plans.press_places import Around, Listed
from palpate.rig.plans.recording_plan import RecordingPlan

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
