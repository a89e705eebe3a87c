"""Kinds of recording plan: stepped presses with holds, ramps at one speed, and surface probes.

A ramp's sweep is one shot: frames of one that was interrupted belong to no shot, and it is done again from
the air.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from palpate.rig.plans.press_places import Positive, StepMm
from palpate.rig.plans.recording_plan import (
    LESS,
    MM,
    Aside,
    Burst,
    Count,
    Depth,
    Pause,
    PlannedPress,
    RecordingPlan,
    Seek,
    Shot,
    Steps,
    Sweep,
)

UM = 1000  # micrometres in a millimetre


class Lateral(BaseModel):
    """Controlled lateral load: at some depths the probe is shifted, in steps, in some directions.

    Attributes:
        depths_mm: of the press's own depths.
        to_mm: (x, y) shifts, each reached from the middle.
        steps: stands on the way to each.
        speed_mm_s: of the shift.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    depths_mm: Annotated[tuple[Positive, ...], Field(min_length=1)]
    to_mm: Annotated[tuple[tuple[float, float], ...], Field(min_length=1)]
    steps: Annotated[int, Field(ge=1, le=1000)] = 5
    speed_mm_s: Positive = 0.5

    def shifts_mm(self) -> tuple[tuple[float, float], ...]:
        """Lateral shifts at which it stands, in order."""
        return tuple(
            (x * i / self.steps, y * i / self.steps) for x, y in self.to_mm for i in range(1, self.steps + 1)
        )


class Dwell(BaseModel):
    """Stand long at some depths, to see the skin creep: frames spread over the time.

    Attributes:
        depths_mm: of the press's own depths.
        seconds: at each.
        frames: over that time.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    depths_mm: Annotated[tuple[Positive, ...], Field(min_length=1)]
    seconds: Positive
    frames: Annotated[int, Field(ge=2, le=1_000_000)] = 50


class StepHold(RecordingPlan):
    """Find contact, go down step by step, and record a burst at each depth.

    Attributes:
        depth_mm: of the deepest.
        step_mm: between depths.
        frames: at each depth.
        settle_s: between arriving and the first frame.
        unloading: record the way back up as well.
        lateral: shift the probe at some depths.
        dwell: stand long at some depths.
    """

    kind: Literal["stepped"] = "stepped"
    depth_mm: Positive = 5.0
    step_mm: StepMm = 0.1
    frames: Count = 25
    settle_s: LESS = 0.0
    unloading: bool = False
    lateral: Lateral | None = None
    dwell: Dwell | None = None

    @property
    def deepest_mm(self) -> float:
        """The greatest depth below a local zero."""
        return self.depth_mm

    def depths_um(self) -> tuple[int, ...]:
        """Depths from the first to the deepest, to the micrometre."""
        count = round(self.depth_mm / self.step_mm)
        return tuple(round(self.step_mm * i * UM) for i in range(1, max(1, count) + 1))

    def _own_steps(self, left: dict[Shot, tuple[int, ...]]) -> Steps:
        """Find contact, descend to the deepest shot that is missing, and record those that are."""
        yield Seek()
        up = any(shot.phase == "up" for shot in left)
        deepest = max(self.depths_um()) if up else max(shot.depth_um for shot in left)
        for depth in (d for d in self.depths_um() if d <= deepest):
            yield Depth(depth * 1e-6, self.press_mm_s * MM)
            yield from self._at(depth, False, left)
        for depth in (d for d in reversed(self.depths_um()[:-1]) if up):
            yield Depth(depth * 1e-6, self.press_mm_s * MM)
            yield from self._at(depth, True, left)

    def _at(self, depth_um: int, up: bool, left: dict[Shot, tuple[int, ...]]) -> Steps:
        here = {
            shot: frames
            for shot, frames in left.items()
            if shot.depth_um == depth_um and (shot.phase == "up") is up
        }
        if here and self.settle_s:
            yield Pause(self.settle_s)
        shifted = False
        for shot, frames in here.items():
            if shot.phase == "lateral" and self.lateral:
                x, y = self.lateral.shifts_mm()[shot.turn]
                if shot.turn % self.lateral.steps == 0 and shifted:
                    yield Aside(0.0, 0.0, self.lateral.speed_mm_s * MM)
                yield Aside(x * MM, y * MM, self.lateral.speed_mm_s * MM)
                shifted = True
            every = self.dwell.seconds / self.dwell.frames if shot.phase == "hold" and self.dwell else 0.0
            yield Burst(shot, frames, every)
        if shifted and self.lateral:
            yield Aside(0.0, 0.0, self.lateral.speed_mm_s * MM)

    def _shots(self, press: PlannedPress) -> tuple[tuple[Shot, int], ...]:
        place, depths = self._named(press), self.depths_um()
        shots: list[tuple[Shot, int]] = []
        for depth in depths:
            shots.append((Shot(place, press.cycle, "down", depth), self.frames))
            if self.dwell and depth in [round(d * UM) for d in self.dwell.depths_mm]:
                shots.append((Shot(place, press.cycle, "hold", depth), self.dwell.frames))
            if self.lateral and depth in [round(d * UM) for d in self.lateral.depths_mm]:
                turns = range(len(self.lateral.shifts_mm()))
                shots += [(Shot(place, press.cycle, "lateral", depth, i), self.frames) for i in turns]
        if self.unloading:
            shots += [(Shot(place, press.cycle, "up", depth), self.frames) for depth in reversed(depths[:-1])]
        return tuple(shots)


class Ramp(RecordingPlan):
    """Sweep from the clearance, one at each place and cycle.

    Attributes:
        speed_mm_s: down and up.
        until_N: force at which it turns round; None for at the depth alone.
        depth_mm: below the expected surface, at which it turns round at the latest.
        wait_s: after each sweep.
    """

    kind: Literal["swept"]
    speed_mm_s: Positive = 5.0
    until_N: Positive | None = None  # noqa: N815 - the unit is part of the name
    depth_mm: Positive = 5.0
    wait_s: LESS = 0.0
    reference_frames: int = 0

    @property
    def deepest_mm(self) -> float:
        """The greatest depth below the expected surface."""
        return self.depth_mm

    @property
    def pressed_mm(self) -> float:
        """None of it, where a force turns it round."""
        return self.depth_mm if self.until_N is None else 0.0

    def _own_steps(self, left: dict[Shot, tuple[int, ...]]) -> Steps:
        """The sweep, the wait."""
        for shot in left:
            yield Sweep(shot, self.speed_mm_s * MM, self.depth_mm * MM, self.until_N)
            yield Pause(self.wait_s)

    def _shots(self, press: PlannedPress) -> tuple[tuple[Shot, int], ...]:
        return ((Shot(self._named(press), press.cycle, "sweep", round(self.depth_mm * 1000)), 1),)


class SurfaceSearch(RecordingPlan):
    """Search for contact, one at each place and cycle, and a frame or more where it was found.

    Attributes:
        frames: at contact.
    """

    kind: Literal["touched"]
    cycles: Count = 1
    seek_mm: Positive = 3.0
    reference_frames: int = 0
    frames: Count = 1

    @property
    def deepest_mm(self) -> float:
        """Zero: it goes no deeper than contact."""
        return 0.0

    def _own_steps(self, left: dict[Shot, tuple[int, ...]]) -> Steps:
        """Contact, frames."""
        yield Seek()
        for shot, frames in left.items():
            yield Burst(shot, frames)

    def _shots(self, press: PlannedPress) -> tuple[tuple[Shot, int], ...]:
        return ((Shot(self._named(press), press.cycle, "touch", 0), self.frames),)
