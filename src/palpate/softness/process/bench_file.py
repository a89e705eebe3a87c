"""Rendering bench from a TOML file in mm, N, and kPa: devices and limits; virtual without a file."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from palpate.core import Clock, HapticArm, InputError, SafetyError, SoftnessDevice
from palpate.core.parsing import parser
from palpate.devices.device_plugins import (
    MM,
    Host,
    Part,
    Three,
    check_kind,
    metres,
    open_device,
    read_toml,
    validated,
)
from palpate.devices.motion_limits import ForceLimits
from palpate.softness.control.bench_watch import BenchLimits
from palpate.softness.display_parts import ConeDisplay
from palpate.softness.rendering_law import DisplayBounds, Mode

if TYPE_CHECKING:
    from palpate.devices.check.interface_check import Role

KPA = 1e3
MAX_FORCE_N = 20.0  # that a file may allow on a finger
VIRTUAL_LATE_MS = 100.0  # no finger is there, and a laptop has other things to do

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class LabJackPart(Part):
    """A display on a LabJack board; see `palpate.softness.real.LabJackSettings`."""

    kind: Literal["labjack"] = "labjack"
    host: Host
    hall_V: tuple[Finite, ...]  # noqa: N815 - the unit is part of the name
    hall_mm: tuple[Finite, ...]
    setpoint_V: tuple[Finite, Finite]  # noqa: N815
    setpoint_kPa: Positive  # noqa: N815
    monitor_V: tuple[Finite, Finite]  # noqa: N815
    monitor_kPa: Positive  # noqa: N815
    monitor_tolerance_kPa: NotNegative = 2.0  # noqa: N815
    greatest_kPa: Positive  # noqa: N815
    height_mm: Positive = 10.0
    radius_mm: Positive = 6.5
    board: Literal["T7", "T4"] = "T7"
    hall_ain: Annotated[int, Field(ge=0)] = 0
    watchdog_s: Annotated[int, Field(ge=1)] = 1
    heartbeat_dio: int | None = None
    hardware_vent_s: Positive | None = None

    def open(self, clock: Clock) -> SoftnessDevice:
        """Connect to the board."""
        from palpate.softness.real import HallTable, LabJackDisplay, LabJackSettings, PressureScale

        settings = LabJackSettings(
            self.host,
            HallTable(self.hall_V, self.hall_mm),
            PressureScale(*self.setpoint_V, KPA * self.setpoint_kPa),
            PressureScale(*self.monitor_V, KPA * self.monitor_kPa, KPA * self.monitor_tolerance_kPa),
            KPA * self.greatest_kPa, MM * self.height_mm, MM * self.radius_mm, self.board, self.hall_ain,
            self.watchdog_s, self.heartbeat_dio, self.hardware_vent_s,
        )  # fmt: skip
        return LabJackDisplay(settings, clock)


class ForceDimensionPart(Part):
    """A Force Dimension arm; see `palpate.softness.real.ForceDimensionSpec`."""

    kind: Literal["force-dimension"] = "force-dimension"
    press_axis: Literal["x", "y", "z"]
    press_sign: Literal[1, -1]
    zero_mm: Three
    least_mm: Finite
    greatest_mm: Finite
    force_N: Positive  # noqa: N815
    effector_g: NotNegative
    serial: int | None = None
    watchdog_ms: Positive = 20.0

    def open(self, clock: Clock) -> HapticArm:
        """Open the device by its library."""
        from palpate.softness.real import ForceDimensionArm, ForceDimensionSpec

        spec = ForceDimensionSpec(
            self.press_axis, self.press_sign, metres(self.zero_mm), MM * self.least_mm, MM * self.greatest_mm,
            self.force_N, 1e-3 * self.effector_g, self.serial, 1e-3 * self.watchdog_ms,
        )  # fmt: skip
        return ForceDimensionArm(spec, clock)


class OwnDevicePart(BaseModel):
    """A device by the name of its class or entry point; all other fields are its options."""

    model_config = ConfigDict(frozen=True, extra="allow")
    kind: Annotated[str, Field(min_length=1, max_length=200)]

    @property
    def options(self) -> dict[str, Any]:
        """Options that it is opened with."""
        return dict(self.model_extra or {})


def _of(own: str) -> Discriminator:
    def tag(part: Any) -> str:
        named = part.get("kind") if isinstance(part, dict) else getattr(part, "kind", None)
        return "#own" if named in (own, None) else "#plugin"

    return Discriminator(tag)


DisplayPart = Annotated[
    Annotated[LabJackPart, Tag("#own")] | Annotated[OwnDevicePart, Tag("#plugin")], _of("labjack")
]
ArmPart = Annotated[
    Annotated[ForceDimensionPart, Tag("#own")] | Annotated[OwnDevicePart, Tag("#plugin")],
    _of("force-dimension"),
]


class ConePart(Part):
    """What no driver tells of a display: its rings, and the sleeve over them."""

    rings: Annotated[int, Field(ge=0, le=1000)] = 0
    sleeve_N_mm: NotNegative = 0.0  # noqa: N815 - the unit is part of the name
    damping_N_s_m: NotNegative = 0.25  # noqa: N815


class BoundsPart(Part):
    """Bounds of a rendering; see `palpate.softness.control.BenchLimits`."""

    force_N: Annotated[float, Field(gt=0, le=MAX_FORCE_N)] = 10.0  # noqa: N815 - the unit is part of the name
    force_rate_N_s: Annotated[float, Field(gt=0, le=5000)] = 1000.0  # noqa: N815
    age_ms: Annotated[float, Field(gt=0, le=50)] = 10.0
    late_ms: Annotated[float, Field(ge=1.5, le=20)] = 3.0


class BenchFile(Part):
    """The whole file; without display and arm the bench is virtual."""

    name: Annotated[str, Field(min_length=1, max_length=80)] = "virtual softness bench"
    display: DisplayPart | None = None
    arm: ArmPart | None = None
    cone: ConePart = ConePart()
    limits: BoundsPart = BoundsPart()

    @model_validator(mode="after")
    def _whole(self) -> BenchFile:
        if self.display is not None and self.arm is None:
            raise ValueError("a display without [arm]; both cues need both, and CM2 an [arm] alone")
        return self

    @property
    def simulated(self) -> bool:
        """Whether nothing of it is real."""
        return self.arm is None

    def bench_limits(self) -> BenchLimits:
        """Limits of the loop."""
        force = ForceLimits(self.limits.force_N, self.limits.force_rate_N_s, age_s=1e-3 * self.limits.age_ms)
        late_ms = VIRTUAL_LATE_MS if self.simulated else self.limits.late_ms
        return BenchLimits(force, late_s=1e-3 * late_ms)


@parser("softness bench", InputError)
def read_bench(path: Path | None) -> BenchFile:
    """Read and validate a bench file, None for the virtual bench; nothing is opened."""
    if path is None:
        return BenchFile()
    if not path.is_file():
        raise InputError(f"there is no bench's file {path}; leave it out for the virtual bench")
    file = validated(BenchFile, path, {"name": path.stem} | read_toml(path))
    if file.arm is None:
        raise InputError(
            f"{path}: [arm] is missing; leave the file out for the virtual bench", code="arm-missing"
        )
    roles: list[tuple[Role, Any, str]] = [
        ("display", file.display, "labjack"), ("arm", file.arm, "force-dimension"),
    ]  # fmt: skip
    for role, part, own in roles:
        if part is not None:
            try:
                check_kind(role, part.kind, (own,))
            except InputError as e:
                raise InputError(f"{path}: {role}.kind: {e}", code="arm-unknown") from e
    return file


@dataclass(frozen=True, slots=True)
class OpenedBench:
    """Open devices of a bench, and what a law needs of them; `display` is None if a plate is in its place."""

    display: SoftnessDevice | None
    arm: HapticArm
    cone: ConeDisplay
    bounds: DisplayBounds
    damping_n_s_m: float
    simulated: bool


def open_real_bench(file: BenchFile, mode: Mode, clock: Clock, opened: ExitStack) -> OpenedBench:
    """Open the devices of a file, closed with the stack; in CM2 the display is not opened."""
    if file.display is None and mode is not Mode.KINESTHETIC:
        raise SafetyError(
            f"{mode.value} on the bench {file.name!r}, which has no [display]; without one there is CM2 alone"
        )
    assert file.arm is not None
    arm: HapticArm = _opened("arm", file.arm, clock)
    opened.callback(arm.close)
    display: SoftnessDevice | None = None
    cone = ConeDisplay()
    greatest_pa = DisplayBounds().pressure_pa
    if file.display is not None and mode is not Mode.KINESTHETIC:
        display = _opened("display", file.display, clock)
        opened.callback(display.close)
        shown = display.range
        cone = ConeDisplay(shown.height_m, shown.radius_m, file.cone.rings, file.cone.sleeve_N_mm / MM)
        greatest_pa = shown.greatest_pa
    reach = arm.range
    bounds = DisplayBounds(greatest_pa, file.limits.force_N, (reach.least_m, reach.greatest_m))
    return OpenedBench(display, arm, cone, bounds, file.cone.damping_N_s_m, simulated=False)


def _opened(role: Role, part: LabJackPart | ForceDimensionPart | OwnDevicePart, clock: Clock) -> Any:
    if isinstance(part, OwnDevicePart):
        return open_device(role, part.kind, part.options, clock)
    opening: Callable[[Clock], Any] = part.open
    return opening(clock)
