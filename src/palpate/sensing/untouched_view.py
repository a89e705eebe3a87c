"""Touch without a calibration: where a frame differs from the no-contact frames.

The mean and noise come from a few no-contact frames. The difference of a frame, after removal of a brightness
change, is smoothed lightly, squared over the noise, and averaged over a neighborhood. Without contact this
is a mean of squares of known variance, which gives the threshold for a false alarm rate. A touch that
scales more than half of the skin by one factor is interpreted as a brightness change.

In a dark field only a touch lights the skin, and with pins only a touch moves them apart; other differences
are "in-view". The region ends where the smoothed difference falls to half of its strong part: it is what
the image shows, not the contact area, which needs a calibration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from palpate.core import Bool, Float, Float32, ImageError, InputError, Int, RangeError, Shaped, UInt8, ndarray
from palpate.estimators.lattice.dotted_skin import DottedSkin
from palpate.sensing.uncalibrated import (
    MIN_PX,
    BrightnessGain,
    MarkKind,
    MarkMotion,
    MarksApart,
    StillSurround,
    box_of,
    disc,
    edge_share,
    follow_marks,
    large_parts,
    outlines_of,
    strongest_part,
    tail_weights,
    upper_quantile,
)
from palpate.sensors.owned import SensorPreset

TouchVerdict = Literal["untouched", "touched", "in-view", "view-changed"]
Box = tuple[int, int, int, int]
Grid = Float32[ndarray, "h w c"]

MIN_FRAMES = 5
WORKING_PX = 320  # about the longer side of the grid that is worked on; finer images are averaged to it
COARSE = 4  # px of a frame on one of the grid, from which a frame is halved before it becomes fractions
SIGMA = 1.5  # px of the grid: by which a difference is smoothed
SPREAD = 2.0  # px of the grid: over which its square is averaged
NOISE_OVER = 8.0  # px of the grid over which variances are averaged: few frames tell little of one pixel's
MIN_NOISE = 0.1  # grey levels, after smoothing: an image without noise is not taken to be known better
SATURATED = 250.0  # grey levels
GAINS = 0.6, 1.6  # brightness over the reference's, beyond which the view has changed
MAX_SHARE = 0.6  # of the region, beyond which what lies still beside it tells a touch from another view
MAX_STILL_SHARE = 0.5  # of what lies still that a touch may change
HARDLY = 0.05  # probability of what untouched frames reach, below which their noise is not as supposed
STRONG = 75  # percentile of the strength in a region that is its strong part
SURELY = 2.0  # times the least change: a small part that changes by more is a touch, whatever is around it
MOVED_PX = 0.3  # by which marks have moved together, before it is said
ROUNDS = 3  # of telling the strong part by the region, and the region by the strong part


@dataclass(frozen=True, slots=True)
class TouchedRegion:
    """Part of the image that a touch has changed.

    Attributes:
        centre_px: Centroid, x along columns and y along rows [px].
        outline_px: Closed outline ``[p 2]`` [px].
        strength: Root mean square difference of its strong part over the channels [gray levels].
        centre_mm: Centroid from the middle of the skin; None without a scale [mm].
        area_mm2: None without a scale [mm²].
    """

    centre_px: tuple[float, float]
    area_px: float
    outline_px: Int[ndarray, "p 2"]
    strength: float
    centre_mm: tuple[float, float] | None = None
    area_mm2: float | None = None


@dataclass(frozen=True, slots=True)
class SeenTouch:
    """Comparison of a frame with the no-contact view.

    Attributes:
        verdict: "untouched", "touched", "in-view" (seen, contact uncertain), or "view-changed" (other light,
            camera, or skin; no contact detectable).
        change: Largest statistic relative to the threshold of a touch, which exceeds 1 over an area.
        changed_share: Fraction of the region with a difference.
        region: Largest connected change, or a smaller one that is stronger; only for "touched" and "in-view".
        marks: Marks and their motion; None without tracking or with a changed view.
    """

    verdict: TouchVerdict
    why: str
    gain: tuple[float, ...]
    change: float
    changed_share: float
    region: TouchedRegion | None = None
    marks: MarkMotion | None = None

    def to_dict(self) -> dict[str, Any]:
        """The same as numbers, words and lists, for JSON; of marks their number and largest motion."""
        told: dict[str, Any] = {
            "verdict": self.verdict, "why": self.why, "gain": list(self.gain), "change": self.change,
            "changed_share": self.changed_share, "region": None, "marks": None,
        }  # fmt: skip
        if (region := self.region) is not None:
            told["region"] = asdict(region) | {"outline_px": region.outline_px.tolist()}
        if (marks := self.marks) is not None:
            told["marks"] = {
                "found": len(marks.at_px), "lost": marks.lost, "largest_px": marks.largest_px,
            }  # fmt: skip
        return told


class Difference(NamedTuple):
    """Difference of a frame on the grid: smoothed [grey levels], and its statistic, whose mean is 1."""

    smoothed: Grid
    statistic: Float32[ndarray, "h w"]
    gain: Float[ndarray, " c"]


class UntouchedView:
    """No-contact view, with which frames are compared.

    Args:
        frames: Five or more no-contact images, 8-bit gray ``[h w]`` or RGB ``[h w 3]``.
        region: Skin in the frame (x, y, width, height); the whole frame by default [px].
        false_alarm_rate: Upper bound of the fraction of no-contact frames reported as touched.
        least_change: Smallest change of a touch, above effects of video coding and warming [gray levels].
        mm_per_px: Scale of the skin in the frame; None for lengths in px only.
        marks: Tracked pins or dots: "bright", "dark", a description of dots, or "any" on a lattice. A region
            then covers several marks.
        by_marks: Detect touch only by marks that move apart, as for pins in an opaque skin.
        dark_field: The region is dark without stress. Brightness then comes from the surroundings, whose
            differences are "in-view".
        see_through: The camera sees through the skin, so differences may lie in the air.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> still = [rng.normal(100, 2, (60, 80)).astype(np.uint8) for _ in range(8)]
        >>> UntouchedView(still).seen(still[0]).verdict
        'untouched'
    """

    def __init__(
        self,
        frames: Sequence[Shaped[ndarray, ...]],
        *,
        region: Box | None = None,
        false_alarm_rate: float = 1e-3,
        least_change: float = 1.5,
        mm_per_px: float | None = None,
        marks: MarkKind | DottedSkin | Literal["any"] | None = None,
        by_marks: bool = False,
        dark_field: bool = False,
        see_through: bool = False,
    ) -> None:
        if len(frames) < MIN_FRAMES:
            raise InputError(
                f"{len(frames)} frames of the untouched sensor; {MIN_FRAMES} or more tell its noise",
                code="too-few-frames",
            )
        self._shape = _kind_of(frames[0])
        if not 1e-9 <= false_alarm_rate <= 0.5:
            raise RangeError(
                f"a false-alarm rate of {false_alarm_rate}; give a share from 1e-9 to 0.5",
                code="false-alarm-rate",
            )
        if not 0 <= least_change < SATURATED:
            raise RangeError(f"a least change of {least_change} grey levels; give 0 to {SATURATED:.0f}")
        if mm_per_px is not None and not 0 < mm_per_px < math.inf:
            raise RangeError(f"{mm_per_px} mm a pixel; give a length above 0 mm")
        self.region = _within(region, self._shape)
        self.mm_per_px, self.least_change = mm_per_px, least_change
        self._step = max(1, round(max(self.region[2:]) / WORKING_PX))
        self._marks = None if marks is None else follow_marks(_mean_frame(frames), marks)
        pitch = 0.0 if self._marks is None else self._marks.pitch_px
        self._spread = max(SPREAD, 0.5 * pitch / self._step)
        self._see_through, self._dark_field = see_through, dark_field
        self._still = StillSurround(frames, self.region)
        self._learn(frames, false_alarm_rate)
        self._apart = None
        if by_marks and self._marks is not None:
            self._apart = MarksApart([self._marks.moved(frame) for frame in frames], false_alarm_rate)
        self._beside: UntouchedView | None = None
        if dark_field and self.region[2:] != (self._shape[1], self._shape[0]):
            options = {"false_alarm_rate": false_alarm_rate, "least_change": least_change}
            self._beside = _ViewBeside(frames, self.region, **options)

    @classmethod
    def of_preset(
        cls,
        preset: SensorPreset,
        frames: Sequence[Shaped[ndarray, ...]],
        *,
        false_alarm_rate: float = 1e-3,
        look_for_marks: bool = False,
    ) -> UntouchedView:
        """View of a sensor that people own, with its region, scale and marks.

        Args:
            false_alarm_rate: see above.
            look_for_marks: whether to look for marks, which takes seconds, where it may or may not have any.
        """
        if not frames:
            raise InputError(f"no frame of the untouched sensor; {MIN_FRAMES} or more tell its noise")
        size = (frames[0].shape[1], frames[0].shape[0])
        kind = preset.marks.kind
        return cls(
            frames,
            region=preset.region_px(size),
            false_alarm_rate=false_alarm_rate,
            mm_per_px=preset.mm_per_px(size),
            marks=None if kind == "none" or (kind == "any" and not look_for_marks) else kind,
            by_marks=preset.kind == "pins",
            dark_field=preset.skin.dark_field,
            see_through=preset.skin.see_through,
        )

    @property
    def noise(self) -> float:
        """Median noise of the smoothed difference [grey levels]."""
        return float(np.sqrt(np.median(self._variance)))

    def _learn(self, frames: Sequence[Shaped[ndarray, ...]], rate: float) -> None:
        grids = np.stack([self._grid(frame) for frame in frames])
        n = len(grids)
        if self._dark_field:
            mean = np.mean(np.stack(frames), axis=0).reshape(*self._shape[:2], -1)
            self._bright = BrightnessGain(mean, self.region)
        else:
            self._bright = BrightnessGain(grids.mean(axis=0))
        gains = [self._gain(*pair) for pair in zip(frames, grids, strict=True)]
        even = np.stack([grid / g.astype(np.float32) for grid, g in zip(grids, gains, strict=True)])
        self._mean = even.mean(axis=0)
        self._brightest = self._mean.max(axis=(0, 1))
        # Each is compared with the mean of the others, as a new frame is with that of all.
        apart = [_smooth(one - self._mean, SIGMA) * np.float32(n / (n - 1)) for one in even]
        variance = np.mean(np.square(apart), axis=0) * ((n * n - 1) / (n * n))
        self._variance = _smooth(variance, NOISE_OVER) + np.float32(MIN_NOISE**2)
        self._inverse = 1 / self._variance
        channels = self._mean.shape[2]
        weights = tail_weights(SIGMA, self._spread)
        places = max(self._mean[..., 0].size / (math.pi * (SIGMA**2 + 2 * self._spread**2)), 1.0)
        reached = max(float(self._statistic(one, np.ones(channels)).max()) for one in apart)
        # Untouched frames that reach what they hardly should have other noise than supposed.
        hardly = upper_quantile(HARDLY / n / places, weights, channels)
        self.threshold = upper_quantile(rate / places, weights, channels) * max(1.0, reached / hardly)

    def seen(self, image: Shaped[ndarray, ...]) -> SeenTouch:
        """The frame beside the reference."""
        difference = self.difference(image)
        gain = tuple(float(g) for g in difference.gain)
        over = difference.statistic > self.threshold
        share, change = float(over.mean()), float(difference.statistic.max()) / self.threshold
        why = self._why_changed(image, gain, share)
        if why:
            return SeenTouch("view-changed", why, gain, change, share)
        marks = None if self._marks is None else self._marks.moved(image)
        if marks is not None and self._apart is not None and (told := self._apart.told(marks)) is not None:
            shift, apart = told
            return self._by_marks(image, SeenTouch("untouched", "", gain, apart, share, None, marks), shift)
        region = self._region(difference, over) if change > 1 else None
        if region is None or region.strength < self.least_change:
            if self._beside is not None and (seen := self._beside.seen(image)).verdict == "touched":
                why = f"no light of stress in the skin, and beside it {seen.why}"
                return SeenTouch("in-view", why, gain, seen.change, share, seen.region, marks)
            why = "no difference beyond the noise"
            if region is not None:
                why = f"a change of {region.strength:.1f} grey levels; a touch has {self.least_change:.1f}"
            return SeenTouch("untouched", why, gain, change, share, None, marks)
        why = _where(region)
        if self._see_through:
            why += "; the camera sees through this skin, and what it sees may not touch"
            return SeenTouch("in-view", why, gain, change, share, region, marks)
        return SeenTouch("touched", why, gain, change, share, region, marks)

    def _by_marks(self, image: Shaped[ndarray, ...], seen: SeenTouch, shift: Float[ndarray, 2]) -> SeenTouch:
        """Verdict by marks that have moved apart; where, by the picture, their common shift undone."""
        x, y = float(shift[0]), float(shift[1])
        if seen.change <= 1:
            why = "no mark has moved against the others beyond the noise"
            if math.hypot(x, y) > MOVED_PX:
                why += f"; all have moved together by {x:.1f}, {y:.1f} px, as where the camera or mount moved"
            return replace(seen, why=why)
        height, width = self._shape[:2]
        back = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])  # from a place in the picture wanted to that it is at
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        level = cv2.warpAffine(image, back, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        difference = self.difference(np.asarray(level))
        region = self._region(difference, difference.statistic > self.threshold)
        why = "marks have moved apart" + ("" if region is None else f": {_where(region)}")
        return replace(seen, verdict="touched", why=why, region=region)

    def difference(self, image: Shaped[ndarray, ...]) -> Difference:
        """Difference of a frame to the reference on the grid, brightness divided out."""
        if image.shape != self._shape or image.dtype != np.uint8:
            raise InputError(
                f"a frame {image.dtype} {list(image.shape)} beside a reference of 8-bit {list(self._shape)}; "
                "give frames of that camera, or take the untouched reference anew",
                code="frames-differ",
            )
        grid = self._grid(image)
        gain = self._gain(image, grid)
        apart = grid / gain.astype(np.float32) - self._mean
        smoothed = _smooth(apart, SIGMA)
        return Difference(smoothed, self._statistic(smoothed, gain), gain)

    def picture(self, image: Shaped[ndarray, ...], times: float = 4.0) -> UInt8[ndarray, "h w *c"]:
        """Difference as an image of the region: grey level 128 is none, and differences are magnified."""
        width, height = self.region[2:]
        apart = self.difference(image).smoothed
        shown = np.clip(128 + times * apart, 0, 255).astype(np.uint8)
        return cv2.resize(shown, (width, height), interpolation=cv2.INTER_LINEAR)

    def _why_changed(self, image: Shaped[ndarray, ...], gain: tuple[float, ...], share: float) -> str:
        if not all(GAINS[0] <= g <= GAINS[1] for g in gain):
            told = ", ".join(f"{g:.2f}" for g in gain)
            return f"brightness is {told} times the reference's: look at light and exposure, or take it anew"
        brighter = float(np.mean(gain))
        shifted = self._still.shift(image, brighter)
        if shifted is not None:
            x, y = shifted
            return (
                f"what lies beside the skin has moved by {x:.1f}, {y:.1f} px: the camera moved; "
                "take the untouched reference anew"
            )
        if share > MAX_SHARE and (still := self._still.changed_share(image)) > MAX_STILL_SHARE:
            return (
                f"{100 * share:.0f} % of the skin and {100 * still:.0f} % of what lies beside it differ from "
                "the reference: light, focus or camera changed; take the untouched reference anew"
            )
        return ""

    def _grid(self, image: Shaped[ndarray, ...]) -> Grid:
        if _kind_of(image) != self._shape:
            raise InputError(
                f"frames of {list(image.shape)} and {list(self._shape)} px; give untouched frames of one kind"
            )
        x, y, width, height = self.region
        step = self._step
        wide, high = width // step, height // step
        part = image[y : y + high * step, x : x + wide * step]
        if step >= COARSE:  # rounding after a mean of four pixels or more is little beside their noise
            part = cv2.resize(part, (2 * wide, 2 * high), interpolation=cv2.INTER_AREA)
        small = cv2.resize(part.astype(np.float32), (wide, high), interpolation=cv2.INTER_AREA)
        return small.reshape(high, wide, -1)

    def _gain(self, image: Shaped[ndarray, ...], grid: Grid) -> Float[ndarray, " c"]:
        """Brightness over the reference's, each channel: the median, which a touch hardly moves."""
        return self._bright.of(image.reshape(*self._shape[:2], -1) if self._dark_field else grid)

    def _statistic(self, smoothed: Grid, gain: Float[ndarray, " c"]) -> Float32[ndarray, "h w"]:
        """Mean square over the noise, of all channels and around each pixel."""
        square = smoothed * smoothed
        square *= self._inverse
        level = gain.astype(np.float32)
        if (
            level * self._brightest
        ).max() >= SATURATED:  # what would be saturated cannot follow the brightness
            square[self._mean * level >= SATURATED] = 0.0
        # A darker frame, brightened, has more noise.
        weights = np.minimum(level, 1.0) ** 2 / len(level)
        mean = cv2.transform(square, weights[None]) if len(level) > 1 else weights * square[..., 0]
        return _smooth(mean.reshape(*square.shape[:2], 1), self._spread)[..., 0]

    def _region(self, difference: Difference, over: Bool[ndarray, "h w"]) -> TouchedRegion | None:
        """The largest part that differs; a smaller one where that differs too little, and this much."""
        if not over.any():
            return None
        rows, columns = box_of(over, math.ceil(3 * math.hypot(SIGMA, self._spread)))
        smoothed, over = difference.smoothed[rows, columns], np.ascontiguousarray(over[rows, columns])
        square = (smoothed * smoothed - self._variance[rows, columns]).sum(axis=2, keepdims=True)
        energy = _smooth(square, self._spread)[..., 0] / smoothed.shape[2]
        corner = (columns.start, rows.start)
        largest = strongest_part(over, np.zeros_like(over), energy)
        region = None if largest is None else self._outlined(energy, largest, largest, corner)
        surely = over & (energy > (SURELY * self.least_change) ** 2)
        if (region is None or region.strength < self.least_change) and surely.any():
            seed = strongest_part(over, surely, energy)
            if seed is not None and np.count_nonzero(seed & surely) >= MIN_PX:
                return self._outlined(energy, seed, seed & surely, corner) or region
        return region

    def _outlined(
        self,
        energy: Float32[ndarray, "h w"],
        seed: Bool[ndarray, "h w"],
        core: Bool[ndarray, "h w"],
        corner_px: tuple[int, int],
    ) -> TouchedRegion | None:
        """Region of a part of the grid, whose strong part is told by its core."""
        share, mask, strong = edge_share(SIGMA, self._spread), core, 0.0
        for _ in range(ROUNDS):
            strong = max(float(np.percentile(energy[mask & core], STRONG)), 0.0)
            mask = energy > share * strong
        parts = large_parts(mask & seed)
        if not parts:
            return None
        filled = np.zeros(mask.shape, np.uint8)
        if len(parts) > 1:  # bright here and dark there, with a band between that is as it was
            outline = cv2.convexHull(np.concatenate(parts))
        else:
            cv2.drawContours(filled, parts, -1, 1, cv2.FILLED)
            filled = cv2.morphologyEx(filled, cv2.MORPH_CLOSE, disc(round(2 * self._spread)))
            outline = max(outlines_of(filled), key=len)
        cv2.drawContours(filled, [outline], -1, 1, cv2.FILLED)
        # Pixels at a ragged edge count by how strongly they are changed.
        weight = np.minimum(np.maximum(energy, 0), strong) * filled
        moments = cv2.moments(weight)
        corner = np.array(corner_px)
        at = corner + np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        # Smoothing draws a closed edge inwards: its area shrinks by pi sigma squared, whatever its shape.
        area = cv2.countNonZero(filled) + math.pi * (SIGMA**2 + self._spread**2)
        return self._in_frame(at, area, corner + outline[:, 0], math.sqrt(strong))

    def _in_frame(
        self, at: Float[ndarray, 2], area: float, outline: Int[ndarray, "p 2"], strength: float
    ) -> TouchedRegion:
        x, y, width, height = self.region
        corner, step = np.array([x, y]), self._step
        centre = corner + step * at + (step - 1) / 2
        lines = corner + step * outline + step // 2
        if self.mm_per_px is None:
            return TouchedRegion(_pair(centre), area * step**2, lines, strength)
        away = (centre - corner - (np.array([width, height]) - 1) / 2) * self.mm_per_px
        area_px = area * step**2
        return TouchedRegion(
            _pair(centre), area_px, lines, strength, _pair(away), area_px * self.mm_per_px**2
        )


class _ViewBeside(UntouchedView):
    """All of a frame but the skin, in which something may be seen that does not touch."""

    def __init__(self, frames: Sequence[Shaped[ndarray, ...]], skin: Box, **options: float) -> None:
        self._skin = skin
        super().__init__(frames, **options)  # type: ignore[arg-type]

    def _statistic(self, smoothed: Grid, gain: Float[ndarray, " c"]) -> Float32[ndarray, "h w"]:
        statistic = super()._statistic(smoothed, gain)
        reach = math.ceil(3 * math.hypot(SIGMA, self._spread))
        x, y, wide, high = (value // self._step for value in self._skin)
        rows = slice(max(y - reach, 0), y + high + 1 + reach)
        statistic[rows, max(x - reach, 0) : x + wide + 1 + reach] = 0.0
        return statistic


def _where(region: TouchedRegion) -> str:
    x, y = region.centre_px
    return f"a change of {region.strength:.1f} grey levels around x {x:.0f}, y {y:.0f} px"


def _pair(values: Float[ndarray, 2]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _mean_frame(frames: Sequence[Shaped[ndarray, ...]]) -> UInt8[ndarray, "h w *c"]:
    return np.rint(np.mean(np.stack(frames), axis=0)).astype(np.uint8)


def _smooth(grid: Grid, sigma: float) -> Grid:
    return cv2.GaussianBlur(grid, (0, 0), sigma, borderType=cv2.BORDER_REFLECT).reshape(grid.shape)


def _kind_of(image: Shaped[ndarray, ...]) -> tuple[int, ...]:
    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise ImageError(
            "a touch is seen in 8-bit grey [h w] or RGB [h w 3] images, got "
            f"{image.dtype} {list(image.shape)}",
            code="pixel-format",
        )
    return image.shape


def _within(region: Box | None, shape: tuple[int, ...]) -> Box:
    height, width = shape[:2]
    if region is None:
        return 0, 0, width, height
    x, y, wide, high = region
    if x < 0 or y < 0 or wide < 16 or high < 16 or x + wide > width or y + high > height:
        raise RangeError(
            f"a region {list(region)} px (x, y, width, height) in frames of {width} x {height} px; it lies "
            "inside the frame and is 16 px or more along each side",
            code="region-outside",
        )
    return region


MIN_ARROW_PX = 0.3  # a mark that moved less is drawn as a dot
MAX_OUTLINE_POINTS = 120


def overlay_of(
    seen: SeenTouch, skin: tuple[int, int, int, int] | None = None, *, arrow_times: float = 1.0
) -> dict[str, Any]:
    """Shapes that show what was seen, places to a tenth of a pixel.

    Each has the role "skin", "region", "centre" or "mark". `lines` are closed: the skin, and the outline of
    the touched region. `dots` are that region's centre, and marks that have not moved; `arrows` lead from
    where a mark was to where it is.

    Args:
        skin: x, y, width and height of the skin in the frame, to be outlined [px].
        arrow_times: by which the motion of marks is magnified.
    """
    if not arrow_times > 0:
        raise RangeError(f"arrows {arrow_times} times as long as marks moved; give a factor above 0")
    lines, dots, arrows = [], [], []
    if skin is not None:
        x, y, width, height = skin
        corners = [[x, y], [x + width, y], [x + width, y + height], [x, y + height]]
        lines.append({"role": "skin", "points": _rounded(corners)})
    if (region := seen.region) is not None:
        every = -(-len(region.outline_px) // MAX_OUTLINE_POINTS)
        lines.append({"role": "region", "points": _rounded(region.outline_px[::every])})
        dots.append({"role": "centre", "at": _rounded(region.centre_px)})
    if (marks := seen.marks) is not None:
        far = np.hypot(*marks.moved_px.T) >= MIN_ARROW_PX
        dots += [{"role": "mark", "at": at} for at in _rounded(marks.at_px[~far])]
        starts = _rounded(marks.at_px[far])
        ends = _rounded(marks.at_px[far] + arrow_times * marks.moved_px[far])
        arrows = [
            {"role": "mark", "start": start, "end": end} for start, end in zip(starts, ends, strict=True)
        ]
    return {"lines": lines, "dots": dots, "arrows": arrows, "arrow_times": arrow_times}


def _rounded(points: Any) -> Any:
    return np.asarray(points, np.float64).round(1).tolist()
