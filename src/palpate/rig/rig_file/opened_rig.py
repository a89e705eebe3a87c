"""A rig from a TOML file: which devices, where the layer lies, and how far and how hard it may go.

Millimetres and newtons in the file, since people write it; metres and newtons behind it. Real drivers and
the virtual rig are imported only where the file names them, so that a supervisor of real devices is soon up.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator

from palpate.core import (
    DEFAULT_SENSOR,
    SENSORS,
    Clock,
    ForceSensor,
    InputError,
    ManualClock,
    MonotonicClock,
    RangeError,
    Stage,
    Wrench,
)
from palpate.core.parsing import parser
from palpate.core.provenance import Provenance
from palpate.core.sensor import sensor as sensor_of
from palpate.devices import Limits, Mounting, SupervisorLink, open_device
from palpate.devices.device_plugins import check_kind
from palpate.rig.commissioning.hand_motion import touch_off
from palpate.rig.commissioning.homing import home_clear
from palpate.rig.mean_force import Hand
from palpate.rig.rig import VIRTUAL, Region, Rig

if TYPE_CHECKING:
    from palpate.devices.check.interface_check import Role

from palpate.devices.device_plugins import Part, Three, metres, read_toml, validated
from palpate.rig.rig_file.sensor_parts import (
    FollowingPart,
    ForcePluginPart,
    NetFTPart,
    PluginPart,
    ResenseHexPart,
    SerialScalePart,
    UvcPart,
)
from palpate.rig.rig_file.stage_parts import (
    GrblPart,
    KnownWeightPart,
    LimitsPart,
    MarlinPart,
    PositionFrom,
    RegionPart,
    RetriesPart,
    StiffnessPart,
    UrArmPart,
    VirtualPart,
)

SUPERVISOR = ("-m", "palpate.rig.supervisor_process")

OWN: dict[Role, tuple[str, ...]] = {
    "stage": ("grbl", "marlin", "ur-arm"),
    "force": ("netft", "serial-scale", "resense-hex", "virtual"),
    "camera": ("uvc", "virtual"),
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
    | Annotated[UrArmPart, Tag("#ur-arm")]
    | Annotated[PluginPart, Tag("#plugin")],
    _own("stage"),
]
ForcePart = Annotated[
    Annotated[NetFTPart, Tag("#netft")]
    | Annotated[SerialScalePart, Tag("#serial-scale")]
    | Annotated[ResenseHexPart, Tag("#resense-hex")]
    | Annotated[FollowingPart, Tag("#virtual")]
    | Annotated[ForcePluginPart, Tag("#plugin")],
    _own("force"),
]
CameraPart = Annotated[
    Annotated[UvcPart, Tag("#uvc")]
    | Annotated[FollowingPart, Tag("#virtual")]
    | Annotated[PluginPart, Tag("#plugin")],
    _own("camera"),
]


class RigFile(Part):
    """The whole file: either `virtual`, or all of stage, force, camera and limits.

    Attributes:
        name, sensor: go into every run.
        design: the name of the sensor's design, such as "palm" or "tactip": its outline and probe are those
            of plans that give none, and a virtual rig drives it.
        origin_mm: in the stage's frame, the layer's centre at its expected surface.
        licence, origin: of what is recorded.
        regions: of the picture, each (x, y, width, height) [px].
        label_force: a second force sensor, which labels and does not guard, and so may be slow.
        retries: of presses that a transient fault ended.
        stiffness: range of stiffness that each indenter meets, checked from the first press on.
        known_weight: that was laid on the force sensor, and when.
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
    retries: RetriesPart = Field(default_factory=RetriesPart)
    stiffness: tuple[StiffnessPart, ...] = ()
    known_weight: KnownWeightPart | None = None
    regions: tuple[RegionPart, ...] = ()

    @field_validator("label_force")
    @classmethod
    def _measures(cls, part: ForcePart | None) -> ForcePart | None:
        if _follows(part):
            raise ValueError(
                'kind = "virtual" is for [force] and [camera], which follow the [stage]; leave this out'
            )
        return part


def open_rig(text: str, *, seed: int = 0, supervised: bool = True, position: PositionFrom = "stored") -> Rig:
    """A rig by name, or from a TOML file; the caller closes it.

    Args:
        text: "virtual:" and a sensor's name, such as "virtual:palm"; or a file's path.
        seed: of the rig by name; a file has its own.
        supervised, position: see `rig_from`.

    Raises:
        PositionUnknownError: nothing proves where the stage is; its `code` is the reason.
        InputError: neither; or a field that is not one, or out of range.
        DeviceError: a device is missing, busy or refuses; those opened before are closed.
    """
    if is_virtual(text):
        from palpate.rig.virtual.virtual_bench import virtual_rig

        return virtual_rig(sensor_named(text), seed=seed)
    path = Path(text)
    file = read_rig(path)
    try:
        return rig_from(file, supervised=supervised, name=str(path.resolve()), position=position)
    except InputError as e:
        raise InputError(f"{path}: {e}", code=e.code) from e


def sensor_named(text: str) -> str:
    """The sensor of a virtual rig's name."""
    name = text.removeprefix(VIRTUAL)
    try:
        sensor_of(name)
    except InputError as e:
        rigs = ", ".join(VIRTUAL + one for one in SENSORS.names())
        raise InputError(f"the rig {text!r} cannot be opened: {e}; by name there are {rigs}") from e
    return name


def is_virtual(text: str) -> bool:
    """Whether a text names a virtual rig, of whatever sensor."""
    return text.startswith(VIRTUAL)


@parser("rig file", InputError)
def read_rig(path: Path) -> RigFile:
    """A rig's file, read and checked; nothing is opened.

    Raises:
        InputError: there is none; or a field that is not one, or out of range.
        StorageError: it cannot be read.
    """
    if not path.is_file():
        raise InputError(
            f"there is no rig {str(path)!r}: no such file, and by name there are "
            f"{', '.join(VIRTUAL + name for name in SENSORS.names())}",
            code="rig-unknown",
        )
    file = validated(RigFile, path, read_toml(path))
    roles: dict[str, Role] = {"stage": "stage", "force": "force", "label_force": "force", "camera": "camera"}
    for name, role in roles.items():
        if (part := getattr(file, name)) is not None:
            try:
                check_kind(role, part.kind, OWN[role])
            except InputError as e:
                raise InputError(f"{path}: {name}.kind: {e}", code=e.code) from e
    return file


def rig_from(
    file: RigFile, *, supervised: bool = True, name: str = "", position: PositionFrom = "stored"
) -> Rig:
    """Open what a file says.

    Args:
        file: what it says.
        supervised: stage and force sensor belong to a process of their own, which guards every motion;
            otherwise they are opened here, as checks need it that talk to each device.
        name: under which that process can be found, to stop it; left out, the rig's own.
        position: Source of the stage's position, see `PositionFrom`.
    """
    if file.virtual is not None:
        if file.stage or file.force or file.camera or file.label_force:
            raise InputError(f"the rig {file.name!r} is virtual and names real devices", code="parts-exclude")
        return _virtual(file, file.virtual)
    if not (file.stage and file.force and file.camera and file.limits):
        raise InputError(
            f"the rig {file.name!r} needs [stage], [force], [camera] and [limits], or [virtual] instead",
            code="parts-missing",
        )
    limits, mounting, regions = _limits(file.limits), Mounting(file.force.axes), _regions(file)
    design = sensor_of(file.design)  # all that needs no device, before one is opened
    clock = MonotonicClock()
    with ExitStack() as opened:
        camera = None if _follows(file.camera) else _opened("camera", file.camera, clock, opened)
        second = None if file.label_force is None else _opened("force", file.label_force, clock, opened)
        supervisor: SupervisorLink | None = None
        guarded: tuple[Stage, ForceSensor]
        if supervised:
            supervisor = SupervisorLink(
                SUPERVISOR,
                {"rig": file.model_dump(mode="json"), "name": name or file.name, "position": position},
            )
            opened.callback(supervisor.close)
            guarded = supervisor.stage, supervisor.force
        else:
            guarded = open_guarded(file, clock, opened, position)
        if camera is None:
            camera = follow_stage("camera", file, guarded[0], clock)
        simulated = [f"{role} simulated" for role in OWN if _follows(getattr(file, role))]
        rig = Rig(
            name=file.name,
            sensor=f"virtual {file.design}" if _follows(file.camera) else file.sensor,
            stage=guarded[0],
            force=guarded[1],
            camera=camera,
            limits=limits,
            origin_m=metres(file.origin_mm),
            clock=clock,
            mounting=mounting,
            regions=regions,
            licence=file.licence,
            origin="; ".join([*filter(None, [file.origin]), *simulated]),
            provenance=Provenance.SIMULATED if simulated else Provenance.MEASURED,
            design=design,
            label_force=second,
            label_mounting=Mounting() if file.label_force is None else Mounting(file.label_force.axes),
            supervisor=supervisor,
            **_stated(file),
        )
        _check_range(rig)
        opened.pop_all()
        return rig


def open_guarded(
    file: RigFile, clock: Clock, opened: ExitStack, position: PositionFrom = "stored"
) -> tuple[Stage, ForceSensor]:
    """Open what a guarded motion needs, stage and force sensor, and find the stage's position.

    Raises:
        PositionUnknownError: nothing proves where the stage is; its `code` is the reason.
    """
    assert file.stage is not None  # as whoever reads the file made sure of
    assert file.force is not None
    if _follows(file.force):
        stage = _opened_stage(file.stage, clock, opened, position)
        force = follow_stage("force", file, stage, clock)
    else:
        force = _opened("force", file.force, clock, opened)
        stage = _opened_stage(file.stage, clock, opened, position)
    if not isinstance(file.stage, GrblPart | MarlinPart):
        return stage, force
    mounting = Mounting(file.force.axes)
    if position == "touch-off" or (file.stage.home and position != "reference"):
        limits = None if file.limits is None else _limits(file.limits)
        if limits is not None:
            _check_before_motion(limits, stage, force, mounting)
        if position == "touch-off":
            surface_m = metres(file.origin_mm)
            hand = Hand(stage, force, mounting, clock)
            touch_off(hand, surface_m, pushed=not _follows(file.force))
        else:
            home_clear(stage, force, mounting, clock)
    stage.position_m()  # refused here, where it is not known, and not at the first motion
    return stage, force


def _limits(part: LimitsPart) -> Limits:
    """The file's limits; what is wrong with them is named as the file's."""
    try:
        return part.limits()
    except RangeError as e:
        raise InputError(f"limits: {e}") from e


def _check_before_motion(limits: Limits, stage: Stage, force: ForceSensor, mounting: Mounting) -> None:
    """Refuse limits that the devices cannot keep, before the stage is homed or touches off."""
    try:
        limits.check_within(stage.travel)
        limits.check_range(force.range_n[mounting.normal])
    except RangeError as e:
        raise InputError(f"limits: {e}") from e
    limits.check_sensor(force)


def open_part(
    role: Role, part: StagePart | ForcePart | CameraPart, clock: Clock, position: PositionFrom = "stored"
) -> Any:
    """Open a part's device: a force sensor behind the factor of its `scale`, a stage by `PositionFrom`."""
    if isinstance(part, GrblPart | MarlinPart):
        return part.open(clock, position=position)
    if isinstance(part, PluginPart):
        device = open_device(role, part.kind, part.options, clock)
    else:
        device = part.open(clock)
    scale = getattr(part, "scale", 1.0) if role == "force" else 1.0
    return device if scale == 1.0 else ScaledForce(device, scale)


def _follows(part: StagePart | ForcePart | CameraPart | None) -> bool:
    """Whether a part is a virtual device that follows the stage."""
    return isinstance(part, FollowingPart)


def follow_stage(role: Literal["force", "camera"], file: RigFile, stage: Stage, clock: Clock) -> Any:
    """Open a virtual force sensor or camera that follows a rig's stage."""
    part = getattr(file, role)
    assert isinstance(part, FollowingPart)
    return part.follow(role, stage, file.design, metres(file.origin_mm), clock)


def _opened(role: Role, part: StagePart | ForcePart | CameraPart, clock: Clock, opened: ExitStack) -> Any:
    """Open a part's device, to be closed again with what else is open."""
    device = open_part(role, part, clock)
    opened.callback(device.close)
    return device


def _opened_stage(part: StagePart, clock: Clock, opened: ExitStack, position: PositionFrom) -> Stage:
    stage: Stage = open_part("stage", part, clock, position)
    opened.callback(stage.close)
    return stage


def _virtual(file: RigFile, part: VirtualPart) -> Rig:
    from palpate.rig.virtual.disturbances import Fault
    from palpate.rig.virtual.virtual_bench import REAL_TIME_AGE_S, virtual_rig

    clock: Clock = MonotonicClock() if part.real_time else ManualClock()
    rig = virtual_rig(
        file.design,
        clock=clock,
        seed=part.seed,
        faults=[Fault(one.kind, one.after_s) for one in part.faults],
        limits=None if file.limits is None else file.limits.limits(),
        age_s=REAL_TIME_AGE_S if part.real_time else None,
        askew_m=metres(part.askew_mm),
    )
    _check_range(rig)
    regions = _regions(file) or rig.regions
    return replace(rig, name=f"{file.name}, {rig.name}", regions=regions, **_stated(file))


def _stated(file: RigFile) -> dict[str, Any]:
    """Fields of a rig that its file states and no device gives."""
    weighed = file.known_weight
    return {
        "retries": file.retries.limits(),
        "stiffness": {part.indenter: part.range() for part in file.stiffness},
        "weighed_on": "" if weighed is None else weighed.measured_on.isoformat(),
    }


def _check_range(rig: Rig) -> None:
    """Refuse a limit of force that the rig's sensor cannot measure."""
    try:
        rig.limits.check_range(rig.force.range_n[rig.mounting.normal])
    except RangeError as e:
        raise InputError(f"limits.force_N: {e}") from e


def _regions(file: RigFile) -> tuple[Region, ...]:
    return tuple(Region(one.name, one.box_px) for one in file.regions)


class ScaledForce:
    """A `palpate.core.ForceSensor` behind a factor; its range grows by the same.

    Args:
        sensor: what measures.
        scale: true force over the one that is read.
    """

    def __init__(self, sensor: ForceSensor, scale: float) -> None:
        self._sensor, self.scale = sensor, scale

    @property
    def rate_hz(self) -> float:
        return self._sensor.rate_hz

    @property
    def range_n(self) -> tuple[float, float, float]:
        x, y, z = (self.scale * force for force in self._sensor.range_n)
        return x, y, z

    def latest(self) -> Wrench:
        return self._scaled(self._sensor.latest())

    def drain(self) -> list[Wrench]:
        return [self._scaled(one) for one in self._sensor.drain()]

    def close(self) -> None:
        """Let go of the sensor."""
        self._sensor.close()

    def _scaled(self, sample: Wrench) -> Wrench:
        fx, fy, fz = (self.scale * force for force in sample.force_n)
        tx, ty, tz = (self.scale * torque for torque in sample.torque_nm)
        return replace(sample, force_n=(fx, fy, fz), torque_nm=(tx, ty, tz))
