"""Disturbances of a virtual rig: faults by configuration, and how its presses differ.

A fault is of one kind, from one instant on. The variation of presses is seeded, each part with its size. The
incidental lateral forces are those of the palm's report, which records 0.07 and 0.29 N (standard deviation)
without any lateral load: here they come from a probe that is not quite upright, by a constant and by a part
that changes from press to press. The other sizes are assumed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from palpate.core import NS_PER_S, InputError

Kind = Literal[
    "force-stalls",  # no sample comes any more
    "force-saturates",  # the sensor says so, and its numbers mean nothing
    "force-gone",  # the device does not answer
    "force-spike",  # one sample of 1000 N
    "force-noisy",  # a hundred times the noise
    "force-reversed",  # the sign along z is the other one
    "force-stuck",  # it repeats the last sample, with stamps of its own
    "force-dead",  # all six axes read zero
    "force-numb",  # noise about the last force, which it does not follow any more
    "force-scaled",  # all it reads, noise and bias as well, is a tenth of what it was
    "force-held-back",  # samples are kept for 80 ms, and all come at once with the stamps of their arrival
    "force-slow",  # one sample in ten comes
    "stage-gone",  # the device does not answer; what was begun goes on
    "stage-stuck",  # it stands, and says that it moves
    "stage-slips",  # it loses 0.1 mm of every move
    "stage-deaf",  # it does not stop when told to
    "camera-gone",
    "camera-frozen",  # the same frame again and again
    "camera-resized",  # frames of another size
    "camera-stalls",  # no frame comes any more
    "camera-drops",  # every other frame is lost
    "layer-gone",  # there is nothing to touch
]


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault of one kind.

    Attributes:
        kind: which.
        after_s: on the rig's clock, from its start [s].
    """

    kind: Kind
    after_s: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InputError(f"no fault is called {self.kind!r}; there are {', '.join(get_args(Kind))}")


class Faults:
    """Faults of a rig, by their kind."""

    def __init__(self, faults: Sequence[Fault], begun_ns: int) -> None:
        self._from_ns: dict[str, int] = {}
        for fault in faults:
            at_ns = begun_ns + round(fault.after_s * NS_PER_S)
            self._from_ns[fault.kind] = min(at_ns, self._from_ns.get(fault.kind, at_ns))

    def on(self, kind: Kind, now_ns: int) -> bool:
        """Whether it has set in."""
        return kind in self._from_ns and now_ns >= self._from_ns[kind]

    def begin(self, kind: Kind, now_ns: int) -> None:
        """Let a fault set in now, unless it has already [ns]."""
        self._from_ns[kind] = min(now_ns, self._from_ns.get(kind, now_ns))

    def since(self, kind: Kind) -> int | None:
        """Time when it sets in [ns]; None where it never does."""
        return self._from_ns.get(kind)


@dataclass(frozen=True, slots=True)
class Variation:
    """Sizes of what varies.

    Attributes:
        seating_m: of the skin's height from press to press [m], standard deviation.
        place_m: of where the probe comes down, along x and y [m].
        tilt_rad: of the layer, about y and x [rad].
        lean, lean_spread: lateral force along x and y over the normal force: the constant part, and its
            standard deviation from press to press.
        lamp: relative change of the lamp from press to press.
        shift_px: of the whole image from press to press, along each axis [px], standard deviation.
        backlash_m: of the stage, each axis [m].
        force_noise_n: of a sample [N].
        force_drift_n: of the zero over a minute, a random walk [N].
        force_step_n: resolution [N].
        frame_jitter_s: of when a frame comes [s].
        relaxation: for each branch of the skin's memory, its share of the modulus and its time [s]. It also
            leaves a dent, which fades: a place that is pressed again soon is touched a little deeper.
    """

    seating_m: float = 0.02e-3
    place_m: float = 0.02e-3
    tilt_rad: tuple[float, float] = (0.002, -0.001)
    lean: tuple[float, float] = (0.007, 0.030)
    lean_spread: tuple[float, float] = (0.0055, 0.022)
    lamp: float = 0.01
    shift_px: float = 0.0
    backlash_m: float = 5e-6
    force_noise_n: float = 0.005
    force_drift_n: float = 0.01
    force_step_n: float = 1 / 320
    frame_jitter_s: float = 0.001
    relaxation: tuple[tuple[float, float], ...] = ((0.06, 0.2), (0.05, 5.0))

    @property
    def sample_noise_n(self) -> float:
        """Largest standard deviation of a force sample after rounding to the resolution [N].

        Rounding adds up to half a step where the mean lies halfway between two steps.
        """
        return math.hypot(self.force_noise_n, self.force_step_n / 2)


@dataclass(frozen=True, slots=True)
class Approach:
    """Variation of one approach of one place.

    Attributes:
        height_m: of the skin, downwards positive [m].
        aside_m: of the probe along x and y [m].
        lean: lateral over normal force, along x and y.
        lamp_gain: of the lamp, over that at set-up.
        shift_px: of the whole image, which is seen from the end of the press before.
    """

    height_m: float
    aside_m: tuple[float, float]
    lean: tuple[float, float]
    lamp_gain: float
    shift_px: tuple[float, float] = (0.0, 0.0)


def approach_of(variation: Variation, seed: int, x_m: float, y_m: float, visit: int) -> Approach:
    """The same for the same seed, place and visit, whatever else was recorded before."""
    place = [round(d * 1e6) & 0xFFFFFFFF for d in (x_m, y_m)]
    rng = np.random.default_rng([seed & 0xFFFFFFFF, *place, visit])
    height, ax, ay, lx, ly, lamp = rng.standard_normal(6).tolist()
    tilted = variation.tilt_rad[0] * x_m + variation.tilt_rad[1] * y_m
    return Approach(
        height_m=variation.seating_m * height + tilted,
        aside_m=(variation.place_m * ax, variation.place_m * ay),
        lean=(
            variation.lean[0] + variation.lean_spread[0] * lx,
            variation.lean[1] + variation.lean_spread[1] * ly,
        ),
        lamp_gain=1.0 + variation.lamp * lamp,
    )


def shift_of(variation: Variation, seed: int, presses: int) -> tuple[float, float]:
    """Shift of the whole image after so many presses [px]."""
    x, y = np.random.default_rng([seed & 0xFFFFFFFF, 0x5F, presses]).standard_normal(2).tolist()
    return variation.shift_px * x, variation.shift_px * y
