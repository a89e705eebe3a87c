"""A rig by its name or its file, for the process that holds it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from palpate.core import Clock, ManualClock, MonotonicClock
from palpate.rig.rig import Rig
from palpate.rig.rig_file import PositionFrom, is_virtual, read_rig, rig_from, sensor_named
from palpate.rig.virtual.virtual_bench import REAL_TIME_AGE_S, virtual_rig


@dataclass(frozen=True, slots=True)
class ServedRig:
    """A rig and how to watch it.

    Attributes:
        rig: its devices.
        real_time: time passes by itself; otherwise only as the rig asks for it.
    """

    rig: Rig
    real_time: bool = True


def open_served_rig(name: str, *, accelerated: bool = False, position: PositionFrom = "stored") -> ServedRig:
    """Open a rig.

    Args:
        name: "virtual:" and a sensor's name, or the path of a rig's file.
        accelerated: let the virtual rig's time run as fast as the machine can; a file says so itself.
        position: Source of the stage's position, see `PositionFrom`.
    """
    if not is_virtual(name):
        file = read_rig(Path(name))
        return ServedRig(
            rig_from(file, name=rig_name(name), position=position),
            file.virtual is None or file.virtual.real_time,
        )
    clock: Clock = ManualClock() if accelerated else MonotonicClock()
    rig = virtual_rig(sensor_named(name), clock=clock, age_s=REAL_TIME_AGE_S)
    return ServedRig(rig, not accelerated)


def rig_name(rig: str) -> str:
    """Name a rig as its process does: by its name, or its file's whole path."""
    if is_virtual(rig):
        sensor_named(rig)
        return rig
    read_rig(Path(rig))
    return str(Path(rig).resolve())
