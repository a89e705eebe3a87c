"""Page of touches: the pattern, its motion, the shear around a press and an edge, and the course."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from palpate.core import Frame, Readings, new_file
from palpate.estimators.shear import ShearReader, ShearTouch
from palpate.estimators.surface_strain import StrainFields, StrainMeter
from palpate.reports.calibration_figures import ACCENT, BAD, INK, drawn, styled_panels
from palpate.reports.certificate_page import filled_template

SHADES = "GnBu"  # light where nothing is sheared
DEGREE = 3  # of the surface that is drawn: strain comes back 3 % low with it, and 18 % low with 1
MAX_ARROW = 1.6  # pitches, of the longest arrow
MAX_ROWS = 200  # of the table
MIN_COURSE = 3  # frames, from which a course is drawn
FLAGS = ("slip", "damage")


@dataclass(frozen=True, slots=True)
class PageRow:
    """One line of the page's table, as text."""

    frame: str
    contacts: str
    x: str
    y: str
    edge: str
    gamma: str
    seen: str
    notes: str


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A frame whose pictures are drawn."""

    name: str
    frame: Frame
    touch: ShearTouch
    gamma: float


class ShearPage:
    """Page of touches, collected as they are read; images of two frames alone are kept.

    Args:
        source: source of the frames, for the title.
    """

    def __init__(self, source: str, reader: ShearReader, reference: Frame) -> None:
        self._source, self._reader, self._reference = source, reader, reference
        self._unit = "mm" if reader.marks.unit == "m" else "px"
        self._scale = 1e3 if reader.marks.unit == "m" else 1.0
        self._rows: list[PageRow] = []
        self._course: list[tuple[float, float, float]] = []
        self._press: Shown | None = None
        self._edge: Shown | None = None
        self._touched = self._unread = 0
        self._flagged = dict.fromkeys(FLAGS, 0)

    def take(self, name: str, frame: Frame | None, touch: ShearTouch | None, reason: str) -> None:
        if touch is None or frame is None or touch.reason:
            self._unread += 1
            why = reason if touch is None else touch.reason
            self._rows.append(PageRow(name, "–", "–", "–", "–", "–", "–", why))
            self._course.append((math.nan, math.nan, math.nan))
            return
        readings, scale = touch.readings, self._scale
        gamma = readings["gamma_ratio"].value
        self._touched += bool(touch.places.contacts)
        up = [flag for flag in FLAGS if readings[flag].value == "yes"]
        for flag in up:
            self._flagged[flag] += 1
        self._course.append((gamma, scale * readings["x"].value, scale * readings["y"].value))
        self._rows.append(
            PageRow(
                name, readings["contacts"].value, self._text(readings, "x"), self._text(readings, "y"),
                self._text(readings, "edge"), f"{gamma:.3f}", f"{100 * readings['seen_ratio'].value:.0f} %",
                ", ".join(up),
            )
        )  # fmt: skip
        if touch.places.contacts:
            shown = Shown(name, frame, touch, gamma)
            if touch.places.edge is None:
                self._press = _stronger(self._press, shown)
            else:
                self._edge = _stronger(self._edge, shown)

    def write(self, path: Path) -> None:
        """Write the page; it must not exist."""
        strongest = [
            (what, one, touch_pictures(self._reader, one.frame, one.touch))
            for what, one in (("press", self._press), ("edge", self._edge))
            if one is not None
        ]
        page = filled_template(
            "shear.html",
            source=self._source,
            frames=len(self._rows),
            touched=self._touched,
            unread=self._unread,
            flagged=self._flagged,
            marks=len(self._reader.marks.reference),
            unit=self._unit,
            pattern=self._pattern(),
            strongest=strongest,
            course=self._drawn_course() if len(self._rows) >= MIN_COURSE else None,
            rows=self._rows[:MAX_ROWS],
        )
        with new_file(path) as building:
            building.write_text(page, encoding="utf-8")

    def _text(self, readings: Readings, quantity: str) -> str:
        one = readings[quantity]
        if not one.valid:
            return "–"
        shown = one.in_unit({"m": "mm", "rad": "deg"}.get(one.unit, one.unit))
        value = shown.value % shown.period if quantity == "edge" else shown.value
        return f"{value:.2f} ± {(shown.high - shown.low) / 2:.2f}"

    def _pattern(self) -> str:
        marks = self._reader.marks
        places = marks.in_image(marks.reference.places)
        with styled_panels(6.4, 4.6) as (figure, (axes,)):
            _image(axes, self._reference, places)
            axes.plot(*places.T, "+", color="#ffffff", ms=5, mew=1.6)
            axes.plot(*places.T, "+", color=INK, ms=4, mew=0.7)
            axes.set_title(f"untouched pattern, {len(places)} control points", loc="left")
            return drawn(figure)

    def _drawn_course(self) -> str:
        gamma, x, y = np.array(self._course).T
        index = np.arange(len(gamma))
        with styled_panels(11.5, 3.0, 1, 2) as (figure, (left, right)):
            left.plot(index, gamma, color=ACCENT, marker="." if len(index) < 80 else "")
            left.set(xlabel="frame", ylabel="gamma [1]", ylim=(0, None))
            left.set_title("how far the surface has moved", loc="left")
            for values, name, style in ((x, "x", "-"), (y, "y", "--")):
                right.plot(
                    index, values, color=ACCENT if name == "x" else INK, ls=style, marker=".", label=name
                )
            right.set(xlabel="frame", ylabel=f"place [{self._unit}]")
            right.legend(frameon=False)
            right.set_title("place of the first contact", loc="left")
            return drawn(figure)


def touch_pictures(reader: ShearReader, frame: Frame, touch: ShearTouch) -> str:
    """Draw the marks' motion and the shear field with contacts, as a data address."""
    marks = reader.marks
    fields = StrainMeter(marks.reference, DEGREE).fields(touch.points)
    with styled_panels(11.5, 4.6, 1, 2) as (figure, (left, right)):
        rest = marks.in_image(fields.rest)
        _image(left, frame, rest)
        step = marks.in_image(fields.rest + fields.moved) - rest
        longest = float(np.hypot(*step.T).max()) or 1.0
        grow = MAX_ARROW * marks.pitch * marks.px_per_unit / longest
        left.quiver(
            *rest.T, *step.T, color="#ffffff", angles="xy", scale_units="xy", scale=1 / grow, width=0.007
        )
        left.quiver(*rest.T, *step.T, color=INK, angles="xy", scale_units="xy", scale=1 / grow, width=0.0035)
        left.set_title(f"motion of the marks, arrows {grow:.0f} times as long", loc="left")
        _field(right, fields, touch)
        return drawn(figure)


def _field(axes: Axes, fields: StrainFields, touch: ShearTouch) -> None:
    unit, scale = ("mm", 1e3) if fields.unit == "m" else ("px", 1.0)
    shear = fields.greatest_shear
    mesh = axes.pcolormesh(
        *(scale * fields.at), np.ma.masked_invalid(shear), cmap=SHADES, vmin=0, shading="gouraud"
    )
    axes.figure.colorbar(mesh, ax=axes, label="greatest shear [rad]", shrink=0.9)
    seen = fields.basis.supported
    some = np.zeros_like(seen)
    some[4::8, 4::8] = True
    some &= seen
    axes.quiver(
        *(scale * fields.at[:, some]), *(scale * fields.displacement[:, some]), color=INK, angles="xy",
        width=0.0022,
    )  # fmt: skip
    for contact in touch.places.contacts:
        x, y = scale * contact.x, scale * contact.y
        axes.plot(x, y, "+", color=BAD, ms=11, mew=1.8)
        if contact.ring is not None:
            ring = contact.ring
            centre = (scale * ring.x, scale * ring.y)
            axes.add_patch(Circle(centre, scale * ring.radius, fill=False, color=BAD, lw=1.4, ls=(0, (4, 2))))
    edge = touch.places.edge
    if edge is not None:
        first = touch.places.contacts[0]
        half = 0.3 * scale * float(np.ptp(fields.rest[:, 0]))
        dx, dy = half * math.cos(edge.angle_rad), half * math.sin(edge.angle_rad)
        x, y = scale * first.x, scale * first.y
        axes.plot([x - dx, x + dx], [y - dy, y + dy], color=BAD, lw=1.6, ls=(0, (4, 2)))
    axes.set_aspect("equal")
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    axes.set_title("greatest shear, and which way the pattern moved", loc="left")


def _stronger(one: Shown | None, other: Shown) -> Shown:
    return other if one is None or other.gamma > one.gamma else one


def _image(axes: Axes, frame: Frame, places: np.ndarray) -> None:
    axes.imshow(frame.image, cmap="gray")
    (left, top), (right, bottom) = places.min(axis=0) - 30, places.max(axis=0) + 30
    height, width = frame.image.shape[:2]
    axes.set(
        xlim=(max(left, -0.5), min(right, width - 0.5)), ylim=(min(bottom, height - 0.5), max(top, -0.5)),
        xlabel="column [px]", ylabel="row [px]",
    )  # fmt: skip
