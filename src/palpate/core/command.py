"""A Command: what a device is told to do, its limits already applied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Command:
    """One set-point of a stage axis or a softness device.

    Attributes:
        device: which device it is for.
        axis: which of its axes or channels, e.g. ``z`` or ``pressure``.
        value: the set-point in `unit`, after limits.
        unit: SI symbol.
        limited: ``"no"``, or which limit cut the set-point that was asked for.
        time_s: when it takes effect, on the run's clock [s].
    """

    device: str
    axis: str
    value: float
    unit: str
    limited: Literal["no", "low", "high"] = "no"
    time_s: float = 0.0
