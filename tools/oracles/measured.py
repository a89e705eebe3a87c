"""Tables for the pages, each worked out anew: what a press gives, and what each shortcut costs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy import ndarray
from scipy.optimize import brentq

from oracles.light import INDEX, RIM, even_slices, three_wavelengths
from oracles.palm import SMALL, inside
from oracles.tables import REPOSITORY, exponent
from palpate.core import Pose
from palpate.mechanics.layer_approximations import dimitriadis_factor
from palpate.mechanics.press_table import PressTable
from palpate.optics import (
    Rays,
    StressOpticLaw,
    best_path,
    march_axisymmetric,
    plane_amplitude,
    round_rim,
    single_slice,
    single_slice_error,
)
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec, prototype
from palpate.sensors.palm.field import field_of, pressed
from palpate.sensors.palm.orders import integrated

GREEN_M = 550e-9
OFF_CENTRE = REPOSITORY / "src" / "palpate" / "mechanics" / "tables" / "off_centre.json"
GRID_MM = tuple((x, y) for x in range(-21, 22, 7) for y in range(-21, 22, 7) if x**2 + y**2 <= 23.5**2)
"""The report's 37 points: a square grid of 7 mm, as far as a 10 mm ball stays on a 57 mm disc."""


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Markdown."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def presses() -> str:
    """What a press of the palm's ball gives."""
    spec, rows = palm.palm(), []
    scale = 4 / 3 * spec.youngs_modulus_pa / (1 - spec.poisson_ratio**2) * math.sqrt(spec.indenter_radius_m)
    for depth_mm in (1, 2, 3, 4, 5):
        found = palm.facts(palm.press(spec, Pose(0.0, 0.0, depth_mm * 1e-3)), spec)
        hertz = scale * (depth_mm * 1e-3) ** 1.5
        rows.append(
            (
                f"{depth_mm}",
                f"{found['force_N']:.2f}",
                f"{found['contact_radius_mm']:.2f}",
                f"{found['peak_pressure_Pa'] / 1e3:.0f}",
                f"{found['fringe_order_max']:.2f}",
                f"{hertz:.2f}",
            )
        )
    head = (
        "depth, mm",
        "force, N",
        "contact radius, mm",
        "greatest pressure, kPa",
        "greatest order, 550 nm",
        "Hertz's force, N",
    )
    return table(head, rows)


def spread() -> str:
    """Force's spread and exponent, to be held against the report's scores."""
    spec = palm.palm()
    force = [palm.press(spec, Pose(0.0, 0.0, d * 1e-3)).force_n for d in 0.1 * np.arange(1, 51)]
    return (
        "Over the report's fifty depths of 0.1 to 5 mm the palm's force reaches "
        f"{max(force):.1f} N, with a standard deviation of {np.std(force):.1f} N; "
        f"between 1 and 5 mm it grows as depth to the {exponent(2):.2f}."
    )


def _midplane(spec: PalmSpec, depth_m: float) -> tuple[ndarray, ndarray, float, tuple[ndarray, ndarray]]:
    """Offsets, heights, and the mid-plane's two stresses on them, below the dimple."""
    field = field_of(pressed(spec, depth_m), spec)
    s = np.linspace(-2, 2, 161) * spec.indenter_radius_m
    z = np.linspace(depth_m, spec.thickness_m, 82)[1:-1]
    top = np.interp(np.abs(s), field.r_m, field.surface_m)
    zeta = (z[:, None] - top) / (field.thickness_m - top)
    from scipy.interpolate import RegularGridInterpolator

    read = RegularGridInterpolator((field.zeta, field.r_m), np.moveaxis(field.stress_pa, 0, -1))
    rr, _, zz, rz = np.moveaxis(read(np.stack([zeta, np.broadcast_to(np.abs(s), zeta.shape)], -1)), -1, 0)
    return s, z, field.thickness_m, (rr - zz, 2 * rz * np.sign(s))


def baseline(spec: PalmSpec, depth_m: float) -> tuple[ndarray, ndarray, ndarray, float, ndarray, ndarray]:
    """The one-slice image over 57 mm, that over the best path, the marched one; that path; where they are."""
    s, z, _, middle = _midplane(spec, depth_m)
    field = field_of(pressed(spec, depth_m), spec)
    summed = integrated(field, np.abs(s), z)
    path = best_path(*middle, summed[0], summed[1] * np.sign(s))
    C = spec.stress_optic.coefficient_per_pa
    half = np.sqrt(spec.radius_m**2 - s**2)
    rays = Rays(
        s[None], z[:, None], -half[None], half[None], np.hypot(s, z[:, None]) + spec.indenter_radius_m
    )
    optics = np.array([np.pi * C / GREEN_M]), np.ones((1, 1)), plane_amplitude(spec.polariser_rad, 1)
    marched = march_axisymmetric(field, rays, *optics, slices=256).light[..., 0].astype(float)
    images = [single_slice(*middle, d, C, GREEN_M, spec.polariser_rad) for d in (spec.diameter_m, path)]
    return images[0], images[1], marched, path, s, z


def single_slices() -> str:
    """What the one-slice formula costs, at two stress-optic coefficients."""
    rows = []
    for C in (1e-9, 1.7e-10):
        spec = replace(palm.palm(), stress_optic=StressOpticLaw(C))
        for depth_mm in (1, 3, 5):
            whole, best, marched, path, _, _ = baseline(spec, depth_mm * 1e-3)
            one, two = single_slice_error(whole, marched), single_slice_error(best, marched)
            rows.append(
                (
                    f"{C:.1e}".replace("e-09", "e-9"),
                    f"{depth_mm}",
                    f"{one.rms:.2f}",
                    f"{path * 1e3:.1f}",
                    f"{two.rms:.2f}",
                    f"{two.largest:.2f}",
                )
            )
    head = (
        "C, 1/Pa",
        "depth, mm",
        "rms, path 57 mm",
        "best path, mm",
        "rms, best path",
        "largest, best path",
    )
    return table(head, rows)


def ways() -> str:
    """How far the fast way is from the exact one, by place, at 3 mm."""
    rows = []
    for x, y in ((0, 0), (7, 0), (14, 0), (0, 7), (0, -7), (0, -14), (14, -14), (-21, 7)):
        contact = palm.press(SMALL, Pose(x * 1e-3, y * 1e-3, 3e-3))
        fast, exact = (palm.render_clean(contact, SMALL, exact=which)[0] for which in (False, True))
        off = np.abs(inside(fast - exact, SMALL, 3e-3))
        rows.append((f"({x}, {y})", f"{np.sqrt(np.mean(off**2)):.3f}", f"{np.quantile(off, 0.999):.2f}"))
    return table(("contact at (x, y), mm", "rms", "999th of 1000 pixels"), rows)


def seen_at(x_mm: float, y_mm: float) -> tuple[float, float, float] | None:
    """Column [mm from the middle], share of light, turn [deg] of the ray through a contact's axis, if any."""
    columns = RIM * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 400_003)[1:-1])  # dense towards the rim
    rays = round_rim(columns, RIM, INDEX)
    offset, _, _ = rays.about(x_mm * 1e-3, y_mm * 1e-3)
    crossing = np.flatnonzero(np.diff(np.sign(offset)))
    if not len(crossing):
        return None
    i = crossing[0]
    return columns[i] * 1e3, float(rays.transmission[i]), math.degrees(rays.turn_rad[i])


def grid() -> str:
    """Through which column the edge-on camera looks at each axis of the report's grid."""
    rows = []
    for x in (7, 14, 21):
        for y in (14, 7, 0, -7, -14):
            if (x, y) not in GRID_MM:
                continue
            found = seen_at(x, y)
            if found is None:
                rows.append((f"±{x}", f"{y}", "none", "", ""))
                continue
            column, share, turn = found
            rows.append((f"±{x}", f"{y}", f"±{column:.1f}", f"{100 * share:.0f}", f"{2 * turn:.0f}"))
    head = (
        "x, mm",
        "y, mm",
        "seen in the column at, mm",
        "light through both walls, %",
        "lamp's angle it needs, degrees",
    )
    return table(head, rows)


def materials(force_n: float) -> str:
    """Three membranes under one load."""
    rows = []
    for name in ("solaris", "casting-resin", "sylgard-184"):
        spec = palm.preset(name)
        found = palm.facts(palm.press(spec, Pose(0.0, 0.0, depth_of(spec, force_n))), spec)
        rows.append(
            (
                f"`{name}`",
                f"{spec.youngs_modulus_pa / 1e6:g}",
                f"{spec.stress_optic.coefficient_per_pa:.2g}",
                f"{depth_of(spec, force_n) * 1e3:.3g}",
                f"{found['contact_radius_mm']:.2f}",
                f"{found['fringe_order_max']:.2f}",
            )
        )
    head = ("preset", "E, MPa", "C, 1/Pa", "depth, mm", "contact radius, mm", "greatest order, 550 nm")
    return table(head, rows)


def depth_of(spec: PalmSpec, force_n: float) -> float:
    """How deep the palm's ball is under a force [m]."""
    return float(
        brentq(lambda d: palm.press(spec, Pose(0.0, 0.0, d)).force_n - force_n, 1e-9, 6e-3, xtol=1e-12)
    )


def paths() -> str:
    """The first prototype's picture beside the folded path's."""
    spec, rows = palm.palm(), []
    for depth_mm in (1, 3, 5):
        contact = palm.press(spec, Pose(0.0, 0.0, depth_mm * 1e-3))
        for name, law in (("from below", prototype.quality_below), ("edge-on", prototype.quality_edge_on)):
            q = law(contact, spec)
            rows.append(
                (
                    f"{depth_mm}",
                    name,
                    f"{q.greatest_order:.2f}",
                    f"{q.density_per_mm:.2f}",
                    f"{q.contrast:.2f}",
                    f"{q.uniformity:.2f}",
                )
            )
    return table(
        ("depth, mm", "seen", "greatest order", "orders per mm", "contrast", "darkest over brightest lamp"),
        rows,
    )


def shortcuts() -> str:
    """What simpler ways cost, in the same units as the checks."""
    solved = PressTable.load("sphere-h2-mu0").at(1.0).force
    hertz = 4 / 3 / (1 - 0.49**2)
    rows = [
        ("Hertz's force at 5 mm", f"{100 * (hertz / solved - 1):+.0f} %"),
        (
            "Dimitriadis's force at 5 mm, far out of its range",
            f"{100 * (hertz * dimitriadis_factor(0.5, 0.49) / solved - 1):+.0f} %",
        ),
        (
            "64 even slices over 57 mm under a point load, for graded ones",
            f"light off by up to {even_slices():.2f}",
        ),
        (
            "One wavelength a channel for 31 bands, orders to 4",
            f"light off by up to {three_wavelengths():.2f}",
        ),
    ]
    return table(("shortcut", "error"), rows)


def off_centre() -> str:
    """The error of moving an axisymmetric table off the disc's centre, if it has been measured."""
    if not OFF_CENTRE.exists():
        return "Not measured yet."
    held = json.loads(OFF_CENTRE.read_text())
    rows = [
        (
            f"{row['offset'] * 5:.1f}",
            f"{row['depth'] * 5:g}",
            f"{100 * row['force_over_centred'] - 100:+.1f} %",
        )
        for row in held["presses"]
    ]
    return table(("distance from the centre, mm", "depth, mm", "force, over that in the centre"), rows)


MEASURED: dict[str, Callable[[], str]] = {
    "presses": presses,
    "spread": spread,
    "single-slice": single_slices,
    "ways": ways,
    "grid": grid,
    "materials-5N": lambda: materials(5.0),
    "materials-15N": lambda: materials(15.0),
    "paths": paths,
    "shortcuts": shortcuts,
    "off-centre": off_centre,
}
