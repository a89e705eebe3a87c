"""Every fault of display, arm and loop in every state: what names it, what the finger meets, how it ends.

All is simulated. The page `docs/explanations/softness-faults.md` holds the same table.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.core import DeviceError, ManualClock
from palpate.devices.motion_limits import Reason, Tripped
from palpate.softness import Characteristic, Mode, SoftObject
from palpate.softness.control import ReferenceTable, RenderingLoop
from palpate.softness.display_parts import FingerPresses, depth_for
from palpate.softness.rendering_simulation import law_of
from palpate.softness.virtual import BenchParts, RenderingBench, bench_kernel as k

PAGE = Path(__file__).parents[2] / "docs" / "explanations" / "softness-faults.md"
PARTS = BenchParts()


def table_of(area_mm2, area_n, way_mm, way_n, name="line") -> SoftObject:
    return SoftObject(
        name, Characteristic("area", 1e-6 * np.array(area_mm2), np.array(area_n, float)),
        Characteristic("displacement", 1e-3 * np.array(way_mm), np.array(way_n, float)), "a test",
    )  # fmt: skip


LINE = table_of([0.0, 20, 130], [0, 0.6, 3.9], [0.0, 6], [0, 3.9])
OTHER = table_of([0.0, 130], [0, 3.0], [0.0, 6], [0, 3.0], "other")
SUDDEN = table_of([0.0, 60, 133], [0.55, 1.1, 3.4], [0.0, 4], [0.0, 3.4], "sudden")
HARD = table_of([0.0, 40, 133], [0, 3.9, 6.0], [0.0, 3], [0, 6.0], "hard")

STATES = {"air": 0.02, "onset": 0.16, "pressing": 0.3, "peak": 0.5, "releasing": 0.75, "changing": 0.32}
"""Seconds after which the fault comes, presses being of 1 Hz; while it changes it shows another object."""

AFTER_S = 0.7


@dataclass(frozen=True)
class Fault:
    """What is done to a bench, what may name it, and the object while it lasts; no name: it goes on."""

    inject: Callable[[Any], None]
    names: tuple[Reason, ...]
    soft: SoftObject = LINE
    silent_in_air: bool = False


class Bed:
    """A loop on a bench, and ways to spoil it."""

    def __init__(self, soft: SoftObject) -> None:
        self.clock = ManualClock()
        presses = FingerPresses(depth_for(soft, 2.5, PARTS.finger), 1.0, starts_s=0.0)
        self.bench = RenderingBench(self.clock, presses, PARTS)
        self.display, self.arm = self.bench.display, self.bench.arm
        self.table = ReferenceTable(law_of(soft, Mode.BOTH, PARTS))
        self.loop = RenderingLoop(self.display, self.arm, self.table, self.clock)
        self.sleeps = [1e-3]

    def samples(self, device: Any, **wrong: Any) -> None:
        """Let a device's samples be wrong in some fields; a function is given the right one."""
        right = device.latest

        def latest() -> Any:
            one = right()
            return replace(one, **{
                name: value(getattr(one, name)) if callable(value) else value for name, value in wrong.items()
            })  # fmt: skip

        device.latest = latest

    def fails(self, device: Any, name: str) -> None:
        """Let a call of a device fail."""

        def call(*_: Any) -> None:
            raise DeviceError(f"{name} returned -1")

        setattr(device, name, call)

    def opening(self, stuck: float) -> None:
        """Let the valve's spool stand still somewhere."""
        figures = self.bench._figures
        self.bench._figures = figures._replace(spool_omega=0.0)
        self.bench.state[k.SPOOL], self.bench.state[k.SPOOL_SPEED] = stuck, 0.0

    def figures(self, **changed: float) -> None:
        self.bench._figures = self.bench._figures._replace(**changed)

    def reference(self, **changed: float) -> None:
        at = self.table.at
        self.table.at = lambda s, d: replace(at(s, d), **changed)  # type: ignore[method-assign]


def frozen(bed: Bed, device: Any, name: str) -> None:
    value = getattr(device.latest(), name)
    bed.samples(device, **{name: value})


def once_late(bed: Bed, seconds: float) -> None:
    bed.sleeps = [seconds, 1e-3]


R = Reason
FAULTS: dict[str, Fault] = {
    "A to 0: force at no area": Fault(lambda bed: None, (), SUDDEN),
    "pressure at its bound": Fault(lambda bed: None, (), HARD),
    "Hall below 0": Fault(lambda bed: bed.samples(bed.display, pushed_m=-2e-3), (R.PUSH,)),
    "Hall above the height": Fault(lambda bed: bed.samples(bed.display, pushed_m=12e-3), (R.PUSH,)),
    "Hall jumps by 3 mm": Fault(
        lambda bed: bed.samples(bed.display, pushed_m=lambda s: s + 3e-3 if s < 6e-3 else s - 3e-3),
        (R.PUSH,)),
    "Hall is no number": Fault(lambda bed: bed.samples(bed.display, pushed_m=math.nan), (R.DISPLAY,)),
    "Hall stands still": Fault(
        lambda bed: frozen(bed, bed.display, "pushed_m"), (R.DISPLAY, R.PRESSURE, R.ARM, R.ENERGY)),
    "pressure sensor stands still": Fault(
        lambda bed: frozen(bed, bed.display, "pressure_pa"), (R.DISPLAY, R.PRESSURE, R.FORCE_LIMIT)),
    "pressure sensor is no number": Fault(
        lambda bed: bed.samples(bed.display, pressure_pa=math.nan), (R.DISPLAY,)),
    "display says a fault": Fault(lambda bed: bed.samples(bed.display, fault="supply low"), (R.DISPLAY,)),
    "display does not answer": Fault(lambda bed: bed.fails(bed.display, "latest"), (R.DISPLAY,)),
    "display refuses pressure": Fault(lambda bed: bed.fails(bed.display, "set_pressure"), (R.DISPLAY,)),
    "valve stuck wide open": Fault(
        lambda bed: bed.opening(1.0), (R.PRESSURE, R.FORCE_LIMIT, R.FORCE_RATE, R.PUSH, R.ENERGY, R.ARM)),
    "valve stuck shut": Fault(
        lambda bed: bed.opening(0.0), (R.PRESSURE, R.ENERGY), silent_in_air=True),
    "chamber leaks": Fault(
        lambda bed: bed.figures(leak=4e-9), (R.PRESSURE, R.ENERGY), silent_in_air=True),
    "supply is gone": Fault(
        lambda bed: bed.figures(supply=0.0), (R.PRESSURE, R.ENERGY), silent_in_air=True),
    "loop late by 3.5 ms": Fault(lambda bed: once_late(bed, 3.5e-3), (R.LOOP_LATE,)),
    "loop stands for 50 ms": Fault(lambda bed: once_late(bed, 50e-3), (R.LOOP_LATE,)),
    "arm does not answer": Fault(lambda bed: bed.fails(bed.arm, "latest"), (R.ARM,)),
    "arm refuses force": Fault(lambda bed: bed.fails(bed.arm, "set_force"), (R.ARM,)),
    "arm says its motors saturate": Fault(
        lambda bed: bed.samples(bed.arm, fault="motor saturated"), (R.ARM,)),
    "arm brakes by itself": Fault(
        lambda bed: (bed.samples(bed.arm, fault="velocity limit: the arm brakes"),
                     bed.figures(arm_damping=20.0))[0], (R.ARM,)),
    "arm is no number": Fault(lambda bed: bed.samples(bed.arm, displacement_m=math.nan), (R.ARM,)),
    "arm jumps by 4 mm": Fault(
        lambda bed: bed.samples(bed.arm, displacement_m=lambda a: a + 4e-3), (R.ARM,)),
    "reference is no number": Fault(lambda bed: bed.reference(pressure_pa=math.nan), (R.REFERENCE,)),
    "reference is 1 MPa": Fault(
        lambda bed: bed.reference(pressure_pa=1e6), (R.REFERENCE,)),
}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What came of one cell."""

    reason: Reason | None
    named_s: float
    finger_n: float
    pressure_pa: float
    vented: bool


@cache
def outcome_of(name: str, state: str) -> Outcome:
    """Run one cell."""
    fault = FAULTS[name]
    bed = Bed(fault.soft)
    for i in range(round(1000 * STATES[state])):
        if state == "changing" and i == 200:
            bed.loop.show(ReferenceTable(law_of(OTHER if fault.soft is LINE else LINE, Mode.BOTH, PARTS)))
        bed.loop.tick()
        bed.clock.sleep(1e-3)
    with suppress(IndexError):
        fault.inject(bed)
    most_n = most_pa = 0.0
    before_n = bed.bench.truth().largest_n
    reason, named = None, math.nan
    for i in range(round(1000 * AFTER_S)):
        if reason is None:
            try:
                bed.loop.tick()
            except Tripped as e:
                reason, named = e.reason, 1e-3 * i
        bed.clock.sleep(bed.sleeps.pop(0) if len(bed.sleeps) > 1 else 1e-3)
        truth = bed.bench.truth()
        most_n, most_pa = max(most_n, truth.force_n), max(most_pa, truth.pressure_pa)
    if truth.largest_n > before_n:  # also between two periods
        most_n = truth.largest_n
    vented = truth.pressure_pa < 3e3 and bed.bench.force_n == 0.0
    return Outcome(reason, named, most_n, most_pa, vented)


CELLS = [(name, state) for name in FAULTS for state in STATES]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "state"), CELLS, ids=[f"{n} / {s}" for n, s in CELLS])
def test_a_fault_is_named_and_ends_safe_and_the_finger_meets_no_more_than_is_said(name, state) -> None:
    fault, came = FAULTS[name], outcome_of(name, state)
    assert came.finger_n <= 10.0
    assert came.pressure_pa <= 1.01 * PARTS.valve.supply_pa
    if not fault.names or (fault.silent_in_air and state == "air" and came.reason is None):
        assert came.reason is None
        return
    assert came.reason in fault.names
    assert came.vented


NEAR = (20.0, 0.3, 3.0)
"""ms, N and kPa by which another processor's arithmetic may differ from the page."""


@pytest.mark.parametrize("every", [26, pytest.param(1, marks=pytest.mark.slow)])
def test_the_page_says_what_was_measured(every: int) -> None:
    written = [one for one in PAGE.read_text(encoding="utf-8").splitlines() if one.startswith("| ")][1:]
    assert [one.strip("|").split("|")[0].strip() for one in written] == list(FAULTS)
    for told, measured in zip(written[::every], rows(every), strict=True):
        cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in (told, measured)]
        assert cells[0][:2] == cells[1][:2]
        for one, other, near in zip(cells[0][2:], cells[1][2:], NEAR, strict=True):
            assert float(one or 0) == pytest.approx(float(other or 0), abs=near)


def rows(every: int = 1) -> list[str]:
    """Rows of the page's table, or one in so many."""
    lines = []
    for name in list(FAULTS)[::every]:
        cells = [outcome_of(name, state) for state in STATES]
        named = sorted({one.reason.value for one in cells if one.reason is not None})
        after = [one.named_s for one in cells if one.reason is not None]
        ms = f"{1e3 * max(after):.0f}" if after else ""
        most_n, most_kpa = max(one.finger_n for one in cells), max(one.pressure_pa for one in cells) / 1e3
        lines.append(f"| {name} | {', '.join(named) or 'goes on'} | {ms} | {most_n:.1f} | {most_kpa:.0f} |")
    return lines
