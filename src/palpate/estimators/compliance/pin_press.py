"""Motion of the pins in one press: at every frame of the loading part, and at fixed forces.

Each pin's motion is fitted by a polynomial in the cube root of force, so that presses of any speed and frame
rate can be compared pin by pin.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice

import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Bool, Float, InputError, Int, RangeError, Shaped, ndarray
from palpate.estimators.compliance.stiffness_curve import CONTACT_N, loading, smoothed, within
from palpate.estimators.pins import PinTracks, find_pins, follow

UNTOUCHED_N = 0.06  # about one step of a 1/16 N sensor
STILL_PX = 0.3  # how much pins may wander before contact
LOST_SHARE = 0.2
MIN_FRAMES = 6
SATURATED = "the force ends in a plateau of {:g} N: the sensor's range has ended, and what follows is unknown"
LOST = "{} of {} pins were lost; look at light, focus and speed"
WANDERS = (
    "pins wander by {:.2g} px before contact (allowed: {:g} px): the camera, the sensor or the light moves; "
    "fix it and press again"
)

Samples = Float[ndarray, " s"]


@dataclass(frozen=True)
class PinPress:
    """Loading part of a press, one row for each frame.

    Attributes:
        frame: Frame numbers.
        force_n: Smoothed force [N].
        untouched_px: Pins before contact, (x, y) [px].
        moved_px: Motion of each pin since then; NaN if lost [px].
        position_m: Position of the tip relative to contact onset; None if unknown [m].
        speed_m_s: Speed of the tip; NaN without positions [m/s].
        flaws: Reasons to doubt the press; empty for a good one.
        cells: Lattice cell of each pin; None if unknown.
    """

    frame: Int[ndarray, " f"]
    force_n: Float[ndarray, " f"]
    untouched_px: Float[ndarray, "p 2"]
    moved_px: Float[ndarray, "f p 2"]
    position_m: Float[ndarray, " f"] | None
    speed_m_s: float
    flaws: tuple[str, ...]
    cells: Int[ndarray, "p 2"] | None = None
    time_s: Float[ndarray, " f"] | None = None


def follow_press(
    frames: Iterable[Shaped[ndarray, ...]],
    force_n: Samples,
    frame_sample: Int[ndarray, " f"],
    position_m: Samples | None = None,
    time_s: Samples | None = None,
) -> PinPress:
    """Follow the pins through the loading part of a press.

    Args:
        frames: 8-bit gray or color images in temporal order, the first before contact; read up to the
            greatest force.
        force_n: Raw samples, positive in compression [N].
        frame_sample: Index of each frame's sample.
        position_m: Tip position of each sample [m].
        time_s: Time of each sample [s].
    """
    found: list[PinTracks] = []

    def centres(used: Int[ndarray, " u"]) -> Float[ndarray, "f p 2"]:
        pins, xy = _pin_positions(frames, int(used[-1]) + 1)
        if len(xy) <= used[-1]:
            raise InputError(f"{len(xy)} frames, but {len(frame_sample)} in the table", code="frames-differ")
        found.append(pins)
        return xy

    press = press_of_centres(centres, force_n, frame_sample, position_m, time_s)
    return replace(press, cells=found[0].cells)


def press_of_centres(
    centres_px: Callable[[Int[ndarray, " u"]], Float[ndarray, "f p 2"]],
    force_n: Samples,
    frame_sample: Int[ndarray, " f"],
    position_m: Samples | None = None,
    time_s: Samples | None = None,
) -> PinPress:
    """Return the loading part of a press whose pin centers are known.

    Args:
        centres_px: Function of frame numbers that returns pin centers (x, y), NaN if lost [px].
        force_n, frame_sample, position_m, time_s: As of `follow_press`.
    """
    smooth = smoothed(force_n)
    part = loading(smooth)
    samples = within(smooth, part, CONTACT_N, np.inf)
    at = np.asarray(frame_sample)
    used = np.flatnonzero(np.isin(at, samples))
    if len(used) < MIN_FRAMES:
        raise InputError(
            f"{len(used)} frames of rising force above {CONTACT_N:g} N; {MIN_FRAMES} are needed: press more "
            "slowly",
            code="too-few-frames",
        )
    xy = centres_px(used)
    still = _still(smooth[at[: used[0] + 1]])
    untouched = xy[:still].mean(axis=0)
    lost = ~np.isfinite(xy[used]).all(axis=(0, 2))
    flaws = []
    if lost.mean() > LOST_SHARE:
        raise InputError(LOST.format(int(lost.sum()), len(lost)), code="pins-lost")
    if still > 1:
        wander = float(np.nanmax(np.ptp(np.nanmean(xy[:still], axis=1), axis=0)))
        if wander > STILL_PX:
            flaws.append(WANDERS.format(wander, STILL_PX))
    if part.saturated:
        flaws.append(SATURATED.format(smooth[part.last]))
    position = None if position_m is None else position_m[at[used]] - position_m[part.first]
    time = None if time_s is None else time_s[at[used]]
    return PinPress(
        used, smooth[at[used]], untouched, xy[used] - untouched, position,
        _speed(position, time), tuple(flaws), None, time,
    )  # fmt: skip


def _pin_positions(
    frames: Iterable[Shaped[ndarray, ...]], count: int
) -> tuple[PinTracks, Float[ndarray, "f p 2"]]:
    """Pins of the first frame, and their positions in every frame [px]."""
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise InputError("the sequence has no frame; a press has one before contact and several in it")
    pins = find_pins(first)
    return pins, np.stack([pins.xy_px, *(now.xy_px for now in follow(islice(frames, count - 1), pins))])


def _still(force_n: Samples) -> int:
    """Number of frames surely before contact: half of those without force."""
    touched = force_n >= UNTOUCHED_N
    before = int(np.argmax(touched)) if touched.any() else len(force_n)
    if before == 0:
        raise InputError(
            f"the first frame is under {force_n[0]:.3g} N; begin before contact, below {UNTOUCHED_N:g} N",
            code="first-frame-touched",
        )
    return max(1, before // 2)


def _speed(position_m: Samples | None, time_s: Samples | None) -> float:
    if position_m is None or time_s is None:
        return float("nan")
    return float((position_m[-1] - position_m[0]) / (time_s[-1] - time_s[0]))


DEGREE = 4
SPARE = 2  # frames more than the polynomial has coefficients
NEAR = 0.35  # of the pins' spacing: farther is another pin
MIN_MATCHED = 0.8
BEYOND_N = 0.15  # how far a level may lie outside the frames' forces

Levels = Float[ndarray, " l"]
Layout = Float[ndarray, "p 2"]


def at_forces(
    force_n: Float[ndarray, " f"], values: Float[ndarray, k * n], levels_n: Levels
) -> Float[ndarray, l * n]:
    """Return values that change smoothly with force at fixed forces `levels_n` [N]."""
    low, high = float(force_n.min()), float(force_n.max())
    if levels_n.min() < low - BEYOND_N or levels_n.max() > high + BEYOND_N:
        raise RangeError(
            f"frames from {low:.3g} to {high:.3g} N, not {levels_n.min():g} to {levels_n.max():g} N; press "
            "as far as the references",
            code="force-not-reached",
        )
    degree = min(DEGREE, len(force_n) - 1 - SPARE)
    fit, *_ = np.linalg.lstsq(_powers(force_n, high, degree), values.reshape(len(values), -1), rcond=None)
    return (_powers(levels_n, high, degree) @ fit).reshape(len(levels_n), *values.shape[1:])


def _powers(force_n: Float[ndarray, " f"], scale: float, degree: int) -> Float[ndarray, "f d"]:
    return np.vander(np.cbrt(force_n / scale), degree + 1, increasing=True)


def motion_on_layout(press: PinPress, layout_px: Layout) -> Float[ndarray, "f p 2"]:
    """Return the motion of a press's pins in the order of a layout; NaN for missing pins."""
    spacing = _spacing_px(np.ascontiguousarray(layout_px, np.float64).tobytes())
    if _in_order(press.untouched_px, layout_px, NEAR * spacing) and np.isfinite(press.moved_px).all():
        return press.moved_px
    tracked = np.isfinite(press.moved_px).all(axis=(0, 2))
    at = press.untouched_px[tracked]
    if not len(at):
        raise InputError("every pin is lost; look at light, focus and speed", code="pins-lost")
    # Hidden pins move the mean of those seen; then the camera as it stands, or the field's extent, is nearer.
    extent = [(xy.min(axis=0) + xy.max(axis=0)) / 2 for xy in (at, layout_px)]
    starts = at.mean(axis=0) - layout_px.mean(axis=0), extent[0] - extent[1], np.zeros(2)
    near, which = _matched(at, layout_px, starts[0], NEAR * spacing)
    if not near.all():
        found = [_matched(at, layout_px, start, NEAR * spacing) for start in starts]
        near, which = max(found, key=lambda one: one[0].sum())
    if near.mean() < MIN_MATCHED or len(at) > len(layout_px) / MIN_MATCHED:
        raise InputError(
            f"{int(near.sum())} of {len(layout_px)} calibrated pins match the {len(at)} found: another "
            "sensor, zoom, or crop; calibrate for it",
            code="layout-differs",
        )
    motion = np.full((len(press.force_n), len(layout_px), 2), np.nan)
    motion[:, near] = press.moved_px[:, tracked][:, which[near]]
    return motion


@lru_cache(maxsize=16)
def _spacing_px(layout: bytes) -> float:
    places = np.frombuffer(layout, np.float64).reshape(-1, 2)
    return float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))


def _in_order(at: Float[ndarray, "q 2"], layout_px: Layout, within_px: float) -> bool:
    """Whether pins match a layout one by one except for a common shift."""
    if at.shape != layout_px.shape:
        return False
    off = at - layout_px
    off = off - np.median(off, axis=0)
    return bool((np.hypot(*off.T) < within_px).all())  # False where one is NaN


def _matched(
    at: Float[ndarray, "q 2"], layout_px: Layout, shift: Float[ndarray, 2], within_px: float
) -> tuple[Bool[ndarray, " p"], Int[ndarray, " p"]]:
    """Which pins of a layout have a match, starting from a common shift, and which one."""
    for _ in range(3):
        gap, which = cKDTree(at - shift).query(layout_px)
        near = gap < within_px
        if near.any():
            shift = shift + np.median(at[which[near]] - shift - layout_px[near], axis=0)
    gap, which = cKDTree(at - shift).query(layout_px)
    return gap < within_px, which


SEAT_N = 4.0
MIN_PX = 0.05  # least scatter, that of the noise of centers


@dataclass(frozen=True)
class Seat:
    """Mounting misalignment by the mean motion of the pins, which is to one side away from the apex.

    Attributes:
        softness: Softness of the references, ascending (`stiffness_curve.softness`).
        mean_px: Mean over their trials, (x, y) [px].
        spread_px: Standard deviation of a trial along one axis [px].
    """

    softness: Float[ndarray, " k"]
    mean_px: Float[ndarray, "k 2"]
    spread_px: float

    def off(
        self, sideways_px: Float[ndarray, 2], s: float, altered_px: Sequence[Float[ndarray, 2]] = ()
    ) -> float:
        """Return the misalignment in standard deviations of the reference trials along one axis.

        Args:
            sideways_px: Mean motion of the pins [px].
            s: Softness of the specimen.
            altered_px: Mean motion under each nuisance of one standard deviation.
        """
        seat = [np.interp(s, self.softness, axis) for axis in self.mean_px.T]
        beside = (sideways_px - seat) / self.spread_px
        along = (np.reshape(altered_px, (-1, 2)) - sideways_px) / self.spread_px
        return float(np.sqrt(beside @ np.linalg.solve(np.eye(2) + along.T @ along, beside)))


def sideways_px(press: PinPress, layout_px: Float[ndarray, "p 2"]) -> Float[ndarray, 2]:
    """Return the mean motion of all pins at 4 N, (x, y) [px]."""
    mean = np.nanmean(motion_on_layout(press, layout_px), axis=1)
    return np.asarray(at_forces(press.force_n, mean, np.array([SEAT_N]))[0])


def fit_seat(softness: Float[ndarray, " k"], trials: Sequence[Float[ndarray, "_ 2"]]) -> Seat:
    """Fit to the mean motion of two or more trials of each reference."""
    order = np.argsort(softness)
    mean = np.stack([one.mean(axis=0) for one in trials])
    about = np.concatenate([one - m for one, m in zip(trials, mean, strict=True)])
    freedom = 2 * (len(about) - len(trials))
    spread = float(np.sqrt((about**2).sum() / freedom))
    return Seat(np.asarray(softness)[order], mean[order], max(spread, MIN_PX))
