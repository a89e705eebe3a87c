"""A rig from a TOML file: which devices, where the layer lies, and how far and how hard it may go.

Millimetres and newtons in the file, since people write it; metres and newtons behind it. Real drivers are
imported only where the file names them.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError

from palpate.core import (
    DEFAULT_SENSOR,
    SENSORS,
    Clock,
    ForceSensor,
    FrameSource,
    InputError,
    ManualClock,
    MonotonicClock,
    Position,
    RangeError,
    Stage,
)
from palpate.core.sensor import sensor as sensor_of
from palpate.devices import Limits, Mounting, open_device
from palpate.devices.device_plugins import check_kind
from palpate.rig.plans.plan_files import read_toml
from palpate.rig.plans.press_places import Positive
from palpate.rig.rig import Region, Rig
from palpate.rig.virtual import Fault, virtual_rig
from palpate.rig.virtual.disturbances import Kind
from palpate.rig.virtual.virtual_bench import PREFIX, REAL_TIME_AGE_S

if TYPE_CHECKING:
    from palpate.devices.check.interface_check import Role

MM = 1e-3
Three = tuple[float, float, float]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class GrblPart(_Part):
    """A GRBL stage; `home = true` lets it run to its switches when the rig is opened."""

    kind: Literal["grbl"]
    port: str
    axes: tuple[str, str, str] = ("+X", "-Y", "-Z")
    latency_s: Positive = 0.05
    home: bool = False

    def open(self, clock: Clock) -> Stage:
        """Open the stage, homed where that is asked for."""
        from palpate.rig.real.grbl.grbl_stage import GrblStage
        from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

        stage = GrblStage.open(GrblSpec(self.port, axes=self.axes, latency_s=self.latency_s), clock)
        if self.home:
            try:
                stage.home()
            except BaseException:
                stage.close()
                raise
        return stage


class MarlinPart(_Part):
    """A stage on Marlin; `home = true` homes it, `stands_at_mm` says on the caller's word where it stands."""

    kind: Literal["marlin"]
    port: str
    baud: Annotated[int, Field(ge=1)] = 115200
    axes: tuple[str, str, str] = ("+X", "-Y", "-Z")
    least_mm: Three | None = None
    greatest_mm: Three | None = None
    sudden_mm_s: Positive | None = None
    top_mm_s: Positive | None = None
    latency_s: Positive = 0.05
    queued_s: Positive = 0.5
    dtr: bool = False
    home: bool = False
    stands_at_mm: Three | None = None

    def open(self, clock: Clock) -> Stage:
        """Open the stage, homed or referenced where that is asked for."""
        from palpate.rig.real.marlin import MarlinSpec, MarlinStage

        if self.home and self.stands_at_mm is not None:
            raise InputError("stage: home = true and stands_at_mm both say where it is; leave one out")
        spec = MarlinSpec(
            self.port,
            self.baud,
            self.axes,
            least_m=None if self.least_mm is None else _metres(self.least_mm),
            greatest_m=None if self.greatest_mm is None else _metres(self.greatest_mm),
            sudden_m_s=None if self.sudden_mm_s is None else self.sudden_mm_s * MM,
            top_speed_m_s=None if self.top_mm_s is None else self.top_mm_s * MM,
            latency_s=self.latency_s,
            queued_s=self.queued_s,
            dtr=self.dtr,
        )
        stage = MarlinStage.open(spec, clock)
        try:
            if self.home:
                stage.home()
            elif self.stands_at_mm is not None:
                stage.reference(_metres(self.stands_at_mm))
        except BaseException:
            stage.close()
            raise
        return stage


class NetFTPart(_Part):
    """An ATI Net F/T box; `axes` says which of its axes are the skin's, and their signs."""

    kind: Literal["netft"]
    host: str
    axes: tuple[str, str, str] = ("x", "y", "z")
    rdt_port: Annotated[int, Field(ge=1, le=65535)] = 49152
    http_port: Annotated[int, Field(ge=1, le=65535)] = 80

    def open(self, clock: Clock) -> ForceSensor:
        """Open the force sensor."""
        from palpate.rig.real.netft.netft_sensor import NetFT, NetFTSettings

        return NetFT(self.host, NetFTSettings(rdt_port=self.rdt_port, http_port=self.http_port), clock)


class SerialScalePart(_Part):
    """A load cell or balance that prints lines; slow ones label and never guard. See `ScaleSpec`."""

    kind: Literal["serial-scale"]
    port: str
    axes: tuple[str, str, str] = ("x", "y", "z")
    unit: str = "g"
    count_N: Annotated[float, Field(allow_inf_nan=False)] | None = None  # noqa: N815
    rate_hz: Positive = 10.0
    delay_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.4
    range_N: Positive = 50.0  # noqa: N815
    ask: str = ""
    baud: Annotated[int, Field(ge=1)] = 9600
    frame: str = "8N1"
    dtr: bool = False
    settled_only: bool = False
    line_bytes: Annotated[int, Field(ge=1)] | None = None

    def open(self, clock: Clock) -> ForceSensor:
        """Open the force sensor."""
        from palpate.rig.real.scale import ScaleSpec, SerialScale

        fields = self.model_dump(exclude={"kind", "axes", "count_N", "range_N"})
        return SerialScale.open(ScaleSpec(**fields, count_n=self.count_N, range_n=self.range_N), clock)


class UvcPart(_Part):
    """A USB camera, by path, number or serial number."""

    kind: Literal["uvc"]
    address: str | int
    size_px: tuple[int, int] = (1920, 1080)
    rate_hz: Positive = 30.0
    pixels: Literal["MJPG", "YUYV"] = "MJPG"
    exposure_s: Positive = 0.01
    white_balance_k: int | None = 4600

    def open(self, clock: Clock) -> FrameSource:
        """Open the camera."""
        from palpate.rig.real.uvc_camera import UvcCamera, UvcSettings

        settings = UvcSettings(**self.model_dump(exclude={"kind", "address"}))
        return UvcCamera(self.address, settings, clock)


class PluginPart(BaseModel):
    """A device by the name of its class or entry point; all other fields are its options."""

    model_config = ConfigDict(frozen=True, extra="allow")
    kind: Annotated[str, Field(min_length=1, max_length=200)]

    @property
    def options(self) -> dict[str, Any]:
        """Options that it is opened with."""
        return dict(self.model_extra or {})


class ForcePluginPart(PluginPart):
    """A force sensor by the name of its class; `axes` is how it is mounted, and no option of its own."""

    axes: tuple[str, str, str] = ("x", "y", "z")


class LimitsPart(_Part):
    """Limits of position, force and speed, in millimetres and newtons."""

    least_mm: Three
    greatest_mm: Three
    force_N: Positive = 20.0  # noqa: N815 - the unit is part of the name
    force_rate_N_s: Positive = 400.0  # noqa: N815
    age_s: Positive = 0.1
    force_latency_s: Positive = 0.01
    overshoot_mm: Positive = 0.1
    step_mm: Positive = 0.2

    def limits(self) -> Limits:
        """Convert to SI."""
        return Limits(
            _metres(self.least_mm),
            _metres(self.greatest_mm),
            force_n=self.force_N,
            force_rate_n_s=self.force_rate_N_s,
            age_s=self.age_s,
            force_latency_s=self.force_latency_s,
            overshoot_m=self.overshoot_mm * MM,
            step_m=self.step_mm * MM,
        )


class FaultPart(_Part):
    """Fault of a virtual rig, from so many seconds on."""

    kind: Kind
    after_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0


class VirtualPart(_Part):
    """A virtual rig, with what goes wrong on it; `askew_mm` is where its skin lies from the origin."""

    seed: Annotated[int, Field(ge=0)] = 0
    askew_mm: Three = (0.0, 0.0, 0.0)
    real_time: bool = False
    faults: tuple[FaultPart, ...] = ()


class RegionPart(_Part):
    """A part of the picture that matters, such as "fringes", for the operator's page."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    box_px: tuple[int, int, int, int]


OWN: dict[Role, tuple[str, ...]] = {
    "stage": ("grbl", "marlin"),
    "force": ("netft", "serial-scale"),
    "camera": ("uvc",),
}
"""Kinds that palpate drives itself; the first of each role is that of a part without a kind."""


def _own(role: Role) -> Discriminator:
    """Discriminate palpate's own drivers of a role, by kind, from a plug-in."""

    def tag(part: Any) -> str:
        named = part.get("kind") if isinstance(part, dict) else getattr(part, "kind", None)
        return f"#{named or OWN[role][0]}" if named in (*OWN[role], None) else "#plugin"

    return Discriminator(tag)


StagePart = Annotated[
    Annotated[GrblPart, Tag("#grbl")]
    | Annotated[MarlinPart, Tag("#marlin")]
    | Annotated[PluginPart, Tag("#plugin")],
    _own("stage"),
]
ForcePart = Annotated[
    Annotated[NetFTPart, Tag("#netft")]
    | Annotated[SerialScalePart, Tag("#serial-scale")]
    | Annotated[ForcePluginPart, Tag("#plugin")],
    _own("force"),
]
CameraPart = Annotated[
    Annotated[UvcPart, Tag("#uvc")] | Annotated[PluginPart, Tag("#plugin")], _own("camera")
]


class RigFile(_Part):
    """The whole file: either `virtual`, or all of stage, force, camera and limits.

    Attributes:
        name, sensor: go into every run.
        design: the name of the sensor's design, such as "palm" or "tactip": its outline and probe are those
            of plans that give none, and a virtual rig drives it.
        origin_mm: in the stage's frame, the layer's centre at its expected surface.
        licence, origin: of what is recorded.
        regions: of the picture, each (x, y, width, height) [px].
        label_force: a second force sensor, which labels and does not guard, and so may be slow.
    """

    name: str
    sensor: str = ""
    design: str = DEFAULT_SENSOR
    licence: str = ""
    origin: str = ""
    origin_mm: Three = (0.0, 0.0, 0.0)
    virtual: VirtualPart | None = None
    stage: StagePart | None = None
    force: ForcePart | None = None
    camera: CameraPart | None = None
    label_force: ForcePart | None = None
    limits: LimitsPart | None = None
    regions: tuple[RegionPart, ...] = ()


def open_rig(text: str, *, seed: int = 0) -> Rig:
    """A rig by name, or from a TOML file; the caller closes it.

    Args:
        text: "virtual:" and a sensor's name, such as "virtual:palm"; or a file's path.
        seed: of the rig by name; a file has its own.

    Raises:
        InputError: neither; or a field that is not one, or out of range.
        DeviceError: a device is missing, busy or refuses; those opened before are closed.
    """
    if is_virtual(text):
        return virtual_rig(sensor_named(text), seed=seed)
    path = Path(text)
    file = read_rig(path)
    try:
        return rig_from(file)
    except InputError as e:
        raise InputError(f"{path}: {e}") from e


def sensor_named(text: str) -> str:
    """The sensor of a virtual rig's name."""
    name = text.removeprefix(PREFIX)
    try:
        sensor_of(name)
    except InputError as e:
        rigs = ", ".join(PREFIX + one for one in SENSORS.names())
        raise InputError(f"the rig {text!r} cannot be opened: {e}; by name there are {rigs}") from e
    return name


def is_virtual(text: str) -> bool:
    """Whether a text names a virtual rig, of whatever sensor."""
    return text.startswith(PREFIX)


def read_rig(path: Path) -> RigFile:
    """A rig's file, read and checked; nothing is opened.

    Raises:
        InputError: there is none; or a field that is not one, or out of range.
        StorageError: it cannot be read.
    """
    if not path.is_file():
        raise InputError(
            f"there is no rig {str(path)!r}: no such file, and by name there are "
            f"{', '.join(PREFIX + name for name in SENSORS.names())}"
        )
    fields = read_toml(path)
    try:
        file = RigFile.model_validate(fields)
    except ValidationError as e:
        problems = "; ".join(f"{_field(d['loc'])}: {d['msg']}" for d in e.errors())
        raise InputError(f"{path}: {problems}") from e
    roles: dict[str, Role] = {"stage": "stage", "force": "force", "label_force": "force", "camera": "camera"}
    for name, role in roles.items():
        if (part := getattr(file, name)) is not None:
            try:
                check_kind(role, part.kind, OWN[role])
            except InputError as e:
                raise InputError(f"{path}: {name}.kind: {e}") from e
    return file


def _field(location: tuple[str | int, ...]) -> str:
    """The field's name in the file, without the tags of its kinds."""
    return ".".join(str(part) for part in location if not str(part).startswith("#"))


def rig_from(file: RigFile) -> Rig:
    """Open what a file says."""
    if file.virtual is not None:
        if file.stage or file.force or file.camera or file.label_force:
            raise InputError(f"the rig {file.name!r} is virtual and names real devices; leave one out")
        return _virtual(file, file.virtual)
    if not (file.stage and file.force and file.camera and file.limits):
        raise InputError(
            f"the rig {file.name!r} needs [stage], [force], [camera] and [limits], or [virtual] instead"
        )
    clock = MonotonicClock()
    with ExitStack() as opened:
        force = _open("force", file.force, clock, opened)
        camera = _open("camera", file.camera, clock, opened)
        second = None if file.label_force is None else _open("force", file.label_force, clock, opened)
        stage = _open("stage", file.stage, clock, opened)
        rig = Rig(
            name=file.name,
            sensor=file.sensor,
            stage=stage,
            force=force,
            camera=camera,
            limits=file.limits.limits(),
            origin_m=_metres(file.origin_mm),
            clock=clock,
            mounting=Mounting(file.force.axes),
            regions=_regions(file),
            licence=file.licence,
            origin=file.origin,
            design=sensor_of(file.design),
            label_force=second,
            label_mounting=Mounting() if file.label_force is None else Mounting(file.label_force.axes),
        )
        _check_range(rig)
        opened.pop_all()
        return rig


def _open(role: Role, part: StagePart | ForcePart | CameraPart, clock: Clock, opened: ExitStack) -> Any:
    """Open a part's device, to be closed again with what else is open."""
    if isinstance(part, PluginPart):
        device = open_device(role, part.kind, part.options, clock)
    else:
        device = part.open(clock)
    opened.callback(device.close)
    return device


def _virtual(file: RigFile, part: VirtualPart) -> Rig:
    clock: Clock = MonotonicClock() if part.real_time else ManualClock()
    rig = virtual_rig(
        file.design,
        clock=clock,
        seed=part.seed,
        faults=[Fault(one.kind, one.after_s) for one in part.faults],
        limits=None if file.limits is None else file.limits.limits(),
        age_s=REAL_TIME_AGE_S if part.real_time else None,
        askew_m=_metres(part.askew_mm),
    )
    _check_range(rig)
    return replace(rig, name=f"{file.name}, {rig.name}", regions=_regions(file) or rig.regions)


def _check_range(rig: Rig) -> None:
    """Refuse a limit of force that the rig's sensor cannot measure."""
    try:
        rig.limits.check_range(rig.force.range_n[rig.mounting.normal])
    except RangeError as e:
        raise InputError(f"limits.force_N: {e}") from e


def _regions(file: RigFile) -> tuple[Region, ...]:
    return tuple(Region(one.name, one.box_px) for one in file.regions)


def _metres(mm: Three) -> Position:
    x, y, z = (MM * value for value in mm)
    return x, y, z
