"""What each shortcut and each assumption costs, worked out anew."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import replace

import numpy as np
from numpy import ndarray
from scipy.interpolate import RegularGridInterpolator

from oracles import table
from oracles.light import even_slices, three_wavelengths
from oracles.palm import GRID_MM, SMALL, inside
from oracles.single_slice import best_path, single_slice, single_slice_error
from oracles.tables import STUDY
from palpate.core import Pose
from palpate.mechanics.axisymmetric.shape_table import SphereTable, edge_correction
from palpate.mechanics.half_space import hertz
from palpate.mechanics.half_space.hertz import secondary_stress
from palpate.optics import (
    Rays,
    StressOpticLaw,
    assumed_camera,
    graded_slices,
    march_axisymmetric,
    march_colour,
    plane_amplitude,
)
from palpate.optics.polariscope import with_leak
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec, View, fringe_view
from palpate.sensors.palm.fringe_orders import integrated
from palpate.sensors.palm.palm_press import depth_of_force, field_at

GREEN_M = 550e-9
FARTHEST = 4.427  # R from the axis that a press was solved at, a hair inside the grid's outermost places


def _midplane(spec: PalmSpec, depth_m: float) -> tuple[ndarray, ndarray, float, tuple[ndarray, ndarray]]:
    """Offsets, heights, and the mid-plane's two stresses on them, below the dimple."""
    field = field_at(spec, depth_m)
    s = np.linspace(-2, 2, 161) * spec.indenter_radius_m
    z = np.linspace(depth_m, spec.thickness_m, 82)[1:-1]
    top = np.interp(np.abs(s), field.r_m, field.surface_m)
    zeta = (z[:, None] - top) / (field.thickness_m - top)
    read = RegularGridInterpolator((field.zeta, field.r_m), np.moveaxis(field.stress_pa, 0, -1))
    rr, _, zz, rz = np.moveaxis(read(np.stack([zeta, np.broadcast_to(np.abs(s), zeta.shape)], -1)), -1, 0)
    return s, z, field.thickness_m, (rr - zz, 2 * rz * np.sign(s))


def baseline(spec: PalmSpec, depth_m: float) -> tuple[ndarray, ndarray, ndarray, float, ndarray, ndarray]:
    """The one-slice image over 57 mm, that over the best path, the marched one; that path; where they are."""
    s, z, _, middle = _midplane(spec, depth_m)
    field = field_at(spec, depth_m)
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
            (one, _), (two, largest) = (single_slice_error(image, marched) for image in (whole, best))
            of = f"{C:.1e}".replace("e-09", "e-9")
            rows.append(f"{of} | {depth_mm} | {one:.2f} | {path * 1e3:.1f} | {two:.2f} | {largest:.2f}")
    head = "C, 1/Pa | depth, mm | rms, path 57 mm | best path, mm | rms, best path | largest, best path"
    return table(head, rows)


def ways() -> str:
    """How far the fast way is from the exact one, by place, at 3 mm."""
    rows = []
    for x, y in ((0, 0), (7, 0), (14, 0), (0, 7), (0, -7), (0, -14), (14, -14), (-21, 7)):
        contact = palm.press(SMALL, Pose(x * 1e-3, y * 1e-3, 3e-3))
        fast, exact = (palm.render_clean(contact, SMALL, exact=which)[0] for which in (False, True))
        off = np.abs(inside(fast - exact, SMALL, 3e-3))
        rows.append(f"({x}, {y}) | {np.sqrt(np.mean(off**2)):.3f} | {np.quantile(off, 0.999):.2f}")
    return table("contact at (x, y), mm | rms | 999th of 1000 pixels", rows)


def shortcuts() -> str:
    """What simpler ways cost, in the same units as the checks."""
    solved = SphereTable.load("sphere-h2-mu0").at(1.0).force
    hertz = 4 / 3 / (1 - 0.49**2)
    even, three, below = (f"{error():.2f}" for error in (even_slices, three_wavelengths, below_the_table))
    rows = {
        "Hertz's force at 5 mm": f"{100 * (hertz / solved - 1):+.0f} %",
        "64 even slices over 57 mm under a point load, for graded ones": f"light off by up to {even}",
        "One wavelength a channel for 31 bands, orders to 4": f"light off by up to {three}",
        "Casting resin at 15 N, drawn out from the table's first depth, for Hertz's own field": (
            f"light near the contact off by {below} rms"
        ),
    }
    return table("shortcut | error", map(" | ".join, rows.items()))


def below_the_table() -> float:
    """Light within 3 contact radii under 15 N on a hard membrane, less deep than the table starts; rms."""
    spec = replace(palm.casting_resin(), rim_refracts=False)
    R, depth = spec.indenter_radius_m, depth_of_force(spec, 15.0)
    law = depth, R, spec.youngs_modulus_pa, spec.poisson_ratio
    a, p0 = hertz.contact_radius(depth, R), hertz.peak_pressure(*law)
    spec = replace(spec, fringes=View((0, 0, 100, 50), 0.06 * a, (50.0, 0.0)))
    x, z = np.meshgrid(spec.fringes.x_m, spec.fringes.down_m)
    seen = assumed_camera(spec.bands)
    y, dy = graded_slices(np.sqrt(x**2 + z**2 + a**2), 64)
    u, v = (part * dy for part in secondary_stress(x, y, z, a, p0))
    optics = seen.weight, plane_amplitude(spec.polariser_rad, spec.bands)
    light = march_colour(u, v, spec.stress_optic.half_phase(seen.wavelength_m), *optics, even=True)
    off = fringe_view.march_fringes(spec, depth, 0.0, 0.0) - with_leak(light, spec.extinction)
    return float(np.sqrt(np.mean(off[spec.fringes.down_m > 2 * depth] ** 2)))


def assumptions() -> str:
    """What the force owes to numbers that are assumed, from the mesh study and the other tables."""
    asides = json.loads(STUDY.read_text(encoding="utf-8"))["asides"]
    held = {(row["what"], row["depth"]): row["force"] for row in asides}
    depths = (0.2, 0.6, 1.0)
    rows = []
    for what, name in (
        ("Friction 0.5 for none", "friction 0.5"),
        ("Poisson's ratio 0.495 for 0.49", "Poisson's ratio 0.495"),
        ("Poisson's ratio 0.499 for 0.49", "Poisson's ratio 0.499"),
        ("A membrane twice as wide", "disc twice as wide"),
    ):
        changes = [held[name, d] / held["as the tables, coarse", d] for d in depths]
        rows.append(" | ".join([what, *(f"{100 * (ratio - 1):+.1f} %" for ratio in changes)]))
    thick, thin = (SphereTable.load(f"sphere-h{h}-mu0") for h in (4, 2))
    changes = [thick.at(d).force / thin.at(d).force for d in depths]
    rows.append(" | ".join(["A membrane twice as thick", *(f"{100 * (r - 1):+.1f} %" for r in changes)]))
    return table("other than assumed | force at 1 mm | 3 mm | 5 mm", rows)


def off_centre() -> str:
    """What moving a centred press to each place of the report's grid costs."""
    spec, rows = palm.palm(), []
    R, h = spec.indenter_radius_m, spec.thickness_m
    away = Counter(round(math.hypot(x, y), 2) for x, y in GRID_MM)
    pushed = palm.press(spec, Pose(0.0, 0.0, 5e-3)).force_n
    for mm, places in sorted(away.items())[1:]:
        offset = min(mm * 1e-3 / R, FARTHEST)
        found = [edge_correction(offset, depth_mm * 1e-3 / R, h / R) for depth_mm in (1, 3, 5)]
        errors = " | ".join(f"{100 * (1 / effect.force_ratio - 1):+.1f} %" for effect in found)
        rows.append(f"{mm:.1f} | {places} | {errors} | {found[-1].side_ratio * pushed:.2f}")
    head = "from the axis, mm | places | force too high by, 1 mm deep | 3 mm | 5 mm"
    return table(f"{head} | push outwards left out at 5 mm, N", rows)
