"""One finding of a check, and the ways to come to one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from palpate.core import NS_PER_S, Clock, DeviceError


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Whether one law holds.

    Attributes:
        name: the law, as a short sentence; the same in every run.
        ok: whether it holds.
        measured: what was measured, in `unit`; None where nothing is.
        allowed: the most that it may be, in `unit`; None where there is no bound.
        unit: of both: m, s, N, Hz; empty for a count.
        message: what is wrong and what to do; empty where nothing is.
    """

    name: str
    ok: bool
    measured: float | None = None
    allowed: float | None = None
    unit: str = ""
    message: str = ""


Part = Iterator[CheckResult]


def at_most(name: str, measured: float, allowed: float, unit: str, message: str) -> CheckResult:
    """That something does not pass a bound; not-a-number passes every bound."""
    return judged(name, measured <= allowed, measured, allowed, unit, message)


def judged(
    name: str, ok: bool | np.bool_, measured: float, allowed: float, unit: str, message: str
) -> CheckResult:
    """That a number is as it should be, where that is more than a bound."""
    return CheckResult(name, bool(ok), float(measured), float(allowed), unit, "" if ok else message)


def held(name: str, ok: bool | np.bool_, message: str) -> CheckResult:
    """That something is so."""
    return CheckResult(name, bool(ok), message="" if ok else message)


def measured_only(name: str, measured: float, unit: str) -> CheckResult:
    """A number that has no bound here, but must be one."""
    ok = math.isfinite(measured)
    return CheckResult(name, ok, float(measured), None, unit, "" if ok else f"{name}: not a finite number")


def prefixed(device: str, findings: list[CheckResult]) -> list[CheckResult]:
    """The same findings, of a device that is named."""
    return [replace(one, name=f"{device}: {one.name}") for one in findings]


def gathered(what: str, part: Part) -> Part:
    """The part's findings; an exception that leaves it becomes one more finding."""
    try:
        yield from part
    except Exception as e:  # whatever a driver raises is what is to be told
        yield held(
            f"{what} raises nothing unexpected",
            False,
            f"{type(e).__name__}: {e}; where a device cannot do what it is asked it raises DeviceError, and "
            "here it should have been able to",
        )


def closing(device: object, use: Callable[[], object], called: str) -> Part:
    """That a device is closed once and for all."""
    close: Callable[[], None] = device.close  # type: ignore[attr-defined]
    close()
    again = refusal(close)
    yield held("closes twice", again is None, f"the second close() {told(again)}; let it do nothing")
    after = refusal(use)
    yield held(
        "refuses once closed",
        isinstance(after, DeviceError),
        f"{called} on a closed device {told(after)}; raise DeviceError",
    )


def refusal(call: Callable[[], object]) -> Exception | None:
    """What a call raises; None where it goes through."""
    try:
        call()
    except Exception as e:
        return e
    return None


def told(error: Exception | None) -> str:
    """What `refusal` found, in words."""
    return "went through" if error is None else f"raised {type(error).__name__}: {error}"


def seconds(clock: Clock) -> float:
    """The clock's time [s]."""
    return clock.now_ns() / NS_PER_S
