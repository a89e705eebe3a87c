"""Drawings of live readings, as SVG: a value with its interval over the last seconds, and its place."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any

from palpate.studio.live.live_desk import SPAN_S, LiveSample
from palpate.studio.page_shell import paint
from palpate.studio.status_text import number
from palpate.studio.svg_drawing import BOX, last_seconds

MIN_ARROWS = 4  # of marks, whose mean is a motion
MOTION_TIMES = 3.0  # by which that mean is drawn longer
FULL_SHEAR = 0.1  # that is drawn as large as a dot can be, where nothing is greater
GAP_S = 1.0
"""Time without a reading over which no line is drawn [s]."""
INK, SOFT, LINE, ACCENT, BAND, BAD, BESIDE = map(
    paint, ("ink", "soft", "line", "accent", "band", "bad", "axis-x")
)
Point = tuple[float, float]


def reading_svg(samples: Sequence[LiveSample], column: str, unit: str, now_s: float, name: str = "") -> str:
    """Draw a reading and its interval over the last `SPAN_S`, with the force sensor if both are in N.

    Invalid readings are crosses without an interval, so they are distinguishable without color.
    """
    told = [(one.at_s, one.readings[column]) for one in samples if column in one.readings]
    told = [(at, one) for at, one in told if one.get("value") is not None]
    force = [(one.at_s, one.force_n) for one in samples if one.force_n is not None] if unit == "N" else []
    ends = [
        one[key] for _, one in told if one["valid"] for key in ("low", "high") if one.get(key) is not None
    ]
    values = [one["value"] for _, one in told] + [f for _, f in force] + ends
    name = name or column.removesuffix(f"_{unit}")
    shown = f"{name} [{unit}]" if unit not in ("", "ratio") else name
    plot = last_seconds((560, 180), values, shown + ("; dashed: the sensor beside" if force else ""))
    for valid, group in groupby(told, key=lambda one: bool(one[1]["valid"])):
        part = list(group)
        if not valid:
            seen = part[:: max(1, len(part) // 150)]
            plot.crosses([(at - now_s, one["value"]) for at, one in seen], BAD)
            continue
        for stretch in _stretches(part):
            lows, highs = (
                [(at - now_s, one[end]) for at, one in stretch if one.get(end) is not None]
                for end in ("low", "high")
            )
            plot.band(lows, highs, BAND)
            plot.line([(at - now_s, one["value"]) for at, one in stretch], ACCENT, 2)
    for stretch in _stretches(force):
        plot.line([(at - now_s, value) for at, value in stretch], BESIDE, 1.4, "5 3")
    words = "no reading yet"
    if told:
        last = told[-1][1]
        words = f"{number(last['value'], 2)} {unit} now, {'valid' if last['valid'] else 'not valid'}"
    return plot.svg(f"{name} of the last {SPAN_S:g} s", words)


def _stretches(points: Sequence[tuple[float, Any]]) -> list[list[tuple[float, Any]]]:
    """Points parted where nothing was told for `GAP_S`."""
    parts: list[list[tuple[float, Any]]] = []
    for point in points:
        if not parts or point[0] - parts[-1][-1][0] > GAP_S:
            parts.append([])
        parts[-1].append(point)
    return parts


def place_svg(readings: Mapping[str, Mapping[str, Any]]) -> str:
    """Draw the contact location with both intervals and the shear arrow; "" without such readings.

    x points right and y down, as in the image; the frame is the calibrated range.
    """
    x, y = readings.get("x_mm"), readings.get("y_mm")
    if not x or not y:
        return ""
    left, right = x.get("range") or (-20.0, 20.0)
    top, bottom = y.get("range") or (-20.0, 20.0)
    wide, high = max(right - left, 1e-6), max(bottom - top, 1e-6)
    edge, thick = 0.08 * max(wide, high), max(wide, high) / 160
    read = x.get("value") is not None and y.get("value") is not None
    valid = read and x["valid"] and y["valid"]
    colour = ACCENT if valid else BAD
    box = f"{left - edge:.3f} {top - edge:.3f} {wide + 2 * edge:.3f} {high + 2 * edge:.3f}"
    said = "no place is read"
    if read:
        said = f"x {number(x['value'], 1)}, y {number(y['value'], 1)} mm, {'valid' if valid else 'not valid'}"
    begin = (
        f'<svg viewBox="{box}" role="img"><title>Place on the skin</title><desc>{said}</desc>'
        f'<rect x="{left:.3f}" y="{top:.3f}" width="{wide:.3f}" height="{high:.3f}" rx="{edge / 2:.3f}" '
        f'fill="none" stroke="{SOFT}" stroke-width="{thick:.3f}"/>'
    )
    parts = [begin]
    if not read:
        return f"{begin}</svg>"
    if valid and None not in (x.get("low"), x.get("high"), y.get("low"), y.get("high")):
        parts.append(
            f'<rect x="{x["low"]:.3f}" y="{y["low"]:.3f}" width="{max(x["high"] - x["low"], 0):.3f}" '
            f'height="{max(y["high"] - y["low"], 0):.3f}" fill="{BAND}" fill-opacity="0.8"/>'
        )
    parts.append(_cross(x["value"], y["value"], max(wide, high) / 28, thick * 2, colour))
    parts.append(_arrow(readings, x["value"], y["value"], max(wide, high) / 5, thick * 2))
    return "".join([*parts, "</svg>"])


def _cross(x: float, y: float, arm: float, thick: float, colour: str) -> str:
    path = f"M{x - arm:.3f} {y:.3f}h{2 * arm:.3f}M{x:.3f} {y - arm:.3f}v{2 * arm:.3f}"
    return f'<path d="{path}" stroke="{colour}" stroke-width="{thick:.3f}"/>'


def _arrow(
    readings: Mapping[str, Mapping[str, Any]], x: float, y: float, longest: float, thick: float
) -> str:
    """Arrow of the shear force, its length as a share of the largest that was calibrated."""
    along, across = readings.get("force_x_N"), readings.get("force_y_N")
    if not along or not across or along.get("value") is None or across.get("value") is None:
        return ""
    most = max(*(abs(v) for one in (along, across) for v in one.get("range") or (1.0,)), 1e-6)
    dx, dy = (longest * min(max(one["value"] / most, -1.0), 1.0) for one in (along, across))
    shaft = f'<path d="M{x:.3f} {y:.3f}l{dx:.3f} {dy:.3f}" stroke="{INK}" stroke-width="{thick:.3f}"/>'
    return shaft + _head((x, y), (x + dx, y + dy), 2.5 * thick, INK)


def _head(start: Point, end: Point, size: float, colour: str) -> str:
    """Head of an arrow, a triangle at its end; "" for one without a length."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)
    if length < 1e-9:
        return ""
    ux, uy = size * dx / length, size * dy / length
    left, right = (end[0] - ux - uy / 2, end[1] - uy + ux / 2), (end[0] - ux + uy / 2, end[1] - uy - ux / 2)
    points = " ".join(f"{x:.3f},{y:.3f}" for x, y in (end, left, right))
    return f'<polygon points="{points}" fill="{colour}"/>'


def lateral_motion(overlay: Mapping[str, Any] | None) -> tuple[Point, Point] | None:
    """Return start and mean vector of the arrows of a skin's marks [px]; None below four arrows.

    A normal press moves marks apart in all directions, which cancels; a lateral push does not.
    """
    arrows = (overlay or {}).get("arrows") or ()
    if len(arrows) < MIN_ARROWS:
        return None
    times = float((overlay or {}).get("arrow_times") or 1.0)
    x, y, to_x, to_y = (
        sum(one[end][axis] for one in arrows) / len(arrows) for end in ("start", "end") for axis in (0, 1)
    )
    return (x, y), ((to_x - x) / times, (to_y - y) / times)


def strain_svg(strain: Mapping[str, Any] | None, size_px: tuple[int, int]) -> str:
    """The strain of a patterned skin as the camera sees it: the larger a dot, the greater the shear.

    Crosses mark contacts, an arrow how one has shifted. "" without a patterned skin.
    """
    if not strain:
        return ""
    left, top, wide, high = strain.get("box") or (0.0, 0.0, *size_px)
    unit, dots = wide / 400, strain.get("dots") or ()
    greatest = strain.get("greatest")
    full = max(float(greatest or 0.0), FULL_SHEAR)
    reach = 0.55 * float(strain.get("spacing_px") or 0.0)
    words = "the frame could not be read"
    if greatest is not None:
        words = f"greatest shear {number(float(greatest), 2)}, {len(strain.get('contacts') or ())} contacts"
    begin = (
        f'<svg viewBox="{left - unit:.1f} {top - unit:.1f} {wide + 2 * unit:.1f} {high + 2 * unit:.1f}" '
        f'role="img"><title>Strain of the skin</title><desc>{words}</desc>'
    )
    inner = f'x="{left:.1f}" y="{top:.1f}" width="{wide:.1f}" height="{high:.1f}" fill="none"'
    parts = [f'{begin}<rect {inner} stroke="{SOFT}" stroke-width="{unit:.2f}"/>']
    for x, y, shear in dots:
        share = min(float(shear) / full, 1.0)
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{reach * math.sqrt(share):.1f}" fill="{ACCENT}" '
            f'fill-opacity="{0.35 + 0.6 * share:.2f}"/>'
        )
    for x, y in strain.get("contacts") or ():
        parts.append(_cross(x, y, 9 * unit, 1.8 * unit, INK))
    if shift := strain.get("shift"):
        parts.append(_long_arrow(shift["start"], shift["end"], 2.4 * unit, INK))
    return "".join([*parts, "</svg>"])


def strain_words(strain: Mapping[str, Any] | None) -> str:
    """What the drawing of strain shows, in words; "" without one."""
    if not strain:
        return ""
    greatest = strain.get("greatest")
    if greatest is None:
        return "This frame's strain could not be read."
    told = f"Greatest shear {number(float(greatest), 2)} (change of a right angle, in rad). "
    full = max(float(greatest), FULL_SHEAR)
    told += f"A dot is as large as its shear, the largest at {number(full, 2)}; crosses are contacts."
    if shift := strain.get("shift"):
        told += (
            f" The contact has shifted by {number(float(shift['mm']), 2)} mm, drawn {shift['times']:g} times."
        )
    return told


def _long_arrow(start: Sequence[float], end: Sequence[float], thick: float, colour: str) -> str:
    (x, y), (to_x, to_y) = start, end
    shaft = f'<path d="M{x:.1f} {y:.1f}L{to_x:.1f} {to_y:.1f}" stroke="{colour}" stroke-width="{thick:.2f}"/>'
    return shaft + _head((x, y), (to_x, to_y), 4 * thick, colour)


def overlay_svg(image: Mapping[str, Any] | None, size_px: tuple[int, int]) -> str:
    """What is drawn over a live picture: where it differs from the untouched sensor, how marks have moved.

    The outline is of the contact; thin arrows are of marks, the thick one is their mean, three times as long.
    """
    place = (image or {}).get("centre_px")
    shapes = (image or {}).get("overlay")
    unit = size_px[0] / 400
    parts = [
        _shape(kind, one, unit)
        for kind in ("lines", "dots", "arrows")
        for one in (shapes or {}).get(kind) or ()
        if one.get("role") != "skin"
    ]
    if (motion := lateral_motion(shapes)) is not None:
        (x, y), (dx, dy) = motion
        end = (x + MOTION_TIMES * dx, y + MOTION_TIMES * dy)
        parts += [_long_arrow((x, y), end, width * unit, colour) for colour, width in (("#000", 5), (BOX, 3))]
    if not any(one.get("role") == "region" for one in (shapes or {}).get("lines") or ()) and place:
        x, y = place
        ring = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{14 * unit:.1f}" fill="none"'
        for colour, width in (("#000", 4), (BOX, 2)):
            parts.append(f'{ring} stroke="{colour}" stroke-width="{width * unit:.1f}"/>')
    return "".join(parts)


LEGEND_PX = (26, 18)  # width and height of a sign


def shows_marks(overlay: Mapping[str, Any]) -> bool:
    """Whether an overlay follows a skin's marks: then their signs belong in its legend."""
    every = (*(overlay.get("dots") or ()), *(overlay.get("arrows") or ()))
    return any(one.get("role") == "mark" for one in every)


def overlay_legend(overlay: Mapping[str, Any], *, marked: bool) -> str:
    """Explain the shapes over a live picture, which differ in shape and not only in color.

    Args:
        marked: Add the signs of tracked marks.
    """
    times = float(overlay.get("arrow_times") or 1.0)
    longer = "" if times == 1 else f", {times:g} times as long"
    square = [(6, 3), (19, 2), (21, 14), (7, 15)]
    signs = [
        (_shape("lines", {"points": square}, 1.0), "outline: where it differs from the untouched sensor"),
        (_shape("dots", {"role": "centre", "at": (13, 9)}, 0.8), "cross or ring: the middle of that"),
    ]
    if marked:
        thick = "".join(
            _long_arrow((3, 9), (22, 9), width, colour) for colour, width in (("#000", 4), (BOX, 2.6))
        )
        signs += [
            (_shape("dots", {"at": (13, 9)}, 1.0), "dot: a mark that has not moved"),
            (
                _shape("arrows", {"start": (4, 9), "end": (22, 9)}, 1.1),
                f"thin arrow: how a mark moved{longer}",
            ),
            (thick, f"thick arrow: their mean, {MOTION_TIMES:g} times as long"),
        ]
    width, height = LEGEND_PX
    items = "".join(
        f'<li><svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" aria-hidden="true">{sign}'
        f"</svg>{escape(words)}</li>"
        for sign, words in signs
    )
    return f'<ul aria-label="Signs over the picture">{items}</ul>'


def _shape(kind: str, one: Mapping[str, Any], unit: float) -> str:
    stroke = f'fill="none" stroke="{BOX}" stroke-width="{1.6 * unit:.2f}"'
    match kind:
        case "lines":
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in one["points"])
            edge = f'fill="none" stroke="#000" stroke-width="{3.4 * unit:.2f}"'
            return f'<polygon points="{points}" {edge}/><polygon points="{points}" {stroke}/>'
        case "dots":
            x, y = one["at"]
            if one.get("role") == "centre":
                return "".join(_cross(x, y, 8 * unit, w * unit, c) for c, w in (("#000", 3.2), (BOX, 1.6)))
            return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{2.2 * unit:.1f}" fill="{BOX}"/>'
        case "arrows":
            return _long_arrow(one["start"], one["end"], 1.1 * unit, BOX)
    return ""
