"""What a camera would see: the palm's frame, depths, places, paths, materials and other probes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from drawn import AS_SEEN, DPI, SPEC, H, R, light, outer_labels, sheet, show
from oracles import first_prototype
from palpate.core import Pose
from palpate.optics.colour import encode_srgb
from palpate.reports.calibration_figures import ACCENT, BAND, INK
from palpate.sensors import palm
from palpate.sensors.palm import View, mirror_view as mirrors
from palpate.sensors.palm.membrane_faults import Wear, worn
from palpate.sensors.palm.palm_press import depth_of_force, pressed
from palpate.sensors.palm.palm_render import BACKGROUND


def frame() -> Figure:
    """The camera's whole frame."""
    seen = np.tile(encode_srgb(np.full((1, 1, 3), BACKGROUND)), (*SPEC.frame_px[::-1], 1))
    for view, picture in zip((SPEC.fringes, SPEC.mirror), light(5, -2, 3), strict=True):
        x, y, w, h = view.box_px
        seen[y : y + h, x : x + w] = picture
    figure, [[axes]] = sheet(1, 1, (7.6, 4.5))
    axes.imshow(seen)
    axes.set_axis_off()
    for at, to, words in (
        ((1135, 115), (1500, 40), "ball, above the membrane"),
        ((1130, 262), (1480, 520), "fringes, through the round rim"),
        ((660, 170), (330, 40), "rest surface"),
        ((1100, 790), (1620, 760), "ball, through the mirror:\ncontact above, its side below"),
        ((795, 880), (330, 800), "membrane's edge"),
    ):
        axes.annotate(
            words,
            at,
            to,
            color="white",
            fontsize=8,
            ha="center",
            va="center",
            arrowprops={"arrowstyle": "-", "color": "white", "lw": 0.7},
        )
    for view in (SPEC.fringes, SPEC.mirror):
        x, y, w, h = view.box_px
        axes.add_patch(Rectangle((x, y), w, h, fill=False, ec=BAND, lw=0.8, ls="--"))
    return figure


def depths() -> Figure:
    """The edge-on view as the ball goes down."""
    figure, grid = sheet(3, 2, (9.4, 6.4))
    for axes, depth in zip(grid.ravel(), (0.5, 1, 2, 3, 4, 5), strict=True):
        show(axes, light(0, 0, depth)[0], SPEC.fringes, (-20, 20))
        axes.set_title(f"{depth:g} mm, {palm.press(SPEC, Pose(0.0, 0.0, depth * 1e-3)).force_n:.1f} N")
    outer_labels(grid, AS_SEEN)
    return figure


def places() -> Figure:
    """The edge-on view as the ball moves, 3 mm deep."""
    figure, grid = sheet(3, 2, (9.4, 5.2))
    for axes, (x, y) in zip(
        grid.ravel(), ((0, 0), (14, 0), (0, 14), (21, 7), (0, -14), (21, -7)), strict=True
    ):
        show(axes, light(x, y, 3)[0], SPEC.fringes, (-30, 30))
        axes.set_title(f"ball at ({x}, {y}) mm".replace("-", "\N{MINUS SIGN}"))
    outer_labels(grid, AS_SEEN)
    return figure


def mirror() -> Figure:
    """How the mirror's lines of sight reach the dimple, and what they see."""
    figure = Figure(figsize=(9.4, 3.0), layout="constrained", dpi=DPI)
    side, *seen = figure.subplots(1, 4, width_ratios=(1.5, 1, 1, 1))
    depth, up = 3.0, SPEC.mirror_elevation_rad
    press = pressed(SPEC, depth * 1e-3)
    r, top = press.r * R, press.surface * R
    y = np.linspace(-16, 16, 400)
    side.fill_between(y, np.interp(abs(y), r, top), H, color=BAND, lw=0)
    side.add_patch(Circle((0, depth - R), R, fc="0.85", ec=INK, lw=0.8))
    inside = math.asin(math.cos(up) / SPEC.refractive_index)
    for entry in np.linspace(-6, 12, 9):
        z = np.linspace(H, 0, 400)
        at = entry - (H - z) * math.tan(inside)
        clear = np.flatnonzero(z <= np.interp(abs(at), r, top))
        stop = clear[0] if len(clear) else len(z) - 1
        touching = abs(at[stop]) < press.contact_radius * R
        below = np.array([[entry + (19 - H) / math.tan(up), 19.0], [entry, H], [at[stop], z[stop]]])
        side.plot(*below.T, color=ACCENT if touching else "0.45", lw=0.9)
    side.text(-15, 8.8, "membrane", fontsize=8)
    side.text(-15, 15.5, "from the mirror,\n60° up", fontsize=8, va="center")
    side.set(xlim=(-16, 20), ylim=(19, -7), aspect="equal", xlabel="y [mm], camera to the right")
    side.set(ylabel="z [mm]", title="3 mm deep, from the side")
    for axes, d in zip(seen, (1, 3, 5), strict=True):
        cx, cy = mirrors.contact_px(SPEC, 0.0, 0.0, d * 1e-3)
        whole = light(0, 0, d)[1]
        left, upper = int(cx) - 80, int(cy) - 75
        axes.imshow(whole[upper : upper + 160, left : left + 160], interpolation="antialiased")
        axes.set(title=f"seen at {d} mm", xticks=(), yticks=())
        axes.spines[:].set_visible(False)
    return figure


def paths() -> Figure:
    """The first prototype's picture beside the folded path's."""
    figure, grid = sheet(2, 2, (9.4, 4.4))
    for [left, right], depth in zip(grid, (3, 5), strict=True):
        contact = palm.press(SPEC, Pose(0.0, 0.0, depth * 1e-3))
        seen = first_prototype.from_below(contact, SPEC)
        half = seen.x_m[-1] * 1e3
        left.imshow(encode_srgb(seen.light), extent=(-half, half, half, -half))
        left.set(title=f"from below, {depth} mm", ylabel="y [mm]", xlim=(-20, 20), ylim=(8, -8))
        show(right, light(0, 0, depth)[0], SPEC.fringes, (-20, 20))
        right.set(title=f"edge-on, {depth} mm", ylabel="z [mm]")
    grid[1, 0].set_xlabel("x [mm]")
    grid[1, 1].set_xlabel("column [mm]")
    return figure


def materials() -> Figure:
    """Three membranes under 5 and 15 N; the hard one also close up."""
    figure, grid = sheet(4, 2, (9.4, 8.4))
    rows: list[tuple[str, float]] = [
        ("solaris", 1),
        ("sylgard-184", 1),
        ("casting-resin", 1),
        ("casting-resin", 15),
    ]
    for axes_row, (name, closer) in zip(grid, rows, strict=True):
        spec = palm.preset(name)
        pitch = spec.fringes.pitch_m / closer
        spec = replace(spec, fringes=View(spec.fringes.box_px, pitch, spec.fringes.middle_px))
        for axes, force in zip(axes_row, (5.0, 15.0), strict=True):
            depth = depth_of_force(spec, force) * 1e3
            show(axes, light(0, 0, depth, spec)[0], spec.fringes, (-20 / closer, 20 / closer))
            axes.set_ylim(11.5 / closer, -4.5 / closer)
            ticks = np.array((0, 5, 10)) if closer == 1 else np.array((0, 0.4))
            axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
            axes.set_title(f"{name}, {force:g} N, {depth:.2g} mm deep" + (", close up" * (closer > 1)))
    outer_labels(grid, "column [mm]")
    return figure


def indenters() -> Figure:
    """Probes other than the palm's ball, deep where they have a table, and a ball pulled sideways."""
    figure, grid = sheet(3, 2, (9.4, 6.4))
    asked = (
        ("punch:8", 3.0, 0.0),
        ("edge:12:90", 2.2, 0.0),
        ("cylinder:6:12", 2.5, 0.0),
        ("cylinder:6:12:90", 2.5, 0.0),
        ("two-points:5:8", 2.5, 0.0),
        ("sphere:10", 1.2, 1.0),
    )
    for axes, (words, depth_mm, pull) in zip(grid.ravel(), asked, strict=True):
        probe = palm.parse_probe(words)
        contact = palm.press(SPEC, Pose(0.0, 0.0, depth_mm * 1e-3), probe, (pull, 0.0))
        show(axes, encode_srgb(palm.render_clean(contact, SPEC)[0]), SPEC.fringes, (-20, 20))
        pulled = f", pulled right with {pull:g} N" if pull else ""
        axes.set_title(f"{words}, {depth_mm:g} mm, {contact.force_n:.1f} N{pulled}")
    outer_labels(grid, "column [mm]")
    return figure


def worn_and_lit() -> Figure:
    """Worn membranes and other light edge-on, and what the mirror shows with and without the probe's body."""
    figure = Figure(figsize=(9.4, 7.6), layout="constrained", dpi=DPI)
    above, under = figure.subfigures(2, 1, height_ratios=(1.9, 1), squeeze=False)[:, 0]
    edge_on: tuple[tuple[str, dict[str, Any]], ...] = (
        ("new", {}),
        ("haze 0.15", {"wear": Wear(haze=0.15)}),
        ("20 scratches", {"wear": Wear(scratches=20)}),
        ("yellowing 0.4", {"wear": Wear(yellowing=0.4)}),
        ("20 000 presses, by the assumed law", {"wear": worn(20_000)}),
        ("room light 0.05, lamp 60 mired warmer", {"ambient": 0.05, "lamp_mired": 60.0}),
    )
    grid = above.subplots(3, 2)
    for axes, (title, changed) in zip(grid.ravel(), edge_on, strict=True):
        show(axes, light(0, 0, 3, replace(SPEC, **changed))[0], SPEC.fringes, (-30, 30))
        axes.set_title(title)
    outer_labels(grid, AS_SEEN)
    cx, cy = (int(middle) for middle in mirrors.contact_px(SPEC, 0.0, 0.0, 3e-3))
    below: tuple[tuple[str, dict[str, Any]], ...] = (
        ("new", {}),
        ("20 000 presses", {"wear": worn(20_000)}),
        ("probe out of sight", {"probe_in_mirror": False}),
        ("opaque underside", {"opaque_underside": True}),
        ("no membrane", {"membrane": False}),
    )
    for axes, (title, changed) in zip(under.subplots(1, len(below)), below, strict=True):
        whole = light(0, 0, 3, replace(SPEC, **changed))[1]
        axes.imshow(whole[cy - 70 : cy + 110, cx - 90 : cx + 90], interpolation="antialiased")
        axes.set(title=title, xticks=(), yticks=())
        axes.spines[:].set_visible(False)
    return figure
