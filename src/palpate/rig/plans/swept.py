"""Press at one speed to a force or a depth and back, recording all the while.

A sweep is one shot: frames of one that was interrupted belong to no shot, and it is done again from the air.
"""

from __future__ import annotations

from typing import Literal

from palpate.rig.plans.places import Positive
from palpate.rig.plans.plan import LESS, Plan, Press
from palpate.rig.plans.steps import Burst, Done, Over, Pause, Shot, Steps, Sweep, Tare

MM = 1e-3


class Swept(Plan):
    """At each place and cycle one sweep from the clearance.

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

    def steps(self, press: Press, done: Done) -> Steps:
        """Over the place, the zero, the sweep, the wait."""
        missing = self.missing(press, done)
        if not missing:
            return
        yield Over(press.place.x_mm * MM, press.place.y_mm * MM)
        yield Tare()
        for shot, frames in missing.items():
            if shot.phase == "reference":
                yield Burst(shot, frames)
            else:
                yield Sweep(shot, self.speed_mm_s * MM, self.depth_mm * MM, self.until_N)
                yield Pause(self.wait_s)

    def _shots(self, press: Press) -> tuple[tuple[Shot, int], ...]:
        return ((Shot(self._named(press), press.cycle, "sweep", round(self.depth_mm * 1000)), 1),)
