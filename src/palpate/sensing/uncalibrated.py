"""Marks in a skin and how far each has moved since the skin was untouched: pins, dots, bright or dark.

Pins and dots are found once in the untouched frame, on their lattice, which may take seconds, and followed
from frame to frame, in which each moves by less than half its distance to the next. Where many are lost, the
frame is searched whole and marks are named by their cell of the lattice.

Brightness of a frame over that of the untouched sensor, which a touch hardly moves.

Connected parts of what has changed: which is strong and large enough to be a touch, and its outlines.

What the mean square of smoothed noise is, around a place: its upper tail, and its share at an edge.

What lies still around a skin: tells a camera that has moved, or another light, from a touch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from scipy.optimize import brentq
from scipy.special import log_ndtr

from palpate.core import Bool, Float, Float32, ImageError, Int, Shaped, UInt8, ndarray
from palpate.estimators.lattice.dotted_skin import DottedSkin, find_dots
from palpate.estimators.pins import PinTracks, find_pins, follow, grey_frame

Box = tuple[int, int, int, int]

MIN_LIT = 8.0  # grey levels: darker pixels tell nothing of a change of brightness
SATURATED = 250.0  # grey levels
EVERY = 4  # pixel along each axis that tells it
MIN_PX = 12
MIN_GAIN, MAX_GAIN = 0.05, 20.0  # that is told


class BrightnessGain:
    """Median over lit pixels, each channel by itself.

    Args:
        mean: the untouched sensor ``[h w c]`` [grey levels].
        but: x, y, width and height of what does not tell it, as a part that a touch lights [px].
    """

    def __init__(self, mean: Shaped[ndarray, "h w c"], but: Box | None = None) -> None:
        lit = (mean > MIN_LIT) & (mean < SATURATED)
        if but is not None:
            x, y, wide, high = but
            lit[y : y + high, x : x + wide] = False
        lit = lit[::EVERY, ::EVERY]
        some = mean[::EVERY, ::EVERY]
        self._lit = [np.nonzero(lit[..., c]) for c in range(mean.shape[2])]
        self._levels = [some[..., c][which] for c, which in enumerate(self._lit)]

    def of(self, picture: Shaped[ndarray, "h w c"]) -> Float[ndarray, " c"]:
        """Brightness over the untouched sensor's; 1 where too little is lit."""
        some = picture[::EVERY, ::EVERY]
        pairs = ((some[..., c][which], self._levels[c]) for c, which in enumerate(self._lit))
        gains = [float(np.median(now / then)) if len(then) > MIN_PX else 1.0 for now, then in pairs]
        return np.clip(np.array(gains), MIN_GAIN, MAX_GAIN)


SECOND = 0.25  # of the largest part: smaller ones are not of the contact


def strongest_part(
    over: Bool[ndarray, "h w"], strong: Bool[ndarray, "h w"], energy: Float32[ndarray, "h w"]
) -> Bool[ndarray, "h w"] | None:
    """Connected part in which the most is strong; the largest where nothing is; None where all are specks.

    Args:
        strong: what of it differs as a touch does; fewer than twelve pixels count for none.
    """
    # The algorithm is named, since the usual one takes longer.
    count, label, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(
        over.view(np.uint8), 8, cv2.CV_32S, cv2.CCL_BBDT
    )
    size = boxes[:, cv2.CC_STAT_AREA].copy()
    size[0] = 0
    if size.max() < MIN_PX:
        return None
    of_strong = label[strong]
    weight = np.bincount(of_strong, energy[strong], count)
    weight[np.bincount(of_strong, minlength=count) < MIN_PX] = 0.0
    weight[0] = 0.0
    best = int(weight.argmax()) if weight.max() > 0 else int(size.argmax())
    return np.asarray(label == best)


def box_of(mask: Bool[ndarray, "h w"], margin: int) -> tuple[slice, slice]:
    """Rows and columns of what is set, with a margin."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(int(rows[0]) - margin, 0), min(int(rows[-1]) + 1 + margin, mask.shape[0])),
        slice(max(int(columns[0]) - margin, 0), min(int(columns[-1]) + 1 + margin, mask.shape[1])),
    )


def large_parts(mask: Bool[ndarray, "h w"]) -> list[Int[ndarray, "p 1 2"]]:
    """Outlines of the large connected parts of a mask."""
    outlines = outlines_of(mask.view(np.uint8))
    areas = np.array([cv2.contourArea(one) for one in outlines])
    large = areas >= SECOND * areas.max(initial=0.0)
    return [one for one, is_large in zip(outlines, large, strict=True) if is_large]


def outlines_of(mask: UInt8[ndarray, "h w"]) -> Sequence[Int[ndarray, "p 1 2"]]:
    """Outer outlines of the connected parts of a mask."""
    return cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]


def disc(radius: int) -> UInt8[ndarray, "h w"]:
    """A disc, for closing gaps."""
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def edge_share(sigma: float, spread: float) -> float:
    """Mean square at a straight edge over that inside, after smoothing by sigma and averaging over spread.

    The mean square of a normal distribution's integral at a normal variable, by Sheppard's formula.
    """
    correlation = spread**2 / (sigma**2 + spread**2)
    return 0.25 + math.asin(correlation) / (2 * math.pi)


def tail_weights(sigma: float, spread: float) -> Float[ndarray, " k"]:
    """Weights of the independent squares whose sum is the local mean square of smoothed noise.

    Noise is smoothed by a Gaussian of sigma, squared, and averaged by one of spread. Along each axis the
    weights are a geometric series, by Mehler's formula; their sum is 1.
    """
    root = sigma / math.hypot(sigma, math.sqrt(2) * spread)
    ratio = (1 - root) / (1 + root)
    series = (1 - ratio) * ratio ** np.arange(math.ceil(math.log(1e-3) / math.log(max(ratio, 1e-3))) + 1)
    weights = np.outer(series, series).ravel()
    return weights[weights > 1e-4 * weights.max()]


def upper_quantile(probability: float, weights: Float[ndarray, " k"], channels: int) -> float:
    """Value that a weighted sum of squares of normal variables exceeds with a probability, over the channels.

    Args:
        probability: below 0.5.
        weights: of the squares; their sum is about 1.
        channels: independent ones of which the mean is taken.

    Reference:
        Lugannani and Rice 1980, doi:10.2307/1426607; for such sums Kuonen 1999, doi:10.1093/biomet/86.4.929.
    """
    share = weights / channels

    def beyond(t: float) -> tuple[float, float]:
        """Value whose saddle point is t, and the logarithm of the probability of more."""
        left = 1 - 2 * share * t
        value = channels * float((share / left).sum())
        curvature = 2 * channels * float((share**2 / left**2).sum())
        cumulant = -channels / 2 * float(np.log(left).sum())
        w = math.sqrt(2 * (t * value - cumulant))
        v = t * math.sqrt(curvature)
        return value, float(log_ndtr(-(w + math.log(v / w) / w)))

    low, high = 1e-3 / (2 * share.max()), (1 - 1e-9) / (2 * share.max())
    t = brentq(lambda t: beyond(t)[1] - math.log(probability), low, high)
    return beyond(t)[0]


LOOKED_AT_PX = 640  # about the longer side of what is looked at: larger frames are averaged to it
MEAN_OF_THREE = np.full((1, 3), 1 / 3)
MAX_SHIFT_PX = 0.5  # of what lies still beside the skin
MIN_EXPLAINED = 0.5  # of the rim's difference, by a shift
MIN_SLOPE = 4.0  # grey levels a pixel: an edge
MIN_EDGE_PX = 200
MAX_CONDITION = 100.0  # of the edges' normal matrix: edges of both directions
EVERY_STILL = 16  # pixel of what lies still is looked at
RIM = 0.06  # of each side of the frame: what is taken to lie still
STILL_NOISES = 5.0  # by which what lies still differs, where it does
MIN_LIT_PX = 12


class StillSurround:
    """What lies beside the skin, and along the sides of the frame.

    Args:
        frames: 8-bit grey or RGB, of the untouched sensor.
        region: x, y, width and height of the skin [px].
    """

    def __init__(self, frames: Sequence[Shaped[ndarray, ...]], region: Box) -> None:
        height, width = frames[0].shape[:2]
        self._size = (width, height)
        self._times = max(1, round(max(self._size) / LOOKED_AT_PX))
        grey = np.stack([self._grey(frame) for frame in frames]).astype(np.float32)
        mean = grey.mean(axis=0)
        x, y, wide, high = (round(value / self._times) for value in region)
        still = _outside((x, y, wide, high), mean.shape)
        smooth = cv2.GaussianBlur(mean, (0, 0), 1.0)
        slope_x = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
        slope_y = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
        edges = still & (np.hypot(slope_x, slope_y) > MIN_SLOPE)
        self._edges = np.nonzero(edges)
        self._slope = np.stack([slope_x[edges], slope_y[edges]], axis=1).astype(np.float64)
        self._level = mean[edges]
        normal = self._slope.T @ self._slope
        told = len(self._slope) >= MIN_EDGE_PX and np.linalg.cond(normal) < MAX_CONDITION
        self._inverse = np.linalg.inv(normal) if told else None
        self._even = tuple(a[::EVERY_STILL] for a in np.nonzero(still))
        self._even_level = mean[self._even]
        spread = float(
            np.sqrt(np.mean(grey.std(axis=0)[self._even] ** 2 * (len(frames) / (len(frames) - 1))))
        )
        self._limit = STILL_NOISES * max(spread, 1.0)

    def shift(self, image: Shaped[ndarray, ...], gain: float) -> tuple[float, float] | None:
        """Shift of what lies still; None where there is none, or none can be told.

        Returns:
            To the right and downwards [px].
        """
        if self._inverse is None:
            return None
        apart = self._grey(image)[self._edges] / gain - self._level
        moved = -self._inverse @ (self._slope.T @ apart)
        left = apart + self._slope @ moved
        explained = float(left @ left) < (1 - MIN_EXPLAINED) * float(apart @ apart)
        if not explained or np.hypot(*moved) < MAX_SHIFT_PX:
            return None
        return self._times * float(moved[0]), self._times * float(moved[1])

    def changed_share(self, image: Shaped[ndarray, ...]) -> float:
        """Share of what lies still that differs from the reference, by more than its brightness."""
        now, then = self._grey(image)[self._even].astype(np.float64), self._even_level
        lit = then > MIN_LIT
        gain = float(np.median(now[lit] / then[lit])) if lit.sum() > MIN_LIT_PX else 1.0
        apart = now / gain - then
        return float(np.mean(np.abs(apart) > self._limit))

    def _grey(self, image: Shaped[ndarray, ...]) -> UInt8[ndarray, "h w"]:
        """The frame in grey, and a large one made smaller."""
        if self._times > 1:
            small = (self._size[0] // self._times, self._size[1] // self._times)
            image = cv2.resize(image, small, interpolation=cv2.INTER_AREA)
        return image if image.ndim == 2 else cv2.transform(image, MEAN_OF_THREE).reshape(image.shape[:2])


def _outside(region: Box, shape: tuple[int, ...]) -> Bool[ndarray, "h w"]:
    """Pixels beside the skin, and along the sides of the frame."""
    height, width = shape
    x, y, wide, high = region
    edge_x, edge_y = round(RIM * width), round(RIM * height)
    still = np.ones(shape, bool)
    rows = slice(max(y, edge_y), min(y + high, height - edge_y))
    still[rows, max(x, edge_x) : min(x + wide, width - edge_x)] = False
    return still


MarkKind = Literal["bright", "dark"]
Places = Float[ndarray, "m 2"]

MIN_MARKS = 9
AROUND = 16.0  # of the frame's longer side: over which the ground around a mark is seen
MIN_FOUND = 0.6  # of the marks: with fewer the whole frame is searched
ALIKE = 0.02  # of the distance of marks: by which those that moved together differ


@dataclass(frozen=True, slots=True)
class MarkMotion:
    """Marks that were found in a frame.

    Attributes:
        at_px: where each was in the untouched frame, x along columns and y along rows ``[m 2]`` [px].
        moved_px: how far each has moved since ``[m 2]`` [px].
        lost: marks of the untouched frame that are not found in this one.
    """

    at_px: Places
    moved_px: Places
    lost: int

    @property
    def largest_px(self) -> float:
        """Largest motion [px]; 0 without marks."""
        return float(np.hypot(*self.moved_px.T).max(initial=0.0))

    def apart(self) -> tuple[Float[ndarray, 2], Places]:
        """Shift that all have in common, and what each has moved beyond that and a common turn [px].

        Reference:
            Kabsch 1976, doi:10.1107/S0567739476001873.
        """
        if not len(self.at_px):
            return np.zeros(2), self.moved_px
        shift = self.moved_px.mean(axis=0)
        before = self.at_px - self.at_px.mean(axis=0)
        now = before + self.moved_px - shift
        across = float((before[:, 0] * now[:, 1] - before[:, 1] * now[:, 0]).sum())
        turn = math.atan2(across, float((before * now).sum()))
        back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        return shift, now - before @ back


class PinFollower:
    """Pins, bright or dark, followed from the untouched frame.

    Args:
        untouched: 8-bit grey or RGB frame.
        kind: whether marks are brighter or darker than what is around.
    """

    def __init__(self, untouched: Shaped[ndarray, ...], kind: MarkKind = "bright") -> None:
        self.kind = kind
        self._first = find_pins(self._bright(untouched), MIN_MARKS)
        self._now = self._first

    @cached_property
    def pitch_px(self) -> float:
        """Median distance of neighbouring marks [px]."""
        away = self._first.xy_px[:, None] - self._first.xy_px[None]
        far = np.hypot(away[..., 0], away[..., 1])
        np.fill_diagonal(far, np.inf)
        return float(np.median(far.min(axis=1)))

    def moved(self, frame: Shaped[ndarray, ...]) -> MarkMotion:
        """Return the motion of the marks in the next frame.

        After too large a step a mark may be mistaken for its neighbor; marks that all lie at their no-contact
        positions, up to a common motion, are matched there first.
        """
        grey = self._bright(frame)
        self._now = next(iter(follow([grey], self._from_here())))
        if self._now.found.mean() < MIN_FOUND:
            self._now = self._anew(grey)
        motion = self._motion(self._now)
        if _spread(motion) > ALIKE * self.pitch_px:
            back = next(iter(follow([grey], self._first)))
            released = self._motion(back)
            if back.found.mean() >= MIN_FOUND and _spread(released) <= ALIKE * self.pitch_px:
                self._now, motion = back, released
        return motion

    def _motion(self, now: PinTracks) -> MarkMotion:
        found = now.found
        at = self._first.xy_px[found]
        return MarkMotion(at, now.xy_px[found] - at, int((~found).sum()))

    def _from_here(self) -> PinTracks:
        """Where to look: a mark that was lost is looked for where the others have gone to."""
        found = self._now.found
        if found.all() or not found.any():
            return self._now if found.any() else self._first
        gone = np.median(self._now.xy_px[found] - self._first.xy_px[found], axis=0)
        places = np.where(found[:, None], self._now.xy_px, self._first.xy_px + gone)
        return replace(self._first, xy_px=places)

    def _anew(self, grey: UInt8[ndarray, "h w"]) -> PinTracks:
        """Marks of the whole frame, named by their cells; those followed, where none can be named."""
        try:
            again = find_pins(grey, MIN_MARKS)
        except ImageError:
            return self._now
        if again.cells is None or self._first.cells is None:
            return self._now
        rows = {tuple(cell): i for i, cell in enumerate(again.cells.tolist())}
        which = np.array([rows.get(tuple(cell), -1) for cell in self._first.cells.tolist()])
        places = np.where((which >= 0)[:, None], again.xy_px[which], np.nan)
        return replace(self._first, xy_px=places)

    def _bright(self, frame: Shaped[ndarray, ...]) -> UInt8[ndarray, "h w"]:
        grey = grey_frame(frame)
        if grey is None:
            raise ImageError(
                f"marks are followed in 8-bit grey or RGB frames, got {frame.dtype} {list(frame.shape)}"
            )
        return grey if self.kind == "bright" else np.subtract(255, grey, dtype=np.uint8)


def _spread(motion: MarkMotion) -> float:
    """Root mean square motion of marks apart [px]."""
    return (
        float(np.sqrt(np.mean(np.square(motion.apart()[1]).sum(axis=1)))) if len(motion.at_px) else math.inf
    )


class DotFollower:
    """Dots of a described skin, found in each frame and named by their cell.

    Args:
        untouched: 8-bit grey or RGB frame.
    """

    def __init__(self, untouched: Shaped[ndarray, ...], skin: DottedSkin) -> None:
        self._skin = skin
        self._first = find_dots(untouched, skin)

    @property
    def pitch_px(self) -> float:
        """About the distance of neighbouring dots [px]."""
        return self._skin.pitch_px

    def moved(self, frame: Shaped[ndarray, ...]) -> MarkMotion:
        """Motion of the dots in a frame; none are found in one that shows no lattice."""
        try:
            now = find_dots(frame, self._skin, self._first)
        except ImageError:
            return MarkMotion(np.empty((0, 2)), np.empty((0, 2)), len(self._first))
        at, places, _ = now.shared_with(self._first)
        return MarkMotion(at, places - at, len(self._first) - len(at))


def follow_marks(
    untouched: Shaped[ndarray, ...], marks: MarkKind | DottedSkin | Literal["any"]
) -> PinFollower | DotFollower | None:
    """Return a follower of the marks; None where `marks` is "any" and no lattice is found.

    Args:
        marks: Contrast of the marks, a description of dots, or "any": bright ones, else dark ones.
    """
    if isinstance(marks, DottedSkin):
        return DotFollower(untouched, marks)
    if marks != "any":
        return PinFollower(untouched, marks)
    kinds: tuple[MarkKind, MarkKind] = ("bright", "dark")
    for kind in kinds if _skewness(untouched) > 0 else kinds[::-1]:
        try:
            return PinFollower(untouched, kind)
        except ImageError:
            continue
    return None


def _skewness(frame: Shaped[ndarray, ...]) -> float:
    """Third moment of how grey levels differ from those around: above 0 where few are brighter."""
    grey = grey_frame(frame)
    if grey is None:
        return 0.0
    around = cv2.GaussianBlur(grey, (0, 0), max(grey.shape) / AROUND)
    return float(np.mean((grey.astype(np.float64) - around) ** 3))


MIN_TOLD_MARKS = 0.6  # fraction of the marks below which no motion is reported
MIN_NOISE_PX = 0.03  # noise along each axis from another position on the pixel grid [px]


class MarksApart:
    """Detects relative motion of marks beyond the noise of their positions.

    A touch moves marks apart; a camera or mount that moved shifts and turns all alike.

    Args:
        untouched: Motion of the marks in two or more no-contact frames.
        rate: False alarm rate.

    Attributes:
        limit_px: Largest relative motion that noise explains [px].
    """

    def __init__(self, untouched: Sequence[MarkMotion], rate: float) -> None:
        apart = [one.apart()[1] for one in untouched if len(one.at_px)]
        count = max((len(one) for one in apart), default=1)
        square = float(np.mean(np.concatenate(apart) ** 2)) if apart else 0.0
        # Each of `count` motions is a Rayleigh variable, whose tail is exp(-r^2 / 2 sigma^2).
        self.limit_px = max(math.sqrt(square), MIN_NOISE_PX) * math.sqrt(2 * math.log(count / rate))

    def told(self, marks: MarkMotion) -> tuple[Float[ndarray, 2], float] | None:
        """Common shift, and the largest motion apart over its limit; None where too few marks are found."""
        found = len(marks.at_px)
        if found < MIN_TOLD_MARKS * (found + marks.lost):
            return None
        shift, apart = marks.apart()
        return shift, float(np.hypot(*apart.T).max()) / self.limit_px
