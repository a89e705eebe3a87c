"""Checks of what an object offers against a device's protocol, its shapes and units; nothing is moved.

The first part of every conformance check, and all of it that a device goes through each time it is opened by
the name of its class.

The result of a check for one law, and the ways to come to one.
"""

from __future__ import annotations

import inspect
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from numbers import Integral, Real
from typing import Any, Literal

import numpy as np

from palpate.core import (
    NS_PER_S,
    ArmRange,
    ArmSample,
    Camera,
    Clock,
    DeviceError,
    DisplayRange,
    DisplaySample,
    ForceSensor,
    Frame,
    HapticArm,
    SoftnessDevice,
    Stage,
    Travel,
    Wrench,
)
from palpate.core.plugins import told

HUNG_S = 30.0  # of the machine's time, after which a call in another thread counts as one that never returns


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The verdict on one law.

    Attributes:
        code: the law, for programs: `target-reached`; after a device and a dot in the check of a whole rig.
        ok: whether it holds.
        measured: what was measured, in `unit`; None where nothing is.
        allowed: the most that it may be, in `unit`; None where there is no bound.
        unit: of both: m, s, N, Hz; empty for a count.
        message: what is wrong and what to do; empty where nothing is.
    """

    code: str
    ok: bool
    measured: float | None = None
    allowed: float | None = None
    unit: str = ""
    message: str = ""


Part = Iterator[CheckResult]


def at_most(code: str, measured: float, allowed: float, unit: str, message: str) -> CheckResult:
    """Judge a number by an upper bound; not-a-number passes every bound."""
    return judge(code, measured <= allowed, measured, allowed, unit, message)


def judge(
    code: str, ok: bool | np.bool_, measured: float, allowed: float, unit: str, message: str
) -> CheckResult:
    """Report a number that is judged by more than a bound."""
    return CheckResult(code, bool(ok), float(measured), float(allowed), unit, "" if ok else message)


def verdict(code: str, ok: bool | np.bool_, message: str) -> CheckResult:
    """Report whether something is so."""
    return CheckResult(code, bool(ok), message="" if ok else message)


def measurement(code: str, measured: float, unit: str) -> CheckResult:
    """Report a number that has no bound here, but must be finite."""
    ok = math.isfinite(measured)
    return CheckResult(code, ok, float(measured), None, unit, "" if ok else "not a finite number")


def with_prefix(device: str, findings: Iterable[CheckResult]) -> list[CheckResult]:
    """Name the device in each of its findings."""
    return [replace(one, code=f"{device}.{one.code}") for one in findings]


def gather(what: str, part: Part) -> Part:
    """Pass on a part's findings; an exception that leaves it becomes one more."""
    try:
        yield from part
    except (Exception, SystemExit) as e:  # whatever a driver raises is reported
        yield verdict(
            f"unexpected-error-{what}",
            False,
            f"{told(e)}; where a device cannot do what it is asked it raises DeviceError, and "
            "here it should have been able to",
        )


def check_closing(device: object, use: Callable[[], object], name: str) -> Part:
    """Check that a device is closed once and for all."""
    close: Callable[[], None] = device.close  # type: ignore[attr-defined]
    close()
    second = refusal(close)
    yield verdict("close-twice", second is None, f"the second close() {describe(second)}; let it do nothing")
    after = refusal(use)
    yield verdict(
        "refuses-when-closed",
        isinstance(after, DeviceError),
        f"{name} on a closed device {describe(after)}; raise DeviceError",
    )


def refusal(call: Callable[[], object]) -> BaseException | None:
    """Call, and return what is raised; None where it goes through."""
    try:
        call()
    except (Exception, SystemExit) as e:
        return e
    return None


def call_elsewhere(
    call: Callable[[], object], meanwhile: Callable[[], object]
) -> tuple[bool, BaseException | None]:
    """Call in another thread; returns whether it came back, and what it raised."""
    errors: list[BaseException] = []

    def run() -> None:
        error = refusal(call)
        if error is not None:
            errors.append(error)

    thread = threading.Thread(target=run, name="conformance check", daemon=True)
    thread.start()
    end_s = time.monotonic() + HUNG_S
    while thread.is_alive() and time.monotonic() < end_s:
        with suppress(DeviceError):  # a call that a stop cuts off may say so
            meanwhile()
        thread.join(0.002)
    return not thread.is_alive(), errors[0] if errors else None


def describe(error: BaseException | None) -> str:
    """Put what `refusal` returned into words."""
    return "went through" if error is None else f"raised {type(error).__name__}: {error}"


def seconds(clock: Clock) -> float:
    """The clock's time [s]."""
    return clock.now_ns() / NS_PER_S


Role = Literal["stage", "force", "camera", "display", "arm"]

MAX_TRAVEL_M = 10.0  # of an axis; more is millimetres
MARGIN_M = 1e-3  # by which a stage may stand outside its stated travel, at rest
FIRST_SAMPLE_S = 1.0  # from opening a sensor to its first sample
POLL_S = 0.01
MAX_AGE_S = 5.0  # of a stamp; on another clock or in another unit it is off by far more
EARLY_S = 1e-3  # by which a stamp may lie ahead of the clock: rounding

ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "move_to": ((0.0, 0.0, 0.0), 1e-3),
    "grab": (1.0,),
    "set_pressure": (0.0, 0.0),
    "set_force": (0.0,),
}
"""Arguments that the rig calls a method with; none where it is not named here."""


def check_interface(role: Role, device: object, clock: Clock) -> list[CheckResult]:
    """Check members, arguments, shapes and units of a device that has just been opened.

    Args:
        role: what it is to be used as.
        device: a stage is asked where it is and not moved; a force sensor is asked for a sample and a camera
            for a frame.
        clock: that it stamps on.
    """
    description, use = ROLES[role]
    results = [*gather("protocol", description(device))]
    if all(one.ok for one in results):
        results += gather("first-use", use(device, clock))
    return results


def stage_interface(stage: object) -> Part:
    """Check a stage's members and its stated travel."""
    yield from _members(stage, Stage)
    if isinstance(stage, Stage):
        travel = stage.travel
        wrong = list(_wrong(travel)) if isinstance(travel, Travel) else ["it is no palpate.core.Travel"]
        yield verdict("travel-plausible", not wrong, f"{'; '.join(wrong)}: {travel}")


def force_interface(sensor: object) -> Part:
    """Check a force sensor's members, rate and range."""
    yield from _members(sensor, ForceSensor)
    if isinstance(sensor, ForceSensor):
        yield _stated_rate(sensor.rate_hz)
        most = sensor.range_n
        sane = _is_vector(most) and all(one > 0 for one in most)
        yield verdict(
            "range-stated", sane, f"range_n is {most}; give the greatest force of each axis, above 0 N"
        )


def camera_interface(camera: object) -> Part:
    """Check a camera's members, rate and size."""
    yield from _members(camera, Camera)
    if isinstance(camera, Camera):
        yield _stated_rate(camera.rate_hz)
        size = camera.size_px
        sane = len(size) == 2 and all(isinstance(side, int) and side > 0 for side in size)
        yield verdict("size-stated", sane, f"size_px is {size}; give (width, height), whole numbers above 0")


DISPLAY_BOUNDS = {
    "height_m": (1e-4, 0.1),
    "radius_m": (1e-4, 0.1),
    "greatest_pa": (1e3, 1e6),
    "watchdog_s": (1e-3, 10.0),
}
"""Bounds of what a display for a finger states: more or less is another unit."""
ARM_BOUNDS = {
    "least_m": (-1.0, 1.0),
    "greatest_m": (-1.0, 1.0),
    "force_n": (0.05, 100.0),
    "watchdog_s": (1e-4, 0.1),
}
"""Bounds of what an arm for a finger states."""


def display_interface(display: object) -> Part:
    """Check a contact-area display's members and its stated range."""
    yield from _members(display, SoftnessDevice)
    if isinstance(display, SoftnessDevice):
        yield _stated_range(display.range, DisplayRange, DISPLAY_BOUNDS)


def arm_interface(arm: object) -> Part:
    """Check a haptic arm's members and its stated range."""
    yield from _members(arm, HapticArm)
    if isinstance(arm, HapticArm):
        stated = arm.range
        finding = _stated_range(stated, ArmRange, ARM_BOUNDS)
        yield finding
        if finding.ok:
            yield verdict(
                "range-order", stated.least_m < stated.greatest_m,
                f"it reaches from {stated.least_m} to {stated.greatest_m} m; give the lesser one first",
            )  # fmt: skip


def _stated_range(stated: object, kind: type, bounds: Mapping[str, tuple[float, float]]) -> CheckResult:
    if not isinstance(stated, kind):
        return verdict("range-plausible", False, f"range is {stated!r}; give a palpate.core.{kind.__name__}")
    wrong = [
        f"{name} is {getattr(stated, name)!r}, not {low:g} to {high:g}"
        for name, (low, high) in bounds.items()
        if not (isinstance(getattr(stated, name), Real) and low <= getattr(stated, name) <= high)
    ]
    return verdict("range-plausible", not wrong, f"{'; '.join(wrong)}; is it in m, Pa, N and s?")


def _members(device: object, protocol: type) -> Part:
    members = {name: member for name, member in vars(protocol).items() if not name.startswith("_")}
    missing = [name for name in members if not hasattr(device, name)]
    yield verdict(
        "protocol-members", not missing,
        f"it lacks {', '.join(missing)}; see palpate.core.{protocol.__name__} for what it must have",
    )  # fmt: skip
    if not missing:
        methods = [name for name, member in members.items() if callable(member)]
        wrong = [name for name in methods if not _takes(getattr(device, name), ARGUMENTS.get(name, ()))]
        yield verdict(
            "protocol-arguments", not wrong,
            f"{', '.join(wrong)} cannot be called as palpate.core.{protocol.__name__} says",
        )  # fmt: skip


def _takes(method: Callable[..., object], arguments: tuple[Any, ...]) -> bool:
    try:
        inspect.signature(method).bind(*arguments)
    except TypeError:
        return False
    except ValueError:  # of a compiled function that does not tell
        return True
    return True


def _wrong(travel: Travel) -> Iterator[str]:
    for axis, low, high in zip("xyz", travel.least_m, travel.greatest_m, strict=True):
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            yield f"{axis} from {low} to {high} m"
        elif high - low > MAX_TRAVEL_M:
            yield f"{axis} spans {high - low:g} m; are these millimetres?"
    for name in ("top_speed_m_s", "acceleration_m_s2"):
        value = getattr(travel, name)
        if not (math.isfinite(value) and value > 0):
            yield f"{name} is {value}; it must be above 0"
    if not (math.isfinite(travel.latency_s) and travel.latency_s >= 0):
        yield f"latency_s is {travel.latency_s}; it must be 0 or more"


def _stated_rate(rate_hz: float) -> CheckResult:
    sane = isinstance(rate_hz, Real) and math.isfinite(rate_hz) and rate_hz > 0
    return verdict("rate-stated", sane, f"rate_hz is {rate_hz}; it must be above 0 Hz")


def _standing(stage: Any, clock: Clock) -> Part:
    moving = stage.moving()
    yield verdict("moving-type", isinstance(moving, bool), f"moving() is {moving!r}; give a bool")
    try:
        place = stage.position_m()
    except DeviceError:
        return  # before it is homed a stage need not know where it is
    shaped = _is_vector(place)
    yield verdict("position-type", shaped, f"position_m() is {place!r}; give three numbers, in m")
    if shaped:
        travel = stage.travel
        inside = all(
            low - MARGIN_M <= at <= high + MARGIN_M
            for low, at, high in zip(travel.least_m, place, travel.greatest_m, strict=True)
        )
        yield verdict(
            "position-in-travel", inside,
            f"position_m() is {place}, the travel {travel.least_m} to {travel.greatest_m} m; is it in m?",
        )  # fmt: skip


def _measuring(sensor: Any, clock: Clock) -> Part:
    sample = _first_sample(sensor, clock)
    late = isinstance(sample, DeviceError)
    yield verdict("first-sample", not late, "latest() raises DeviceError; is it streaming?")
    if late:
        return
    drained = sensor.drain()
    shaped = isinstance(sample, Wrench) and isinstance(drained, list)
    shaped = shaped and all(isinstance(one, Wrench) for one in drained)
    yield verdict(
        "sample-type", shaped,
        f"latest() is {sample!r} and drain() {type(drained).__name__}; give a palpate.core.Wrench and a list",
    )  # fmt: skip
    if not shaped:
        return
    yield on_clock(sample.time_ns, clock)
    if not sample.fault:
        within = _is_vector(sample.force_n) and all(
            abs(force) <= most for force, most in zip(sample.force_n, sensor.range_n, strict=True)
        )
        yield verdict(
            "force-in-range", within,
            f"force_n is {sample.force_n!r} of a stated {sensor.range_n} N; give three numbers, in newtons",
        )  # fmt: skip


def _first_sample(sensor: Any, clock: Clock) -> Any:
    """What `latest` gives, or the `DeviceError` that it still raises after a second."""
    end_ns = clock.now_ns() + round(FIRST_SAMPLE_S * NS_PER_S)
    while True:
        try:
            return sensor.latest()
        except DeviceError as e:
            if clock.now_ns() >= end_ns:
                return e
            clock.sleep(POLL_S)


def _filming(camera: Any, clock: Clock) -> Part:
    pair = camera.grab(FIRST_SAMPLE_S + 2.0 / camera.rate_hz)
    shaped = isinstance(pair, tuple) and len(pair) == 2 and isinstance(pair[1], Frame)
    yield verdict(
        "frame-type", shaped,
        f"grab() gave {type(pair).__name__}; give (when the exposure ended [ns], palpate.core.Frame)",
    )  # fmt: skip
    if shaped:
        time_ns, frame = pair
        width, height = camera.size_px
        yield verdict(
            "frame-size", frame.image.shape[:2] == (height, width),
            f"{width} x {height} px are stated, and rows, columns and colours of {frame.image.shape} came",
        )  # fmt: skip
        yield on_clock(time_ns, clock)


def on_clock(time_ns: object, clock: Clock) -> CheckResult:
    """Judge whether a stamp is of this clock and in its unit."""
    age_s = (clock.now_ns() - int(time_ns)) / NS_PER_S if isinstance(time_ns, Integral) else math.nan
    return verdict(
        "host-clock", -EARLY_S <= age_s <= MAX_AGE_S,
        f"a stamp of {time_ns!r} at {clock.now_ns()} ns; stamp with the clock that was given, in whole ns",
    )  # fmt: skip


def _is_vector(value: object) -> bool:
    """Tell whether a value is three finite numbers."""
    return (
        isinstance(value, tuple | list)
        and len(value) == 3
        and all(isinstance(one, Real) and math.isfinite(one) for one in value)
    )


def _showing(device: Any, clock: Clock) -> Part:
    """A display or an arm, asked for its state; nothing is told to it."""
    sample = device.latest()
    kind = DisplaySample if isinstance(device, SoftnessDevice) else ArmSample
    shaped = isinstance(sample, kind)
    yield verdict("state-type", shaped, f"latest() is {sample!r}; give a palpate.core.{kind.__name__}")
    if shaped:
        yield on_clock(sample.time_ns, clock)


ROLES: Mapping[Role, tuple[Callable[[object], Part], Callable[[Any, Clock], Part]]] = {
    "stage": (stage_interface, _standing),
    "force": (force_interface, _measuring),
    "camera": (camera_interface, _filming),
    "display": (display_interface, _showing),
    "arm": (arm_interface, _showing),
}
