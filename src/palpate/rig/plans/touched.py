"""Find contact at each place and go no deeper: where the skin lies."""

from __future__ import annotations

from typing import Literal

from palpate.rig.plans.places import Positive
from palpate.rig.plans.plan import Count, Plan, Press
from palpate.rig.plans.steps import Burst, Done, Over, Seek, Shot, Steps, Tare

MM = 1e-3


class Touched(Plan):
    """At each place and cycle one search for contact, and a frame or more where it was found.

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
        """It goes no deeper than contact."""
        return 0.0

    def steps(self, press: Press, done: Done) -> Steps:
        """Over the place, the zero, contact, frames."""
        missing = self.missing(press, done)
        if not missing:
            return
        yield Over(press.place.x_mm * MM, press.place.y_mm * MM)
        yield Tare()
        for shot in [one for one in missing if one.phase == "reference"]:
            yield Burst(shot, missing.pop(shot))
        if missing:
            yield Seek()
        for shot, frames in missing.items():
            yield Burst(shot, frames)

    def _shots(self, press: Press) -> tuple[tuple[Shot, int], ...]:
        return ((Shot(self._named(press), press.cycle, "touch", 0), self.frames),)
