"""Tables of a stage in a rig's file: how it is reached, how its place is found, how long it may take.

Tables of limits, of a virtual rig and of the picture's regions in a rig's file.
"""

from __future__ import annotations

import math
from contextlib import suppress
from datetime import date
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, model_validator

from palpate.core import Clock, DeviceError, InputError, RangeError, Stage
from palpate.devices import Limits
from palpate.devices.device_plugins import MM, Host, Part, Three, check_above, check_below, metres
from palpate.devices.force_trust import StiffnessRange
from palpate.rig.plans.press_places import Positive
from palpate.rig.rig import RetryLimits
from palpate.rig.virtual.disturbances import Kind

if TYPE_CHECKING:
    from palpate.rig.real.grbl.grbl_stage import GrblStage
    from palpate.rig.real.marlin import MarlinStage
    from palpate.rig.real.ur_arm import UrArmSpec

PositionFrom = Literal["stored", "reference", "touch-off", "nowhere", "unchecked"]
"""Source of a stage's position when it is opened.

- "stored": The position of the last session, where `position_evidence` accepts it.
- "reference": The operator confirms that the stage stands at `reference`.
- "touch-off": A guarded search for the skin, from above its center; `opened_rig` carries it out.
- "nowhere": None; the stage may then only be stopped, lifted, or homed.
- "unchecked": None, and neither are the controller's scale and directions; it may then only be stopped.
"""

SAME_SCALE = 1e-3  # relative difference of steps per millimeter that is a rounding
Baud = Annotated[int, Field(ge=1200, le=4_000_000)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

MAX_STAGE: dict[str, float] = {
    "latency_s": 1.0,
    "queued_s": 1.0,
    "boot_s": 30.0,
    "reply_s": 30.0,
    "stop_s": 30.0,
    "home_s": 600.0,
    "top_speed_mm_s": 200.0,
}
"""Greatest values of a stage's times and of its top speed."""

MIN_STAGE: dict[str, float] = {
    "latency_s": 0.001,
    "queued_s": 0.001,
    "reply_s": 0.05,
    "stop_s": 0.05,
    "home_s": 1.0,
    "top_speed_mm_s": 0.1,
    "sudden_mm_s": 0.01,
}
"""Least values of them: no controller answers or stops sooner, and nothing is recorded more slowly."""

MAX_ARM: dict[str, float] = {
    "top_speed_mm_s": 250.0,
    "acceleration_mm_s2": 10_000.0,
    "stop_mm_s2": 10_000.0,
    "tilt_deg": 2.0,
    "rate_hz": 500.0,
}
"""Greatest values of an arm; its speed is that at which people may be near one (ISO 10218-1)."""

MIN_ARM: dict[str, float] = {"acceleration_mm_s2": 10.0, "stop_mm_s2": 100.0, "rate_hz": 50.0}
"""Least values of an arm: one that stops more gently runs on too far."""


class GrblPart(Part):
    """A GRBL stage: how its port is opened, how its place is found, and how long it may take.

    Attributes:
        baud, dtr: of the port; see `GrblSpec`.
        least_mm, greatest_mm: where it may be sent; needed where the stage has no switches.
        require_homed: refuse to move unless it was homed by its switches; False for a stage without any.
        reference: Position at which the operator may confirm that the stage stands (`--position reference`),
            never assumed: three numbers [mm], or "counts" for the controller's machine coordinates.
        home: run to the switches when the rig is opened, after the probe was lifted by force.
        steps_per_mm, direction_mask: $100 to $102, and $3, as the controller must have them; others are
            refused. Nothing moves without them.
        top_speed_mm_s, latency_s, boot_s, reply_s, stop_s, home_s: see `GrblSpec`; left out, its own.
    """

    kind: Literal["grbl"]
    port: str
    axes: tuple[str, str, str] = ("+X", "-Y", "-Z")
    latency_s: Positive = 0.05
    home: bool = False
    baud: Baud = 115200
    dtr: bool = False
    least_mm: Three | None = None
    greatest_mm: Three | None = None
    require_homed: bool = True
    reference: Literal["counts"] | Three | None = None
    steps_per_mm: Three | None = None
    direction_mask: Annotated[int, Field(ge=0, le=7)] | None = None
    top_speed_mm_s: Positive | None = None
    boot_s: NotNegative | None = None
    reply_s: Positive | None = None
    stop_s: Positive | None = None
    home_s: Positive | None = None

    @model_validator(mode="after")
    def _fits(self) -> GrblPart:
        check_below(MAX_STAGE, self)
        check_above(MIN_STAGE, self)
        if self.home and not self.require_homed:
            raise ValueError("home = true needs switches, and require_homed = false says there are none")
        return self

    def open(self, clock: Clock, *, position: PositionFrom = "stored") -> Stage:
        """Open the stage, which does not move, and take its position from where it is said to be found."""
        from palpate.rig.real.grbl.grbl_stage import GrblStage
        from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

        spec = GrblSpec(
            self.port,
            baud=self.baud,
            dtr=self.dtr,
            axes=self.axes,
            latency_s=self.latency_s,
            require_homed=self.require_homed,
            **_box(self),
            **_given(self, "boot_s", "reply_s", "stop_s", "home_s"),
        )
        stage = GrblStage.open(spec, clock)
        return _placed(stage, self, position)


class MarlinPart(Part):
    """A stage on Marlin, as 3-D printers have them.

    Attributes:
        least_mm, greatest_mm: where it may be sent; needed where it is not homed.
        reference: Position at which the operator may confirm that the stage stands (`--position reference`)
            [mm]. It is never assumed.
        home: run to the switches when the rig is opened, after the probe was lifted by force.
        steps_per_mm: M92 X, Y, Z, as the controller must count; another scale is refused. Nothing moves
            without it.
        sudden_mm_s: fastest speed from which it stops dead without losing steps; left out, its jerk (M205).
        top_speed_mm_s, latency_s, queued_s, boot_s, reply_s, stop_s, home_s: see `MarlinSpec`; left out, its
            own.
    """

    kind: Literal["marlin"]
    port: str
    baud: Baud = 115200
    axes: tuple[str, str, str] = ("+X", "-Y", "-Z")
    least_mm: Three | None = None
    greatest_mm: Three | None = None
    reference: Three | None = None
    home: bool = False
    steps_per_mm: Three | None = None
    sudden_mm_s: Positive | None = None
    top_speed_mm_s: Positive | None = None
    latency_s: Positive | None = None
    queued_s: Positive | None = None
    dtr: bool = False
    boot_s: NotNegative | None = None
    reply_s: Positive | None = None
    stop_s: Positive | None = None
    home_s: Positive | None = None

    @model_validator(mode="after")
    def _fits(self) -> MarlinPart:
        check_below(MAX_STAGE, self)
        check_above(MIN_STAGE, self)
        if self.home and self.reference is not None:
            raise ValueError("home = true and reference are both given; leave one out")
        return self

    def open(self, clock: Clock, *, position: PositionFrom = "stored") -> Stage:
        """Open the stage, which does not move, and take its position from where it is said to be found."""
        from palpate.rig.real.marlin import MarlinSpec, MarlinStage

        spec = MarlinSpec(
            self.port,
            baud=self.baud,
            dtr=self.dtr,
            axes=self.axes,
            sudden_m_s=None if self.sudden_mm_s is None else self.sudden_mm_s * MM,
            **_box(self),
            **_given(self, "latency_s", "queued_s", "boot_s", "reply_s", "stop_s", "home_s"),
        )
        stage = MarlinStage.open(spec, clock)
        return _placed(stage, self, position)


class UrArmPart(Part):
    """A Universal Robots arm that carries the probe; it needs no homing, and opening it moves nothing.

    Attributes:
        host: name or address of its controller.
        rotation: from the rig's frame to the arm's base, row by row: its columns are the rig's x, y and z in
            the base.
        zero_mm: the rig's zero in the arm's base [mm].
        tool_rotvec_rad: rotation vector of the tool in the base, as the pendant shows it; moves keep it.
        tilt_deg: by which the tool may be found out of it [degrees].
        least_mm, greatest_mm: where it may be sent, in the rig's frame [mm].
        top_speed_mm_s: fastest that is allowed [mm/s].
        acceleration_mm_s2: at which a move begins and ends [mm/s^2].
        stop_mm_s2: at which a stop slows down [mm/s^2].
        latency_s, rate_hz, stop_s: see `UrArmSpec`.
    """

    kind: Literal["ur-arm"]
    host: Host
    rotation: tuple[Three, Three, Three]
    zero_mm: Three
    tool_rotvec_rad: Three
    least_mm: Three
    greatest_mm: Three
    tilt_deg: Positive = 0.5
    top_speed_mm_s: Positive = 50.0
    acceleration_mm_s2: Positive = 500.0
    stop_mm_s2: Positive = 1000.0
    latency_s: Positive = 0.05
    rate_hz: Positive = 125.0
    stop_s: Positive = 5.0

    @model_validator(mode="after")
    def _fits(self) -> UrArmPart:
        check_below(MAX_STAGE | MAX_ARM, self)
        check_above(MIN_STAGE | MIN_ARM, self)
        try:
            self.spec()  # its own checks: of the rotation, above all
        except (InputError, RangeError) as e:
            raise ValueError(str(e)) from e
        return self

    def spec(self) -> UrArmSpec:
        """Specification of the arm, in SI."""
        from palpate.rig.real.ur_arm import ArmFrame, UrArmSpec

        return UrArmSpec(
            self.host,
            ArmFrame(self.rotation, metres(self.zero_mm), self.tool_rotvec_rad),
            least_m=metres(self.least_mm),
            greatest_m=metres(self.greatest_mm),
            top_speed_m_s=self.top_speed_mm_s * MM,
            acceleration_m_s2=self.acceleration_mm_s2 * MM,
            stop_m_s2=self.stop_mm_s2 * MM,
            latency_s=self.latency_s,
            tilt_deg=self.tilt_deg,
            rate_hz=self.rate_hz,
            stop_s=self.stop_s,
        )

    def open(self, clock: Clock) -> Stage:
        """Open the stage; it does not move."""
        from palpate.rig.real.ur_arm import UrArmStage

        return UrArmStage.open(self.spec(), clock)


def _box(part: GrblPart | MarlinPart) -> dict[str, Any]:
    """Where a stage may be sent, and how fast."""
    return {
        "least_m": None if part.least_mm is None else metres(part.least_mm),
        "greatest_m": None if part.greatest_mm is None else metres(part.greatest_mm),
        "top_speed_m_s": None if part.top_speed_mm_s is None else part.top_speed_mm_s * MM,
        "frame": f"{part.reference} {part.least_mm} {part.greatest_mm}",
    }


def _given(part: GrblPart | MarlinPart, *names: str) -> dict[str, Any]:
    """The fields that the file states."""
    return {name: value for name in names if (value := getattr(part, name)) is not None}


def _placed(
    stage: GrblStage | MarlinStage, part: GrblPart | MarlinPart, position: PositionFrom
) -> GrblStage | MarlinStage:
    """Take the stage's position; the stage is closed where that fails."""
    try:
        if position != "unchecked":
            _check_scale(stage, part)
            _check_directions(stage, part)
        if position == "reference":
            stage.reference(_confirmed_m(part))
        elif position == "stored":
            with suppress(DeviceError):
                stage.recall()
    except BaseException:
        stage.close()
        raise
    return stage


def _check_scale(stage: GrblStage | MarlinStage, part: GrblPart | MarlinPart) -> None:
    """Refuse a controller that counts other steps per millimeter than the rig's file states."""
    found, stated = stage.steps_per_mm, part.steps_per_mm
    mask = getattr(stage, "direction_mask", None)
    if stated is None or (mask is not None and getattr(part, "direction_mask", None) is None):
        counted = f"steps_per_mm = [{', '.join(f'{steps:g}' for steps in found)}]"
        raise InputError(
            "the rig's file does not state the controller's scale and directions, so that a change of them "
            f"would go unseen; after a look at the machine, add {counted}"
            + ("" if mask is None else f" and direction_mask = {mask}")
            + " under [stage]",
            code="scale-not-stated",
        )
    if all(math.isclose(a, b, rel_tol=SAME_SCALE) for a, b in zip(found, stated, strict=True)):
        return
    found_text, stated_text = (", ".join(f"{steps:g}" for steps in three) for three in (found, stated))
    raise DeviceError(
        f"the controller counts {found_text} steps per mm along its X, Y, and Z, and the rig's file states "
        f"{stated_text}: distances and speeds would be wrong by as much. Correct the controller ($100 to "
        "$102, or M92), or steps_per_mm under [stage] where the machine was changed"
    )


def _check_directions(stage: GrblStage | MarlinStage, part: GrblPart | MarlinPart) -> None:
    """Refuse a controller whose axes run in other directions than the rig's file states."""
    stated = getattr(part, "direction_mask", None)
    if stated is None or (found := getattr(stage, "direction_mask", stated)) == stated:
        return
    raise DeviceError(
        f"the controller's direction mask ($3) is {found}, and the rig's file states {stated}: an axis would "
        "run the other way, perhaps into the skin. Correct $3, or direction_mask under [stage] where the "
        "machine was changed"
    )


def _confirmed_m(part: GrblPart | MarlinPart) -> Any:
    """Return the position that the operator confirms; None for the controller's own coordinates."""
    if part.reference is None:
        raise InputError(
            "--position reference needs the position in the rig's file; add reference = [x, y, z] [mm] under "
            "[stage]"
        )
    return None if part.reference == "counts" else metres(part.reference)


MAX_LIMITS: dict[str, float] = {
    "force_N": 50.0,
    "force_rate_N_s": 5000.0,
    "age_s": 0.5,
    "force_latency_s": 0.1,
    "overshoot_mm": 1.0,
    "step_mm": 1.0,
}
"""Greatest limits that a rig's file may state: beyond them a limit guards nothing on a soft skin."""

MIN_LIMITS: dict[str, float] = {
    "force_N": 0.01,
    "force_rate_N_s": 1.0,
    "age_s": 0.001,
    "force_latency_s": 1e-5,
    "overshoot_mm": 0.001,
    "step_mm": 0.01,
}
"""Least limits: below them nothing is ever recorded, since each motion is endless or refused."""


class LimitsPart(Part):
    """Limits of position, force and speed, in millimetres and newtons."""

    least_mm: Three
    greatest_mm: Three
    force_N: Positive = 20.0  # noqa: N815 - the unit is part of the name
    force_rate_N_s: Positive = 400.0  # noqa: N815
    age_s: Positive = 0.1
    force_latency_s: Positive = 0.01
    overshoot_mm: Positive = 0.1
    step_mm: Positive = 0.2

    @model_validator(mode="after")
    def _allowed(self) -> LimitsPart:
        check_below(MAX_LIMITS, self)
        check_above(MIN_LIMITS, self)
        return self

    def limits(self) -> Limits:
        """Convert to SI."""
        return Limits(
            metres(self.least_mm),
            metres(self.greatest_mm),
            force_n=self.force_N,
            force_rate_n_s=self.force_rate_N_s,
            age_s=self.age_s,
            force_latency_s=self.force_latency_s,
            overshoot_m=self.overshoot_mm * MM,
            step_m=self.step_mm * MM,
        )


class RetriesPart(Part):
    """Number of times that presses are repeated after a transient fault. See `RetryLimits`."""

    per_press: Annotated[int, Field(ge=0, le=100)] = 3
    per_session: Annotated[int, Field(ge=0, le=10_000)] = 20
    wait_s: Annotated[float, Field(ge=0, le=600, allow_inf_nan=False)] = 1.0

    def limits(self) -> RetryLimits:
        """Return the limits."""
        return RetryLimits(self.per_press, self.per_session, self.wait_s)


class StiffnessPart(Part):
    """Range of stiffness that an indenter meets on this skin, over the normal force. See `StiffnessRange`."""

    indenter: Annotated[str, Field(min_length=1, max_length=100)]
    force_N: tuple[Positive, ...]  # noqa: N815 - the unit is part of the name
    least_N_mm: tuple[Positive, ...]  # noqa: N815
    greatest_N_mm: tuple[Positive, ...]  # noqa: N815
    measured_on: date | None = None

    @model_validator(mode="after")
    def _allowed(self) -> StiffnessPart:
        self.range()
        return self

    def range(self) -> StiffnessRange:
        """Convert to SI."""
        per_m = 1 / MM
        least, greatest = (tuple(n * per_m for n in one) for one in (self.least_N_mm, self.greatest_N_mm))
        try:
            return StiffnessRange(self.force_N, least, greatest)
        except RangeError as e:
            raise ValueError(str(e)) from e


class KnownWeightPart(Part):
    """Known weight that was laid on the force sensor, and when; `factor` is its force over the one read."""

    measured_on: date
    mass_g: Positive
    factor: Positive = 1.0


class FaultPart(Part):
    """Fault of a virtual rig, from so many seconds on."""

    kind: Kind
    after_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0


class VirtualPart(Part):
    """A virtual rig, with what goes wrong on it; `askew_mm` is where its skin lies from the origin."""

    seed: Annotated[int, Field(ge=0)] = 0
    askew_mm: Three = (0.0, 0.0, 0.0)
    real_time: bool = False
    faults: tuple[FaultPart, ...] = ()


class RegionPart(Part):
    """A part of the picture that matters, such as "fringes", for the operator's page."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    box_px: tuple[int, int, int, int]

    @model_validator(mode="after")
    def _lies_in_a_picture(self) -> RegionPart:
        x, y, width, height = self.box_px
        if x < 0 or y < 0 or width < 1 or height < 1:
            raise ValueError(
                f"box_px of {self.name!r} is {list(self.box_px)}: x, y, width and height [px]; give x and y "
                "of 0 or more, and width and height of 1 or more"
            )
        return self
