"""What is drawn over a frame that is seen without a calibration, as plain shapes in its pixels.

No drawing library is needed: whoever shows the frame, a page or a window, draws lines, dots and arrows in its
own colours by what each shape is of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from palpate.core import Float, RangeError, ndarray
from palpate.sensing.untouched_view import SeenTouch

ShapeRole = Literal["skin", "region", "centre", "mark", "verdict"]
Point = tuple[float, float]

MIN_ARROW_PX = 0.3  # a mark that moved less is drawn as a dot
MAX_OUTLINE_POINTS = 120


@dataclass(frozen=True, slots=True)
class OverlayLine:
    """A closed line through points, x along columns and y along rows [px]."""

    role: ShapeRole
    points: tuple[Point, ...]


@dataclass(frozen=True, slots=True)
class OverlayDot:
    """A dot or a cross at a point [px]."""

    role: ShapeRole
    at: Point


@dataclass(frozen=True, slots=True)
class OverlayArrow:
    """An arrow from where a mark was to where it is, its length magnified as asked [px]."""

    role: ShapeRole
    start: Point
    end: Point


@dataclass(frozen=True, slots=True)
class OverlayText:
    """Words beside a point [px]."""

    role: ShapeRole
    at: Point
    text: str


@dataclass(frozen=True, slots=True)
class FrameOverlay:
    """Shapes over one frame.

    Attributes:
        lines: the skin's region, and the outline of the touched one.
        dots: the touched region's centre, and marks that have not moved.
        texts: the verdict, and what can be said of the region.
    """

    lines: tuple[OverlayLine, ...]
    dots: tuple[OverlayDot, ...]
    arrows: tuple[OverlayArrow, ...]
    texts: tuple[OverlayText, ...]
    arrow_times: float

    def to_dict(self) -> dict[str, Any]:
        """The same as lists and dictionaries, for JSON."""
        return asdict(self)


def overlay_of(
    seen: SeenTouch, skin: tuple[int, int, int, int] | None = None, *, arrow_times: float = 1.0
) -> FrameOverlay:
    """Shapes that show what was seen.

    Args:
        skin: x, y, width and height of the skin in the frame, to be outlined [px].
        arrow_times: by which the motion of marks is magnified.
    """
    if not arrow_times > 0:
        raise RangeError(f"arrows {arrow_times} times as long as marks moved; give a factor above 0")
    lines, dots, arrows, texts = [], [], [], [OverlayText("verdict", (0.0, 0.0), seen.verdict)]
    if skin is not None:
        x, y, width, height = map(float, skin)
        corners = ((x, y), (x + width, y), (x + width, y + height), (x, y + height))
        lines.append(OverlayLine("skin", corners))
    if (region := seen.region) is not None:
        every = -(-len(region.outline_px) // MAX_OUTLINE_POINTS)
        lines.append(OverlayLine("region", _points(region.outline_px[::every].astype(np.float64))))
        dots.append(OverlayDot("centre", region.centre_px))
        size = f"{region.area_px:.0f} px²" if region.area_mm2 is None else f"{region.area_mm2:.1f} mm²"
        texts.append(OverlayText("region", region.centre_px, size))
    if (marks := seen.marks) is not None:
        far = np.hypot(*marks.moved_px.T) >= MIN_ARROW_PX
        dots += [OverlayDot("mark", at) for at in _points(marks.at_px[~far])]
        ends = marks.at_px[far] + arrow_times * marks.moved_px[far]
        pairs = zip(_points(marks.at_px[far]), _points(ends), strict=True)
        arrows += [OverlayArrow("mark", start, end) for start, end in pairs]
    return FrameOverlay(tuple(lines), tuple(dots), tuple(arrows), tuple(texts), arrow_times)


def rounded_overlay(overlay: FrameOverlay) -> dict[str, Any]:
    """The shapes as plain values for a page, places to a tenth of a pixel."""
    return {
        "lines": [{"role": one.role, "points": _rounded(one.points)} for one in overlay.lines],
        "dots": [{"role": one.role, "at": _rounded([one.at])[0]} for one in overlay.dots],
        "arrows": [
            {"role": one.role, "start": start, "end": end}
            for one in overlay.arrows
            for start, end in [_rounded([one.start, one.end])]
        ],
        "arrow_times": overlay.arrow_times,
    }


def _rounded(points: Sequence[Point]) -> list[list[float]]:
    return [[round(x, 1), round(y, 1)] for x, y in points]


def _points(xy: Float[ndarray, "p 2"]) -> tuple[Point, ...]:
    return tuple((float(x), float(y)) for x, y in xy)
