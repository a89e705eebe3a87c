"""One press as its pins show it: how far each has moved at every force of the loading part."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError
from palpate.core.shapes import Float, Int, Shaped
from palpate.estimators.casr.force import CONTACT_N, loading, moving_average, within, without_spikes
from palpate.estimators.pins import find_pins, follow

UNTOUCHED_N = 0.06  # about one step of a 1/16 N sensor
STILL_PX = 0.3  # how much pins may wander before contact
LOST_SHARE = 0.2
LEAST_FRAMES = 6
SATURATED = "the force ends in a plateau of {:g} N: the sensor's range has ended, and what follows is unknown"
LOST = "{} of {} pins were lost; look at light, focus and speed"
WANDERS = (
    "pins wander by {:.2g} px before contact (allowed: {:g} px): the camera, the sensor or the light moves; "
    "fix it and press again"
)

Samples = Float[ndarray, " s"]


@dataclass(frozen=True)
class PinPress:
    """The loading part of a press, one row a frame.

    Attributes:
        frame: numbers of the frames.
        force_n: smoothed, at each frame [N].
        untouched_px: where the pins were before contact, (x, y) [px].
        moved_px: how far each has moved since; NaN where it is lost [px].
        position_m: of the tip, from where contact was felt; None where the table has none [m].
        speed_m_s: of the tip over these frames; NaN without a position [m/s].
        flaws: what makes the press doubtful, in words; empty for a good one.
    """

    frame: Int[ndarray, " f"]
    force_n: Float[ndarray, " f"]
    untouched_px: Float[ndarray, "p 2"]
    moved_px: Float[ndarray, "f p 2"]
    position_m: Float[ndarray, " f"] | None
    speed_m_s: float
    flaws: tuple[str, ...]


def watched(
    frames: Iterable[Shaped[ndarray, ...]],
    force_n: Samples,
    frame_sample: Int[ndarray, " f"],
    position_m: Samples | None = None,
    time_s: Samples | None = None,
    *,
    contact_n: float = CONTACT_N,
) -> PinPress:
    """Follow the pins through the loading part of a press.

    Args:
        frames: 8-bit grey images in time, the first before contact; read once, up to the greatest force.
        force_n: raw samples, positive in compression [N].
        frame_sample: of every frame, which sample it belongs to.
        position_m: of the tip, at every sample [m].
        time_s: of the samples, which give the speed [s].
        contact_n: force at which contact is felt [N].

    Raises:
        InputError: no loading part, too few frames in it, or pins lost.
        ImageError: no pins in the first frame.
    """
    smooth = moving_average(without_spikes(np.asarray(force_n, np.float64)))
    part = loading(smooth, contact_n)
    samples = within(smooth, part, contact_n, np.inf)
    at = np.asarray(frame_sample)
    used = np.flatnonzero(np.isin(at, samples))
    if len(used) < LEAST_FRAMES:
        raise InputError(
            f"{len(used)} frames of rising force above {contact_n:g} N; {LEAST_FRAMES} are needed: "
            "press more slowly, or take more frames a second"
        )
    xy = _followed(frames, int(used[-1]) + 1)
    if len(xy) <= used[-1]:
        raise InputError(
            f"{len(xy)} frames, and the table tells of {len(at)}; give the frames and the table of one press"
        )
    still = _still(smooth[at[: used[0] + 1]])
    untouched = xy[:still].mean(axis=0)
    lost = ~np.isfinite(xy[used]).all(axis=(0, 2))
    flaws = []
    if lost.mean() > LOST_SHARE:
        raise InputError(LOST.format(int(lost.sum()), len(lost)))
    if still > 1:
        wander = float(np.nanmax(np.ptp(np.nanmean(xy[:still], axis=1), axis=0)))
        if wander > STILL_PX:
            flaws.append(WANDERS.format(wander, STILL_PX))
    if part.saturated:
        flaws.append(SATURATED.format(smooth[part.last]))
    position = None if position_m is None else position_m[at[used]] - position_m[part.first]
    return PinPress(
        used, smooth[at[used]], untouched, xy[used] - untouched, position,
        _speed(position, None if time_s is None else time_s[at[used]]), tuple(flaws),
    )  # fmt: skip


def _followed(frames: Iterable[Shaped[ndarray, ...]], count: int) -> Float[ndarray, "f p 2"]:
    """Where the pins of the first frame are in every one."""
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise InputError("the sequence has no frame; a press has one before contact and several in it")
    pins = find_pins(first)
    return np.stack([pins.xy_px, *(now.xy_px for now in follow(islice(frames, count - 1), pins))])


def _still(force_n: Samples) -> int:
    """How many frames are before any touch, less the last of them, in which it may have begun."""
    touched = force_n >= UNTOUCHED_N
    before = int(np.argmax(touched)) if touched.any() else len(force_n)
    if before == 0:
        raise InputError(
            f"the first frame is under {force_n[0]:.3g} N; it must be taken before contact (below "
            f"{UNTOUCHED_N:g} N), since motion is counted from there: begin higher, or bias the force sensor"
        )
    return max(1, before - 1)


def _speed(position_m: Samples | None, time_s: Samples | None) -> float:
    if position_m is None or time_s is None:
        return float("nan")
    return float((position_m[-1] - position_m[0]) / (time_s[-1] - time_s[0]))
