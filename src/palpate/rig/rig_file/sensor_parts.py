"""Tables of force sensors, cameras and plug-ins in a rig's file."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from palpate.core import Clock, ForceSensor, FrameSource, InputError, Position, Stage
from palpate.devices.device_plugins import Host, Part, Three, check_above, check_below, metres
from palpate.rig.plans.press_places import Positive
from palpate.rig.rig_file.stage_parts import MAX_LIMITS, MIN_LIMITS

Scale = Annotated[float, Field(ge=0.1, le=10.0, allow_inf_nan=False)]
"""Factor that a known weight gave: a true force over the one that is read."""


class NetFTPart(Part):
    """An ATI Net F/T box; `axes` says which of its axes are the skin's, and their signs.

    `scale` is what all its forces and torques are multiplied by, from a known weight, and
    `scale_uncertainty` the half-width of that factor, for 95 %.
    """

    kind: Literal["netft"]
    host: Host
    axes: tuple[str, str, str] = ("x", "y", "z")
    rdt_port: Annotated[int, Field(ge=1, le=65535)] = 49152
    http_port: Annotated[int, Field(ge=1, le=65535)] = 80
    silence_s: Positive = 0.1
    scale: Scale = 1.0
    scale_uncertainty: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None

    def open(self, clock: Clock) -> ForceSensor:
        """Open the force sensor."""
        from palpate.rig.real.netft.netft_sensor import NetFT, NetFTSettings

        settings = NetFTSettings(rdt_port=self.rdt_port, http_port=self.http_port, silence_s=self.silence_s)
        return NetFT(self.host, settings, clock)

    @model_validator(mode="after")
    def _allowed(self) -> NetFTPart:
        check_below({"silence_s": MAX_LIMITS["age_s"]}, self)
        check_above({"silence_s": MIN_LIMITS["age_s"]}, self)
        return self


class SerialScalePart(Part):
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


class ResenseHexPart(Part):
    """A six-axis HEX sensor on a serial line; range and rate as its data sheet and its lights say."""

    kind: Literal["resense-hex"]
    port: str
    range_N: Positive  # noqa: N815
    range_Nm: Positive  # noqa: N815
    axes: tuple[str, str, str] = ("x", "y", "z")
    rate_hz: Positive = 1000.0
    scale: Scale = 1.0
    scale_uncertainty: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None

    def open(self, clock: Clock) -> ForceSensor:
        """Open the force sensor."""
        from palpate.rig.real.resense import HexSensor, HexSpec

        return HexSensor.open(HexSpec(self.port, self.range_N, self.range_Nm, self.rate_hz), clock)


class UvcPart(Part):
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


class FollowingPart(Part):
    """A virtual force sensor or camera beside a real stage, which follows the stage's place.

    It feels or shows the skin of the file's `design`, `askew_mm` from where it is expected; devices of one
    `seed` have the same skin. To try a stage, or a simulator of its firmware, with a whole plan.
    """

    kind: Literal["virtual"]
    seed: Annotated[int, Field(ge=0)] = 0
    askew_mm: Three = (0.0, 0.0, 0.0)
    axes: tuple[str, str, str] = ("x", "y", "z")

    def follow(
        self, role: Literal["force", "camera"], stage: Stage, design: str, origin_m: Position, clock: Clock
    ) -> Any:
        """Open the force sensor or the camera.

        Args:
            role: which of them.
            stage: that it follows; whoever opened it closes it.
            design: name of the sensor's design.
            origin_m: expected surface of the skin, in the stage's frame [m].
            clock: time.
        """
        from palpate.rig.virtual.virtual_bench import FollowedWorld
        from palpate.rig.virtual.virtual_sensors import VirtualCamera, VirtualForce

        world = FollowedWorld(stage, design, clock, origin_m, self.seed, metres(self.askew_mm))
        return VirtualForce(world) if role == "force" else VirtualCamera(world)

    def open(self, clock: Clock) -> Any:
        """Refuse: there is no stage to follow."""
        raise InputError(
            'kind = "virtual" follows the rig\'s own stage, and there is none here; give it under [force] or '
            "[camera] of a rig whose file names a [stage], or use [virtual] for a whole rig that is not there"
        )


class PluginPart(BaseModel):
    """A device by the name of its class or entry point; all other fields are its options."""

    model_config = ConfigDict(frozen=True, extra="allow")
    kind: Annotated[str, Field(min_length=1, max_length=200)]

    @property
    def options(self) -> dict[str, Any]:
        """Options that it is opened with."""
        return dict(self.model_extra or {})


class ForcePluginPart(PluginPart):
    """A force sensor by the name of its class; `axes` is how it is mounted, `scale` as with a Net F/T."""

    axes: tuple[str, str, str] = ("x", "y", "z")
    scale: Scale = 1.0
    scale_uncertainty: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
