"""Plans by name or from a TOML file, and what one asks for in all."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field, TypeAdapter, ValidationError

from palpate.core import InputError, Sensor, storage_errors
from palpate.core.sensor import DEFAULT_SENSOR, SENSORS
from palpate.core.sensor import sensor as sensor_of
from palpate.rig.plans.plan_kinds import Dwell, Lateral, Ramp, StepHold, SurfaceProbe
from palpate.rig.plans.press_places import Around, Grid, Listed, Scattered
from palpate.rig.plans.recording_plan import RecordingPlan

Known = StepHold | Ramp | SurfaceProbe
AnyPlan = Annotated[Known, Field(discriminator="kind")]
_ADAPTER: TypeAdapter[Known] = TypeAdapter(AnyPlan)
_MAX_BYTES = 1 << 20

_CENTRE = Listed(kind="listed", at_mm=((0.0, 0.0),))
_ROUND = ((0.3, 0.0), (0.0, 0.3), (-0.3, 0.0), (0.0, -0.3))
_SMALL = {"cycles": 1, "frames": 5, "reference_frames": 5}
_PLANS: tuple[Known, ...] = (
    SurfaceProbe(name="layer", kind="touched", places=Around(kind="around"), taps=0),
    StepHold(name="palm-reduced", cycles=1, depth_mm=4.0, step_mm=1.0, frames=2, reference_frames=1),
    StepHold(
        name="palm-validation",
        places=Scattered(kind="scattered", count=20, apart_mm=3.0, seed=1),
        step_mm=0.5,
        **_SMALL,
    ),
    StepHold(
        name="palm-lateral",
        places=Grid(pitch_mm=12.0),
        depth_mm=1.5,
        step_mm=0.5,
        lateral=Lateral(depths_mm=(1.0,), to_mm=_ROUND),
        **_SMALL,
    ),
    StepHold(
        name="palm-creep",
        places=_CENTRE,
        depth_mm=4.0,
        step_mm=1.0,
        unloading=True,
        dwell=Dwell(depths_mm=(4.0,), seconds=60.0, frames=60),
        **_SMALL,
    ),
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
    """Plans by name, laid on the usual sensor; the default plan of a sensor has the sensor's name."""

    def __getitem__(self, name: str) -> Known:
        if name in _OWN:
            return _OWN[name].on(sensor_of())
        if name not in SENSORS.names():
            raise KeyError(name)
        return plan_of_sensor(name)

    def __iter__(self) -> Iterator[str]:
        return iter((DEFAULT_SENSOR, *_OWN, *(name for name in SENSORS.names() if name != DEFAULT_SENSOR)))

    def __len__(self) -> int:
        return len(tuple(iter(self)))


PLANS: Mapping[str, Known] = _Plans()
"""The palm's protocol first; one that finds where a layer lies, small ones, one of each kind; then the
protocols of the other sensors. "tactip-press" and the two after it are those of the TacTip's and NUSense's
reports, on the usual skin."""


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


def plan_of_sensor(name: str) -> Known:
    """The default plan of a sensor.

    Raises:
        InputError: there is no such sensor, or its plan is none.
    """
    sensor = sensor_of(name)
    return plan_from(sensor.default_plan(), sensor)


def plan_of(text: str | Path, sensor: Sensor | None = None) -> Known:
    """A plan by its name, or from a TOML file.

    Args:
        text: a name of `PLANS`, or a file's path.
        sensor: whose outline and probe it is laid on where it gives none; None for the usual one.

    Raises:
        InputError: neither; or a field that is not one, or out of range: the message lists them.
        StorageError: the file cannot be read.
    """
    if str(text) in _OWN:
        return _OWN[str(text)].on(sensor or sensor_of())
    if str(text) in PLANS:
        return PLANS[str(text)]
    path = Path(text)
    if not path.exists():
        raise InputError(f"{text} is no file, and none of the plans {', '.join(PLANS)}")
    with storage_errors(path):
        data = path.read_bytes()[:_MAX_BYTES]
    try:
        return plan_from(tomllib.loads(data.decode()), sensor)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as e:
        raise InputError(f"{path} is not TOML: {e}") from e
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
        raise InputError(problems) from e
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
