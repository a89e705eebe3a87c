"""Tables for the pages, each worked out anew: what a press of the palm gives, and what is seen of it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from oracles import first_prototype, shortcuts, table
from oracles.light import INDEX, RIM
from oracles.palm import GRID_MM
from oracles.tables import exponent
from palpate.core import Pose
from palpate.optics import round_rim
from palpate.sensors import palm


def presses() -> str:
    """What a press of the palm's ball gives."""
    spec, rows = palm.palm(), []
    scale = 4 / 3 * spec.youngs_modulus_pa / (1 - spec.poisson_ratio**2) * math.sqrt(spec.indenter_radius_m)
    for depth_mm in (1, 2, 3, 4, 5):
        found = palm.contact_summary(palm.press(spec, Pose(0.0, 0.0, depth_mm * 1e-3)), spec)
        hertz = scale * (depth_mm * 1e-3) ** 1.5
        rows.append(
            f"{depth_mm} | {found['force_N']:.2f} | {found['contact_radius_mm']:.2f} | "
            f"{found['peak_pressure_Pa'] / 1e3:.0f} | {found['fringe_order_max']:.2f} | {hertz:.2f}"
        )
    head = "depth, mm | force, N | contact radius, mm | greatest pressure, kPa | greatest order, 550 nm"
    return table(f"{head} | Hertz's force, N", rows)


def spread() -> str:
    """Force's spread and exponent, to be held against the report's scores."""
    spec = palm.palm()
    force = [palm.press(spec, Pose(0.0, 0.0, d * 1e-3)).force_n for d in 0.1 * np.arange(1, 51)]
    return (
        "Over the report's fifty depths of 0.1 to 5 mm the palm's force reaches "
        f"{max(force):.1f} N, with a standard deviation of {np.std(force):.1f} N; "
        f"between 1 and 5 mm it grows as depth to the {exponent(2):.2f}."
    )


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
        for y in (21, 14, 7, 0, -7, -14, -21):
            if (x, y) not in GRID_MM:
                continue
            found = seen_at(x, y)
            if found is None:
                rows.append(f"±{x} | {y} | none |  | ")
                continue
            column, share, turn = found
            rows.append(f"±{x} | {y} | ±{column:.1f} | {100 * share:.0f} | {2 * turn:.0f}")
    head = "x, mm | y, mm | seen in the column at, mm | light through both walls, %"
    return table(f"{head} | lamp's angle it needs, degrees", rows)


def materials(force_n: float) -> str:
    """Three membranes under one load."""
    rows = []
    for name in ("solaris", "casting-resin", "sylgard-184"):
        spec = palm.preset(name)
        contact = palm.press_to_force(spec, force_n)
        found = palm.contact_summary(contact, spec)
        C = f"{spec.stress_optic.coefficient_per_pa:.1e}".replace("e-0", "e-")
        rows.append(
            f"`{name}` | {spec.youngs_modulus_pa / 1e6:g} | {C} | {contact.pose.depth_m * 1e3:.3g} | "
            f"{found['contact_radius_mm']:.2f} | {found['fringe_order_max']:.2f}"
        )
    head = "preset | E, MPa | C, 1/Pa | depth, mm | contact radius, mm | greatest order, 550 nm"
    return table(head, rows)


def paths() -> str:
    """The first prototype's picture beside the folded path's."""
    spec, rows = palm.palm(), []
    for depth_mm in (1, 3, 5):
        contact = palm.press(spec, Pose(0.0, 0.0, depth_mm * 1e-3))
        laws = {"from below": first_prototype.quality_below, "edge-on": first_prototype.quality_edge_on}
        for name, law in laws.items():
            numbers = " | ".join(f"{value:.2f}" for value in law(contact, spec))
            rows.append(f"{depth_mm} | {name} | {numbers}")
    head = "depth, mm | seen | greatest order | orders per mm | contrast | darkest over brightest lamp"
    return table(head, rows)


MEASURED: dict[str, Callable[[], str]] = {
    "presses": presses,
    "spread": spread,
    "single-slice": shortcuts.single_slices,
    "ways": shortcuts.ways,
    "grid": grid,
    "materials-5N": lambda: materials(5.0),
    "materials-15N": lambda: materials(15.0),
    "paths": paths,
    "shortcuts": shortcuts.shortcuts,
    "off-centre": shortcuts.off_centre,
    "assumptions": shortcuts.assumptions,
}
