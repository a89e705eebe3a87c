"""Drawings of the softness page, as SVG: an object's two curves with what is felt, and force over time."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import pairwise

import numpy as np

from palpate.softness import Mode, RenderingLaw
from palpate.softness.control import LoopSample
from palpate.softness.rendering_law import LIMIT_WORDS
from palpate.studio.page_shell import paint
from palpate.studio.status_text import number
from palpate.studio.svg_drawing import nice_step

INK, SOFT, LINE, ACCENT, BAND, BAD = map(paint, ("ink", "soft", "line", "accent", "band", "bad"))
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 460, 280, 46, 12, 14, 40
SPAN_S = 10.0
MIN_SPAN_N = 0.5
POINTS = 120  # of a curve that is drawn
FELT = 400  # samples that are drawn


class _Axes:
    """Axes from 0 to two ends, with ticks and their words."""

    def __init__(self, x_end: float, y_end: float, x_name: str, y_name: str, x_begin: float = 0.0) -> None:
        self.low, self.high, self.top = x_begin, max(x_end, x_begin + 1e-9), max(y_end, 1e-9)
        self.parts = [self._grid(x_name, y_name)]

    def at(self, x: float, y: float) -> str:
        """A point, held inside the frame."""
        across = min(max((x - self.low) / (self.high - self.low), 0.0), 1.0)
        up = min(max(y / self.top, 0.0), 1.0)
        px = LEFT + across * (WIDTH - LEFT - RIGHT)
        return f"{px:.1f},{HEIGHT - BOTTOM - up * (HEIGHT - TOP - BOTTOM):.1f}"

    def line(self, x: np.ndarray, y: np.ndarray, colour: str, extra: str = "") -> None:
        """Points joined by a line."""
        points = " ".join(self.at(float(a), float(b)) for a, b in zip(x, y, strict=True))
        self.parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" {extra}/>')

    def dots(self, x: Sequence[float], y: Sequence[float], colour: str) -> None:
        """Points alone."""
        for a, b in zip(x, y, strict=True):
            cx, cy = self.at(a, b).split(",")
            self.parts.append(f'<circle cx="{cx}" cy="{cy}" r="2.2" fill="{colour}" fill-opacity="0.45"/>')

    def band(self, low: float, high: float, colour: str) -> None:
        """A stretch of the x axis, shaded."""
        (left, _), (right, _) = (self.at(x, 0.0).split(",") for x in (low, high))
        self.parts.append(
            f'<rect x="{left}" y="{TOP}" width="{max(float(right) - float(left), 0.8):.1f}" '
            f'height="{HEIGHT - TOP - BOTTOM}" fill="{colour}" fill-opacity="0.35"/>'
        )

    def svg(self, title: str, words: str) -> str:
        """The whole drawing, with what it is and shows for whoever does not see it."""
        return (
            f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img"><title>{escape(title)}</title>'
            f"<desc>{escape(words)}</desc>{''.join(self.parts)}</svg>"
        )

    def _grid(self, x_name: str, y_name: str) -> str:
        parts = []
        for value in _ticks(0.0, self.top):
            x, y = self.at(self.low, value).split(",")
            parts.append(
                f'<path d="M{x} {y}H{WIDTH - RIGHT}" stroke="{LINE}"/>'
                f'<text x="{LEFT - 6}" y="{float(y) + 4:.1f}" text-anchor="end">{value:g}</text>'
            )
        for value in _ticks(self.low, self.high):
            x, y = self.at(value, 0.0).split(",")
            parts.append(f'<text x="{x}" y="{float(y) + 15:.1f}" text-anchor="middle">{value:g}</text>')
        parts.append(
            f'<path d="M{LEFT} {HEIGHT - BOTTOM}H{WIDTH - RIGHT}" stroke="{SOFT}"/>'
            f'<text x="{WIDTH - RIGHT}" y="{HEIGHT - 7}" text-anchor="end" class="unit">'
            f"{escape(x_name)}</text>"
            f'<text x="{LEFT + 5}" y="{TOP + 9}" class="unit">{escape(y_name)}</text>'
        )
        return "".join(parts)


def _ticks(low: float, high: float) -> list[float]:
    step = nice_step((high - low) / 4)
    first = int(np.ceil(low / step - 1e-9))
    return [round(i * step, 9) for i in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def area_svg(law: RenderingLaw, felt: Sequence[LoopSample]) -> str:
    """Force over contact area: the object's curve, what cannot be rendered shaded, what is felt as points."""
    curve, end_n = law.object.area, shown_n(law)
    end = float(curve.at_force(end_n))
    axes = _Axes(1e6 * end, end_n, "contact area [mm²]", "force [N]")
    for low, high, limit in stretches(law):
        if limit:
            axes.band(1e6 * low, 1e6 * high, BAND if limit == "onset" else BAD)
    x = np.linspace(float(curve.x[0]), end, POINTS)
    axes.line(1e6 * x, np.asarray(curve.force_at(x)), INK, 'stroke-width="2"')
    shown = _touched(felt) if law.mode is not Mode.KINESTHETIC else []
    axes.dots([1e6 * one.area_m2 for one in shown], [one.force_n for one in shown], ACCENT)
    kept = "not rendered in CM2, a plate is in the display's place" if law.mode is Mode.KINESTHETIC else ""
    return axes.svg("Force over contact area", _words(end_n, shown, kept))


def shown_n(law: RenderingLaw) -> float:
    """Force to which both curves are drawn: what the bounds and the display's base allow [N]."""
    end_n = min(law.object.greatest_n, law.bounds.force_n)
    base_m2 = law.display.greatest_m2
    if law.mode is Mode.KINESTHETIC or base_m2 >= law.object.area.x[-1]:
        return end_n
    return min(end_n, float(law.object.area.force_at(base_m2)))


def displacement_svg(law: RenderingLaw, felt: Sequence[LoopSample]) -> str:
    """Force over displacement: the object's curve, and what is felt as points."""
    curve, end_n = law.object.displacement, shown_n(law)
    end = float(curve.at_force(end_n))
    axes = _Axes(1e3 * end, end_n, "displacement [mm]", "force [N]")
    x = np.linspace(float(curve.x[0]), end, POINTS)
    axes.line(1e3 * x, np.asarray(curve.force_at(x)), INK, 'stroke-width="2"')
    shown = _touched(felt) if law.mode is not Mode.CUTANEOUS else []
    axes.dots([1e3 * one.displacement_m for one in shown], [one.force_n for one in shown], ACCENT)
    kept = "not rendered in CM3, the surface is held still" if law.mode is Mode.CUTANEOUS else ""
    return axes.svg("Force over displacement", _words(end_n, shown, kept))


def time_svg(felt: Sequence[LoopSample]) -> str:
    """Force on the finger over the last seconds."""
    end_s = max(felt[-1].time_s if felt else 0.0, SPAN_S)
    most_n = max((one.force_n for one in felt), default=0.0)
    axes = _Axes(end_s, max(1.1 * most_n, MIN_SPAN_N), "time since it began [s]", "force [N]", end_s - SPAN_S)
    if felt:
        shown = felt[:: max(1, len(felt) // FELT)]
        axes.line(
            np.array([one.time_s for one in shown]), np.array([one.force_n for one in shown]), ACCENT,
            'stroke-width="1.8"',
        )  # fmt: skip
    words = f"{number(felt[-1].force_n, 2)} N now" if felt else "no force yet"
    return axes.svg("Force on the finger over time", words)


def stretches(law: RenderingLaw) -> list[tuple[float, float, str]]:
    """Stretches of area with one verdict: from, to [m^2], and why not rendered; empty in CM2."""
    if law.mode is Mode.KINESTHETIC:
        return []
    state = law.envelope(500)
    ends = [0, *(np.flatnonzero(state.limit[1:] != state.limit[:-1]) + 1).tolist(), len(state.limit)]
    return [
        (float(state.area_m2[low]) if low else 0.0, float(state.area_m2[high - 1]), str(state.limit[low]))
        for low, high in pairwise(ends)
    ]


def envelope_words(law: RenderingLaw) -> list[str]:
    """What a display can render of an object, a line for each stretch of area."""
    if law.mode is Mode.KINESTHETIC:
        return ["CM2: a rigid plate is in the display's place; the arm alone is felt"]
    return [
        f"{1e6 * low:.1f} to {1e6 * high:.1f} mm²: {LIMIT_WORDS[limit] if limit else 'rendered as it is'}"
        for low, high, limit in stretches(law)
    ]


def _touched(felt: Sequence[LoopSample]) -> list[LoopSample]:
    shown = [one for one in felt if one.touched]
    return shown[:: max(1, len(shown) // FELT)]


def _words(greatest_n: float, shown: Sequence[LoopSample], kept: str) -> str:
    felt = f"{len(shown)} points felt, to {number(max(one.force_n for one in shown), 2)} N" if shown else ""
    return "; ".join(one for one in (f"the object's curve to {greatest_n:g} N", felt, kept) if one)
