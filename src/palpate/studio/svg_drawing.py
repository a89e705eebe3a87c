"""Drawings of the pages, as SVG: the places of a plan, the force over time, regions over a picture."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from itertools import starmap
from typing import Any

from palpate.core import Outline
from palpate.rig.plans.press_places import Place
from palpate.studio.page_shell import AXES, paint
from palpate.studio.status_text import number

INK, SOFT, LINE, ACCENT, BAND, BAD, CARD = map(
    paint, ("ink", "soft", "line", "accent", "band", "bad", "card")
)
MAX_PLACES = 3000  # that are drawn
SPAN_S = 20.0  # of the force's time axis
MIN_SPAN_N = 0.4
BOX = "#ffd75e"  # seen on dark pictures and bright ones, with a black edge
LEFT, RIGHT, TOP = 50, 10, 14
Point = tuple[float, float]


def grid_svg(
    places: Sequence[Place],
    outline: Outline,
    probe_mm: float,
    *,
    done: Mapping[str, float] | None = None,
    now: str = "",
    at_mm: Sequence[float] | None = None,
) -> str:
    """The skin from above, as the camera sees it: x right, y down, in mm.

    Args:
        places: where the probe comes down.
        done: of each place's name, the share of its presses that is recorded.
    """
    done = done or {}
    layer_mm = 2e3 * outline.radius_m
    half = layer_mm / 2
    outermost = max((max(abs(p.x_mm), abs(p.y_mm)) for p in places[:MAX_PLACES]), default=0.0)
    edge = max(half, outermost + probe_mm / 2) * 1.06
    dot = max(0.012 * layer_mm, 0.3)
    parts = [
        f'<svg viewBox="{-edge:.2f} {-edge:.2f} {2 * edge:.2f} {2 * edge:.2f}" role="img">',
        _named("Places of the plan on the skin", _places_in_words(places, probe_mm, done, now, at_mm)),
        f'<{_shape(outline)} fill="{CARD}" stroke="{INK}" stroke-width="{layer_mm / 160:.3f}"/>',
    ]
    for place in places[:MAX_PLACES]:
        share = done.get(place.name, 0.0)
        fill, opacity = (ACCENT, 0.13 + 0.25 * share) if share else (BAND, 0.45)
        parts.append(
            f'<circle cx="{place.x_mm:.3f}" cy="{place.y_mm:.3f}" r="{probe_mm / 2:.3f}" fill="{fill}" '
            f'fill-opacity="{opacity:.2f}" stroke="{ACCENT}" '
            f'stroke-opacity="0.35" stroke-width="{layer_mm / 300:.3f}">'
            f"<title>{escape(place.name)}</title></circle>"
        )
    parts.append(_axis_limit(outline, probe_mm))
    for place in places[:MAX_PLACES]:
        colour = BAD if place.name == now else ACCENT if done.get(place.name, 0.0) >= 1 else SOFT
        size = dot * (1.7 if place.name == now else 1)
        parts.append(f'<circle cx="{place.x_mm:.3f}" cy="{place.y_mm:.3f}" r="{size:.3f}" fill="{colour}"/>')
    if at_mm is not None:
        parts.append(_cross(at_mm[0], at_mm[1], probe_mm, layer_mm / 200))
    parts.append("</svg>")
    return "".join(parts)


def _named(title: str, description: str) -> str:
    """What a drawing is and what it shows, for whoever does not see it."""
    return f"<title>{escape(title)}</title><desc>{escape(description)}</desc>"


def _places_in_words(
    places: Sequence[Place],
    probe_mm: float,
    done: Mapping[str, float],
    now: str,
    at_mm: Sequence[float] | None,
) -> str:
    whole = sum(done.get(place.name, 0.0) >= 1 for place in places)
    parts = [f"{len(places)} places under a probe of {probe_mm:g} mm", f"{whole} done"]
    if now:
        parts.append(f"{now} is pressed")
    if at_mm is not None:
        parts.append(f"the stage is at x {number(at_mm[0], 1)}, y {number(at_mm[1], 1)} mm")
    return "; ".join(parts)


def _force_in_words(series: Mapping[str, Sequence[float]]) -> str:
    if not series["age_s"]:
        return "no force was measured yet"
    ends = ", ".join(f"{axis} {number(series[axis][-1], 2)}" for axis in AXES)
    low, high = (number(of(series["z"]), 2) for of in (min, max))
    return f"{ends} N at the end; z between {low} and {high} N over the last {SPAN_S:g} s"


def _shape(outline: Outline, inset_mm: float = 0.0) -> str:
    """The start of the skin's element, in mm."""
    if not outline.corners_m:
        return f'circle r="{1e3 * outline.radius_m - inset_mm:.3f}"'
    return f'polygon points="{" ".join(f"{1e3 * x:.3f},{1e3 * y:.3f}" for x, y in outline.corners_m)}"'


def _axis_limit(outline: Outline, probe_mm: float) -> str:
    """How far out the probe's axis may lie: a dashed circle, or a polygon's margin as wide as the probe."""
    layer_mm = 2e3 * outline.radius_m
    if outline.corners_m:
        return (
            f'<clipPath id="skin"><{_shape(outline)}/></clipPath><{_shape(outline)} clip-path="url(#skin)" '
            f'fill="none" stroke="{SOFT}" stroke-opacity="0.25" stroke-width="{probe_mm:.3f}"/>'
        )
    return (
        f'<{_shape(outline, probe_mm / 2)} fill="none" stroke="{SOFT}" stroke-width="{layer_mm / 250:.3f}" '
        f'stroke-dasharray="{layer_mm / 60:.2f} {layer_mm / 60:.2f}"/>'
    )


def _cross(x: float, y: float, probe_mm: float, thick: float) -> str:
    arm = 0.28 * probe_mm
    lines = f"M{x - arm:.3f} {y:.3f}h{2 * arm:.3f}M{x:.3f} {y - arm:.3f}v{2 * arm:.3f}"
    return (
        f'<g class="cross" stroke="{INK}" stroke-width="{thick:.3f}" fill="none">'
        f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{probe_mm / 2:.3f}"/><path d="{lines}"/></g>'
    )


class Plot:
    """Axes over a grid at round numbers, drawn as SVG; what lies beyond them is drawn at their edge.

    Args:
        size: width and height [px].
        x, y: what each axis runs from and to.
        y_name: words in the upper left.
        x_name: words below the ticks of the x axis; none, where these say it.
        x_ticks: places along x and their words; round numbers by default.
    """

    def __init__(
        self,
        size: tuple[int, int],
        x: tuple[float, float],
        y: tuple[float, float],
        *,
        y_name: str,
        x_name: str = "",
        x_ticks: Sequence[tuple[float, str]] = (),
    ) -> None:
        (self.width, self.height), self._x, self._y = size, x, y
        self.bottom = self.height - (40 if x_name else 26)
        ticks = x_ticks or [(value, f"{value:g}") for value in round_numbers(*x)]
        self.parts = [*self._rows(), *self._columns(ticks)]
        unit = f'<text y="{self.height - 7}" x="{self.width - RIGHT}" text-anchor="end" class="unit">'
        self._names = f'<text x="{LEFT + 5}" y="{TOP + 9}" class="unit">{escape(y_name)}</text>' + (
            f"{unit}{escape(x_name)}</text>" if x_name else ""
        )

    def at(self, x: float, y: float) -> tuple[float, float]:
        """A point in the drawing [px]."""
        across, up = (
            min(max((value - low) / (high - low), 0.0), 1.0)
            for value, (low, high) in ((x, self._x), (y, self._y))
        )
        return LEFT + across * (self.width - LEFT - RIGHT), self.bottom - up * (self.bottom - TOP)

    def line(self, points: Iterable[Point], colour: str, width: float = 1.6, dashes: str = "") -> None:
        """Points joined by a line."""
        dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
        self.parts.append(
            f'<polyline points="{self._joined(points)}" fill="none" stroke="{colour}" '
            f'stroke-width="{width:g}" stroke-linejoin="round"{dashed}/>'
        )

    def band(self, lows: Sequence[Point], highs: Sequence[Point], colour: str) -> None:
        """What lies between two lines."""
        if lows and highs:
            self.parts.append(
                f'<polygon points="{self._joined((*lows, *reversed(highs)))}" fill="{colour}"/>'
            )

    def span(self, low: float, high: float, colour: str) -> None:
        """A stretch of the x axis, shaded."""
        left, right = self.at(low, 0.0)[0], self.at(high, 0.0)[0]
        self.parts.append(
            f'<rect x="{left:.1f}" y="{TOP}" width="{max(right - left, 0.8):.1f}" '
            f'height="{self.bottom - TOP}" fill="{colour}" fill-opacity="0.35"/>'
        )

    def dots(self, points: Iterable[Point], colour: str) -> None:
        """Points alone."""
        for x, y in starmap(self.at, points):
            self.parts.append(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="{colour}" fill-opacity="0.45"/>'
            )

    def crosses(self, points: Iterable[Point], colour: str) -> None:
        """Points that are told from others without a colour."""
        path = "".join(f"M{x - 2.5:.1f} {y - 2.5:.1f}l5 5m-5 0l5 -5" for x, y in starmap(self.at, points))
        self.parts.append(f'<path d="{path}" stroke="{colour}" stroke-width="1.2"/>')

    def svg(self, title: str, words: str, attributes: str = "") -> str:
        """The whole drawing, with what it is and shows for whoever does not see it."""
        begin = f'<svg viewBox="0 0 {self.width} {self.height}" role="img"{attributes}>'
        return "".join([begin, _named(title, words), *self.parts, self._names, "</svg>"])

    def _joined(self, points: Iterable[Point]) -> str:
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in starmap(self.at, points))

    def _rows(self) -> Iterator[str]:
        values = round_numbers(*self._y)
        digits = max(0, -math.floor(math.log10(nice_step((self._y[1] - self._y[0]) / 4)) + 1e-9))
        for value in values:
            y = self.at(self._x[0], value)[1]
            yield (
                f'<path d="M{LEFT} {y:.1f}H{self.width - RIGHT}" stroke="{LINE if value else SOFT}"/>'
                f'<text x="{LEFT - 7}" y="{y + 4:.1f}" text-anchor="end">{number(value, digits)}</text>'
            )

    def _columns(self, ticks: Sequence[tuple[float, str]]) -> Iterator[str]:
        for value, words in ticks:
            x = self.at(value, self._y[0])[0]
            anchor = "end" if x > self.width - RIGHT - 20 else "middle"
            yield f'<text x="{x:.1f}" y="{self.bottom + 18}" text-anchor="{anchor}">{escape(words)}</text>'


def last_seconds(size: tuple[int, int], values: Iterable[float], name: str, least: float = 0.2) -> Plot:
    """Axes of the last `SPAN_S` before now, which is 0 s, and of values with 0; of no less than a span."""
    finite = [value for value in values if math.isfinite(value)]
    ticks = [(-age, f"−{age:g} s" if age else "now") for age in (20.0, 15.0, 10.0, 5.0, 0.0)]
    return Plot(size, (-SPAN_S, 0.0), with_room(finite, least), y_name=name, x_ticks=ticks)


def with_room(values: Sequence[float], least: float) -> tuple[float, float]:
    """From the least to the greatest and 0, and some room for the name above."""
    low, high = min((*values, 0.0)), max((*values, 0.0))
    span = max(high - low, least)
    return low - 0.06 * span, low + 1.14 * span


def round_numbers(low: float, high: float) -> list[float]:
    """About four round numbers from one to the other."""
    step = nice_step((high - low) / 4)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(i * step, 9) for i in range(first, last + 1)]


def force_svg(series: Mapping[str, Sequence[float]]) -> str:
    """Draw the force over the last seconds.

    Args:
        series: ages of bins in s, oldest first, and the means of each axis.
    """
    plot = last_seconds((640, 250), [v for axis in AXES for v in series[axis]], "N", MIN_SPAN_N)
    for axis, colour in AXES.items():
        aged = zip(series["age_s"], series[axis], strict=True)
        plot.line(
            [(-age, value) for age, value in aged if 0 <= age <= SPAN_S], colour, 2 if axis == "z" else 1.4
        )
    return plot.svg("Force of the last seconds", _force_in_words(series))


def regions_svg(regions: Sequence[Mapping[str, Any]], size_px: tuple[int, int]) -> str:
    """Boxes with names, in the picture's own pixels."""
    unit = size_px[0] / 400
    parts: list[str] = []
    for region in regions:
        x, y, width, height = region["box_px"]
        inset, thick = 0.75 * unit, 1.5 * unit
        parts.append(
            f'<rect x="{x + inset:.2f}" y="{y + inset:.2f}" width="{width - 2 * inset:.2f}" '
            f'height="{height - 2 * inset:.2f}" fill="none" stroke="{BOX}" stroke-width="{thick:.2f}"/>'
            f'<text x="{x + 6 * unit:.2f}" y="{y + 15 * unit:.2f}" fill="{BOX}" stroke="#000" '
            f'stroke-width="{2.5 * unit:.2f}" paint-order="stroke" font-size="{11 * unit:.2f}" '
            f'font-family="system-ui,sans-serif">{escape(str(region["name"]))}</text>'
        )
    return "".join(parts)


def nice_step(step: float) -> float:
    """The next 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(n * power for n in (1, 2, 5, 10) if n * power >= step * (1 - 1e-9))
