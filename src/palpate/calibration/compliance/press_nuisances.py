"""Nuisances of a press: stated sizes, and the press as it would be recorded with each.

Reading the altered press gives the change that the interval contains (propagation of uncertainty, JCGM
100:2008, section 5).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from palpate.core import Float, InputError, RangeError, ndarray
from palpate.estimators.compliance.pin_press import PinPress

# names in files and commands, with field and unit factor
AT_EDGE = {
    "force_bias_N": ("force_bias_n", 1.0),
    "force_gain": ("force_gain", 1.0),
    "late_ms": ("late_s", 1e3),
    "lever": ("lever", 1.0),
    "frame_yield_mm_per_N": ("frame_yield_m_n", 1e3),
}


@dataclass(frozen=True)
class Nuisances:
    """Standard sizes of unseen differences between calibration and press; 0 for none.

    Attributes:
        force_bias_n: force zero [N].
        force_gain: relative force scale.
        late_s: delay of frames after force [s].
        lever: relative scale of all pins' motion: pin length, camera height, zoom.
        frame_yield_m_n: compliance of the frame between tip and encoder [m/N].
    """

    force_bias_n: float = 0.05
    force_gain: float = 0.02
    late_s: float = 0.01
    lever: float = 0.02
    frame_yield_m_n: float = 2e-5

    def __post_init__(self) -> None:
        for one in fields(self):
            if not 0 <= getattr(self, one.name) < np.inf:
                raise RangeError(
                    f"{one.name} of {getattr(self, one.name)}; a standard size is 0 or more and finite"
                )

    @classmethod
    def named(cls, words: Sequence[str]) -> Nuisances:
        """Return the standard sizes but for those named, as in "lever=0.01" or "late_ms=0"."""
        sizes = {}
        for one in words:
            name, _, size = one.partition("=")
            if name not in AT_EDGE:
                raise InputError(
                    f"a nuisance {one!r}; write NAME=SIZE, and NAME is one of {', '.join(AT_EDGE)}"
                )
            field, units = AT_EDGE[name]
            try:
                sizes[field] = float(size) / units
            except ValueError as e:
                raise InputError(f"{one!r} has no number after its name, such as {name}=0") from e
        return cls(**sizes)

    def at_edge(self) -> dict[str, float]:
        """The sizes in the units of files and commands, which stand in their names."""
        return {name: units * getattr(self, field) for name, (field, units) in AT_EDGE.items()}

    def altered(self, press: PinPress) -> dict[str, PinPress]:
        """Return the press with each nuisance of nonzero size, by its name; without times or positions,
        fewer.
        """
        return {
            name: alter(press, getattr(self, name))
            for name, alter in ALTER.items()
            if getattr(self, name) > 0
        }


NONE = Nuisances(0.0, 0.0, 0.0, 0.0, 0.0)  # for presses on the same bench as the calibration's


def _biased(press: PinPress, bias_n: float) -> PinPress:
    return replace(press, force_n=press.force_n + bias_n)


def _scaled_force(press: PinPress, gain: float) -> PinPress:
    return replace(press, force_n=press.force_n * (1 + gain))


def _late(press: PinPress, late_s: float) -> PinPress:
    """Frames late by a time: what each shows belongs to the force and the position of that time before."""
    time_s = press.time_s
    if time_s is None:
        return press

    def ahead(values: Float[ndarray, " f"]) -> Float[ndarray, " f"]:
        return values + late_s * np.gradient(values, time_s)

    position = None if press.position_m is None else ahead(press.position_m)
    return replace(press, force_n=ahead(press.force_n), position_m=position)


def _scaled_motion(press: PinPress, lever: float) -> PinPress:
    return replace(press, moved_px=press.moved_px * (1 + lever))


def _yielding(press: PinPress, yield_m_n: float) -> PinPress:
    if press.position_m is None:
        return press
    return replace(press, position_m=press.position_m + yield_m_n * press.force_n)


ALTER: Mapping[str, Callable[[PinPress, float], PinPress]] = {
    "force_bias_n": _biased,
    "force_gain": _scaled_force,
    "late_s": _late,
    "lever": _scaled_motion,
    "frame_yield_m_n": _yielding,
}
