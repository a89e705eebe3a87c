"""Drawings of the pages, as SVG: the places of a plan, the force over time, regions over a picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
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
WIDTH, HEIGHT = 640, 250
BOX = "#ffd75e"  # seen on dark pictures and bright ones, with a black edge
LEFT, RIGHT, TOP, BOTTOM = 52, 10, 12, 26


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


def force_svg(series: Mapping[str, Sequence[float]]) -> str:
    """Force along x, y and z over the last seconds."""
    ages = series["age_s"]
    values = [v for axis in AXES for v in series[axis]]
    low, high = _range(values)
    step = nice_step((high - low) / 4)
    digits = max(0, -math.floor(math.log10(step) + 1e-9))

    def across(age: float) -> float:
        return LEFT + (1 - age / SPAN_S) * (WIDTH - LEFT - RIGHT)

    def down(value: float) -> float:
        return TOP + (high - value) / (high - low) * (HEIGHT - TOP - BOTTOM)

    parts = [
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img">',
        _named("Force of the last seconds", _force_in_words(series)),
    ]
    first = math.ceil(low / step - 1e-9)
    for i in range(first, math.floor(high / step + 1e-9) + 1):
        y, zero = down(i * step), i == 0
        parts.append(
            f'<path d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}" stroke="{SOFT if zero else LINE}" '
            f'stroke-width="{1.2 if zero else 1}"/>'
            f'<text x="{LEFT - 7}" y="{y + 4:.1f}" text-anchor="end">{number(i * step, digits)}</text>'
        )
    for age in (20, 15, 10, 5, 0):
        anchor = "end" if age == 0 else "middle"
        age_text = "now" if age == 0 else f"−{age} s"
        parts.append(f'<text x="{across(age):.1f}" y="{HEIGHT - 7}" text-anchor="{anchor}">{age_text}</text>')
    parts.append(f'<text x="{LEFT + 5}" y="{TOP + 9}" class="unit">N</text>')
    for axis, colour in AXES.items():
        points = " ".join(
            f"{across(age):.1f},{down(value):.1f}"
            for age, value in zip(ages, series[axis], strict=True)
            if 0 <= age <= SPAN_S
        )
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" '
            f'stroke-width="{2 if axis == "z" else 1.4}" stroke-linejoin="round"/>'
        )
    parts.append("</svg>")
    return "".join(parts)


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


def _range(values: Sequence[float]) -> tuple[float, float]:
    low, high = min((*values, 0.0)), max((*values, 0.0))
    if high - low < MIN_SPAN_N:
        middle = (high + low) / 2
        low, high = middle - MIN_SPAN_N / 2, middle + MIN_SPAN_N / 2
    room = 0.06 * (high - low)
    return low - room, high + room


def nice_step(step: float) -> float:
    """The next 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(n * power for n in (1, 2, 5, 10) if n * power >= step * (1 - 1e-9))
