"""Tables of limits, of a virtual rig and of the picture's regions in a rig's file."""

from __future__ import annotations

from datetime import date
from typing import Annotated

from pydantic import Field, model_validator

from palpate.core import RangeError
from palpate.devices import Limits
from palpate.devices.file_fields import MM, Part, Three, check_above, check_below, metres
from palpate.devices.force_trust import StiffnessRange
from palpate.rig.plans.press_places import Positive
from palpate.rig.press_retries import RetryLimits
from palpate.rig.virtual.disturbances import Kind

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
