"""A rig by its name, and what of its picture matters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from palpate.core.clock import Clock, ManualClock, MonotonicClock
from palpate.core.errors import InputError
from palpate.rig.rig import Rig

FORCE_N = 35.0  # as the virtual rig's own
AGE_S = 0.5
"""Of a virtual rig's oldest force: it measures when it is asked to, on a machine that may have other work."""


class Region(NamedTuple):
    """A part of the picture.

    Attributes:
        name: such as "fringes".
        box_px: (x, y, width, height).
    """

    name: str
    box_px: tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Opened:
    """A rig and how to watch it.

    Attributes:
        rig: its devices.
        regions: of interest in its pictures.
        real_time: time passes by itself; otherwise only as the rig asks for it.
    """

    rig: Rig
    regions: tuple[Region, ...] = ()
    real_time: bool = True


def open_rig(name: str, *, accelerated: bool = False, seed: int = 0) -> Opened:
    """Open a rig.

    Args:
        name: "virtual:palm".
        accelerated: let the rig's time run as fast as the machine can.
        seed: of a virtual rig.

    Raises:
        InputError: there is no rig of that name.
    """
    if name != "virtual:palm":
        raise InputError(f"there is no rig {name!r}; there is virtual:palm")
    from palpate.rig.limits import Limits
    from palpate.rig.virtual.palm import FRAME_PX, TRAVEL, virtual_palm
    from palpate.sensors import palm

    spec = palm.cropped(palm.palm(), FRAME_PX, "palm-rig")
    clock: Clock = ManualClock() if accelerated else MonotonicClock()
    regions = (Region("fringes", spec.fringes.box_px), Region("mirror", spec.mirror.box_px))
    limits = Limits(TRAVEL.least_m, TRAVEL.greatest_m, force_n=FORCE_N, age_s=AGE_S)
    return Opened(virtual_palm(spec=spec, clock=clock, seed=seed, limits=limits), regions, not accelerated)
