"""What lies behind the pictures: stress, rays through the rim, the one-slice formula, forces."""

from __future__ import annotations

import math

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from oracles.measured import seen_at
from oracles.palm import GRID_MM
from oracles.shortcuts import FARTHEST, baseline

from drawn import RIM, SPEC, H, R, outer_labels, sheet
from palpate.mechanics.axisymmetric.shape_table import SphereTable, edge_correction, edge_reach
from palpate.mechanics.layers.bonded_layer import sphere_force
from palpate.optics import round_rim
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, INK
from palpate.sensors.palm.fringe_orders import edge_on
from palpate.sensors.palm.palm_press import field_at

N = SPEC.refractive_index
DEPTHS = (1, 2, 3, 4, 5)


def stress() -> Figure:
    """Stress of the mid-plane, and fringe orders of the rays, at three depths."""
    figure, grid = sheet(2, 3, (9.4, 4.1))
    for [above, below], depth in zip(grid.T, (1.0, 3.0, 5.0), strict=True):
        field = field_at(SPEC, depth * 1e-3)
        near = field.r_m * 1e3 <= 12
        r, top = field.r_m[near] * 1e3, field.surface_m[near] * 1e3
        rr, _, zz, rz = field.stress_pa[..., near]
        difference = np.hypot(rr - zz, 2 * rz) / 1e3
        z = top + field.zeta[:, None] * (H - top)
        found = edge_on(SPEC, depth * 1e-3, 161)
        s, down = found.offset_m * 1e3, found.depth_m * 1e3
        order = np.where(down[:, None] < np.interp(s, r, top), np.nan, found.order)
        for side in (-1, 1):
            drawn = above.pcolormesh(
                side * r, z, difference, cmap="viridis", vmin=0, vmax=300, shading="gouraud", rasterized=True
            )
            tinted = below.contourf(side * s, down, order, np.arange(0, 5.6, 0.25), cmap="magma_r")
            below.contour(side * s, down, order, np.arange(0.5, 5.1, 0.5), colors="white", linewidths=0.5)
        for axes in (above, below):
            axes.add_patch(Circle((0, depth - R), R, fc="0.85", ec=INK, lw=0.8, zorder=3))
            axes.set(xlim=(-10, 10), ylim=(H, -3), aspect="equal", yticks=(0, 5, 10))
        above.set(title=f"{depth:g} mm", xticklabels=[])
        below.set(xlabel="x [mm]")
    figure.colorbar(drawn, ax=grid[0], label="σ₁ − σ₂ in the\nmid-plane [kPa]", extend="max", pad=0.01)
    figure.colorbar(tinted, ax=grid[1], label="order at 550 nm", pad=0.01, ticks=range(6))
    for axes in grid[:, 0]:
        axes.set_ylabel("z [mm]")
    return figure


def rim() -> Figure:
    """From above: rays through the rim, what no ray reaches, and the report's grid."""
    figure, [[plan, curves]] = sheet(1, 2, (9.6, 4.8))
    plan.add_patch(Circle((0, 0), RIM, fc=BAND, ec=INK, lw=1))
    _hidden(plan)
    x = np.linspace(-28, 28, 29)
    rays = round_rim(x * 1e-3, RIM * 1e-3, N)
    for at, b, turn, half in zip(x, rays.impact_m, rays.turn_rad, rays.half_chord_m, strict=True):
        c, s = np.cos(turn), np.sin(turn)
        near, far = (1e3 * np.array([b * c + end * s, end * c - b * s]) for end in (half, -half))
        lamp = far - 9 * np.array([np.sin(2 * turn), np.cos(2 * turn)])
        plan.plot(*np.array([[at, 40.0], near, far, lamp]).T, color=ACCENT, lw=0.6)
    for x_mm, y_mm in GRID_MM:
        found = seen_at(x_mm, y_mm) if x_mm else None
        lit = plan.scatter(
            x_mm,
            y_mm,
            c=2 * abs(found[2]) if found else 0.0,
            cmap="inferno_r",
            vmin=0,
            vmax=90,
            s=34,
            ec=INK,
            lw=0.5,
            zorder=3,
        )
    plan.add_patch(Circle((21, -7), R, fill=False, ec=INK, lw=0.8, ls=":", zorder=3))
    plan.text(0, 41, "to the camera", ha="center", va="top", fontsize=8)
    plan.text(0, -39, "from the lamp", ha="center", va="bottom", fontsize=8)
    plan.set(xlim=(-45, 45), ylim=(45, -43), aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    plan.set_title("from above; grey: no ray passes")
    figure.colorbar(lit, ax=plan, label="lamp's angle that a place needs [degrees]", shrink=0.8)
    fine = np.linspace(0, RIM, 2000)[:-1]
    rays = round_rim(fine * 1e-3, RIM * 1e-3, N)
    curves.plot(fine, 100 * rays.transmission, color=ACCENT, label="light through both walls [%]")
    curves.plot(fine, 2 * np.degrees(rays.turn_rad), color=BAD, label="lamp's angle [degrees]")
    curves.plot(fine, rays.impact_m * 1e3, color=INK, label="ray inside, from the axis [mm]")
    curves.set(xlabel="column [mm from the axis]", ylim=(0, 100), xlim=(0, RIM), title="column by column")
    curves.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(0.0, 0.62))
    return figure


def _hidden(plan: Axes) -> None:
    """Places that every ray passes on the same side."""
    side = np.linspace(-RIM, RIM, 300)
    x, y = np.meshgrid(side, side)
    angle = np.linspace(-math.pi / 2, math.pi / 2, 801)[1:-1]
    most, least = np.full(x.shape, -np.inf), np.full(x.shape, np.inf)
    rays = round_rim(RIM * np.sin(angle), RIM, N)
    for b, turn in zip(rays.impact_m, rays.turn_rad, strict=True):
        offset = b - x * np.cos(turn) + y * np.sin(turn)
        most, least = np.maximum(most, offset), np.minimum(least, offset)
    hidden = np.where(x**2 + y**2 < RIM**2, np.maximum(-most, least), np.nan)
    plan.contourf(x, y, hidden, (0, np.inf), colors="0.55")


def single_slice() -> Figure:
    """The one-slice formula beside the march, 3 mm deep at 550 nm."""
    whole, best, marched, path, s, z = baseline(SPEC, 3e-3)
    figure, grid = sheet(2, 2, (9.4, 3.8))
    top, bottom = z[0] * 1e3, z[-1] * 1e3
    across = s[0] * 1e3, s[-1] * 1e3
    for axes, picture, title in zip(
        grid.ravel(),
        (marched, whole, best, best - marched),
        (
            "marched, slice by slice",
            "one slice, path 57 mm",
            f"one slice, best path ({path * 1e3:.1f} mm)",
            "best path \N{MINUS SIGN} marched",
        ),
        strict=True,
    ):
        off = picture is not marched and picture is not whole and picture is not best
        drawn = axes.imshow(
            picture,
            extent=(*across, bottom, top),
            cmap="RdBu_r" if off else "gray",
            vmin=-0.6 if off else 0,
            vmax=0.6 if off else 1,
        )
        axes.set(title=title, yticks=(4, 6, 8, 10), xticks=(-10, -5, 0, 5, 10))
        figure.colorbar(drawn, ax=axes, shrink=0.75, aspect=12)
    outer_labels(grid, "x [mm]")
    return figure


def off_centre() -> Figure:
    """How much too high the force of a centred table is, by place."""
    figure, [[curve, plan]] = sheet(1, 2, (9.4, 4.0))
    solved = (0, 1.4, 2.8, 3.96, 4.2, FARTHEST, edge_reach(H / R).offset)
    offsets = np.linspace(0, solved[-1], 90)
    shades = mpl.colormaps["viridis"](np.linspace(0.9, 0.1, 5))
    for depth, colour in zip(DEPTHS, shades, strict=True):
        curve.plot(offsets * R, [_too_high(c, depth) for c in offsets], color=colour, label=f"{depth} mm")
    for depth, colour in zip(DEPTHS, shades, strict=True):
        curve.plot([R * c for c in solved], [_too_high(c, depth) for c in solved], "o", ms=3, color=colour)
    curve.set(xlabel="ball's axis from the membrane's [mm]", ylabel="force too high by [%]", ylim=(0, None))
    curve.set_title("palm's membrane; dots: solved")
    curve.legend(frameon=False, title="depth", fontsize=8)
    plan.add_patch(Circle((0, 0), RIM, fc=BAND, ec=INK, lw=1))
    for x, y in GRID_MM:
        worst = max(_too_high(min(math.hypot(x, y) / R, FARTHEST), d) for d in DEPTHS)
        drawn = plan.scatter(x, y, c=worst, cmap="YlOrRd", vmin=0, vmax=12, s=300, ec=INK, lw=0.4)
        words = f"{worst:.0f}" if worst >= 0.95 or not worst else f"{worst:.1f}"
        ink = "white" if worst > 8 else INK
        plan.text(x, y, words, color=ink, ha="center", va="center", fontsize=8)
    plan.set(xlim=(-30, 30), ylim=(30, -30), aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    plan.set_title("worst of 1 to 5 mm [%]")
    figure.colorbar(drawn, ax=plan, label="force too high by [%]", shrink=0.85)
    return figure


def _too_high(offset: float, depth: float) -> float:
    return 100 * (1 / edge_correction(offset, depth / R, H / R).force_ratio - 1)


def _dimitriadis(chi: float) -> float:
    """Force on a bonded layer over Hertz's: the series in sqrt(R d)/h at nu = 0.49.

    E. K. Dimitriadis et al., Biophys. J. 82 (2002) 2798, doi:10.1016/S0006-3495(02)75620-8.
    """
    nu, x = 0.49, chi / math.pi
    alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    third = alpha**3 + 4 * math.pi**2 / 15 * beta
    fourth = alpha * (alpha**3 + 3 * math.pi**2 / 5 * beta)
    return 1 - 2 * alpha * x + 4 * alpha**2 * x**2 - 8 * third * x**3 + 16 * fourth * x**4


def forces() -> Figure:
    """Force over depth: the table and what simpler laws give."""
    figure, [[left, right]] = sheet(1, 2, (9.4, 3.6))
    unit = SPEC.youngs_modulus_pa * SPEC.indenter_radius_m**2
    d = np.linspace(0.02, 1, 60)  # in ball radii
    table = SphereTable.load("sphere-h2-mu0")
    solved = np.array([table.at(c).force for c in d])
    hertz = 4 / 3 / (1 - 0.49**2) * d**1.5
    linear_to = d <= 0.4  # of the layer's thickness a fifth
    linear = np.array([sphere_force(c, 1.0, 2.0, 1.0, 0.49) for c in d[linear_to]])
    series = hertz * np.array([_dimitriadis(math.sqrt(c) / 2) for c in d])
    rough = SphereTable.load("sphere-h2-mu05")
    stuck = np.array([rough.at(c).force for c in d])
    for at, force, label, style in (
        (d, solved, "finite strain (the palm's)", {"color": ACCENT, "lw": 2}),
        (d, stuck, "the same, friction 0.5", {"color": ACCENT, "ls": "--"}),
        (d, hertz, "Hertz, half-space", {"color": INK}),
        (d[linear_to], linear, "exact linear layer, to h/5", {"color": BAD}),
        (d, series, "Dimitriadis's series", {"color": BAD, "ls": ":"}),
    ):
        left.plot(at * R, force * unit, label=label, **style)
        right.plot(at * R, 100 * (force / solved[: len(at)] - 1), **style)
    left.set(xlabel="depth [mm]", ylabel="force [N]", title="force", xlim=(0, 5), ylim=(0, 28))
    left.legend(frameon=False, fontsize=8)
    right.set(xlabel="depth [mm]", ylabel="[%]", title="over the palm's force", xlim=(0, 5), ylim=(-40, 45))
    return figure
