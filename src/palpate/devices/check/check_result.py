"""The result of a check for one law, and the ways to come to one."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from palpate.core import NS_PER_S, Clock, DeviceError
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
