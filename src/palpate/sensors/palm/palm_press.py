"""Press a probe into the palm's membrane: finite-strain tables where they exist, else linear layers.

Linear layers are limited to 1.5 mm, where they are accurate to about 4 % in force under a 10 mm ball. Below
that depth they also add the shear of a lateral load to a tabled press of another probe than the ball.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from palpate.core import Contact, Float, InputError, Pose, Probe, RangeError, ndarray
from palpate.core.errors import MaterialStrainError
from palpate.mechanics.axisymmetric.disc_table import SAME, DiscTable, TabulatedPress
from palpate.mechanics.axisymmetric.pulled_sphere import (
    FULL,
    MAX_SHIFT,
    pulled as pulled_contact,
    pulled_sphere_table,
)
from palpate.mechanics.axisymmetric.shape_table import (
    PunchTable,
    SphereTable,
    press_finite_strain,
)
from palpate.mechanics.layers.contact_solver import StackContact, press_stack
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.mechanics.layers.stack_friction import shear_stack
from palpate.mechanics.probe_contact import press_probe
from palpate.optics.march import AxisymmetricField
from palpate.sensors.palm.membrane_faults import pressed_at
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.press_corrections import applied_rim, lateral_of, press_narrow, rim_reach
from palpate.sensors.palm.probe_shapes import (
    as_pair,
    gap_of,
    has_probe_table,
    probe_table_of,
    probes_with_table,
    reaches_of,
    upright_ball,
)

FINER = 3  # refinement of the knots in each direction; the march interpolates linearly
FADED = (0.75, 0.95)
"""Range over which the stress fades out, in table radii: a table's rim is not where the membrane's is."""

Knots = Float[ndarray, " n"]


TABLES: dict[str, type[SphereTable] | type[PunchTable]] = {"sphere": SphereTable, "punch": PunchTable}
Proportions = tuple[str, float, float, float, float]


def own_ball(spec: PalmSpec) -> Probe:
    """Return the spec's ball."""
    return Probe("sphere", spec.indenter_radius_m)


def _proportions(spec: PalmSpec, probe: Probe) -> Proportions:
    """What a table depends on; lengths are in the probe's radius."""
    R = probe.radius_m
    return probe.shape, spec.thickness_m / R, spec.radius_m / R, spec.poisson_ratio, spec.friction


@lru_cache(maxsize=32)
def _table(
    shape: str, thickness: float, disc_radius: float, poisson_ratio: float, friction: float
) -> DiscTable:
    return TABLES[shape].of_disc(thickness, friction, poisson_ratio)


def has_table(spec: PalmSpec, probe: Probe | None = None) -> bool:
    """Return whether a table exists for the spec's membrane under its ball (default) or an upright punch."""
    probe = own_ball(spec) if probe is None else probe
    if probe != own_ball(spec) and (probe.shape != "punch" or probe.tilt_rad):
        return False
    shape, thickness, disc_radius, poisson_ratio, friction = _proportions(spec, probe)
    return TABLES[shape].holds(thickness, friction, poisson_ratio, disc_radius)


def table_of(spec: PalmSpec, probe: Probe | None = None) -> DiscTable:
    """Return the shipped table with the spec's proportions, of its ball (default) or of an upright punch."""
    probe = own_ball(spec) if probe is None else probe
    if has_table(spec, probe):
        return _table(*_proportions(spec, probe))
    R, kind = probe.radius_m, TABLES.get(probe.shape, PunchTable)
    known = "; ".join(
        f"{t.thickness * R * 1e3:g} mm thick, {2 * t.disc_radius * R * 1e3:g} mm wide or more, "
        f"nu {t.poisson_ratio:g}, friction {t.friction:g}"
        for t in map(kind.load, kind.shipped())
    )
    raise RangeError(
        f"no table for a membrane {spec.thickness_m * 1e3:g} mm thick, {spec.diameter_m * 1e3:g} mm wide, nu "
        f"{spec.poisson_ratio:g}, friction {spec.friction:g} under a {probe.shape} of {2 * R * 1e3:g} mm; "
        f"upright, with this size, there are: {known}"
    )


def pressed(spec: PalmSpec, depth_m: float, probe: Probe | None = None) -> TabulatedPress:
    """Return the table at one depth, in radii of the probe (default: the ball) and moduli (cached)."""
    probe = own_ball(spec) if probe is None else probe
    table_of(spec, probe)
    return _pressed(_proportions(spec, probe), depth_m / probe.radius_m)


@lru_cache(maxsize=16)
def _pressed(proportions: Proportions, depth: float) -> TabulatedPress:
    table = _table(*proportions)
    assert table is not None
    return table.at(depth)


def field_at(spec: PalmSpec, depth_m: float, probe: Probe | None = None) -> AxisymmetricField:
    """Return the stress at one depth of a table in SI units on finer knots, without the rim's own stress
    (cached).
    """
    probe = own_ball(spec) if probe is None else probe
    table_of(spec, probe)
    return _field_at(_proportions(spec, probe), depth_m, probe.radius_m, spec.youngs_modulus_pa)


@lru_cache(maxsize=16)
def _field_at(proportions: Proportions, depth_m: float, R: float, E: float) -> AxisymmetricField:
    press = _pressed(proportions, depth_m / R)
    r, zeta = between(press.r, FINER), between(press.zeta, FINER)
    stress = PchipInterpolator(press.zeta, np.asarray(press.stress, dtype=float), axis=1)(zeta)
    stress = PchipInterpolator(press.r, stress, axis=2)(r)
    start, end = FADED
    share = np.clip((r / press.r[-1] - start) / (end - start), 0, 1)
    return AxisymmetricField(
        r_m=r * R,
        zeta=zeta,
        surface_m=PchipInterpolator(press.r, np.asarray(press.surface, dtype=float))(r) * R,
        thickness_m=press.thickness * R,
        stress_pa=stress * (E * (1 - share**2 * (3 - 2 * share))),
    )


def depth_of_force(spec: PalmSpec, force_n: float, x_m: float = 0.0, y_m: float = 0.0) -> float:
    """Return the depth of the spec's ball under a force, including an applied rim [m]."""
    spec = pressed_at(spec, x_m, y_m)
    table, R = table_of(spec), spec.indenter_radius_m
    unit = spec.youngs_modulus_pa * R**2

    def force(depth: float) -> float:
        ratio = applied_rim(spec, Pose(x_m, y_m, depth * R)).force_ratio
        return float(table.force_at(np.array([depth]))[0]) * unit * ratio  # `at` works out all its stresses

    greatest = force(table.greatest_depth)
    if not 0 <= force_n <= greatest * (1 + SAME):
        raise RangeError(
            f"a force of {force_n:g} N lies outside 0 to {greatest:g} N, the table's deepest press of this "
            "membrane; press less",
            code="force-range",
        )
    if force_n == 0:
        return 0.0
    if force_n >= greatest:
        return table.greatest_depth * R
    return R * float(brentq(lambda d: force(d) - force_n, 0.0, table.greatest_depth, xtol=1e-13))


def between(knots: Knots, finer: int) -> Float[ndarray, " m"]:
    """Cut every interval of the knots into `finer` equal parts."""
    whole = np.arange(len(knots))
    return np.interp(np.arange(finer * (len(knots) - 1) + 1) / finer, whole, knots)


LINEAR_DEPTH_M = 1.5e-3
CELLS = 160  # minimum cells per grid side
CELL_M = 0.15e-3  # maximum cell size
BLOCK = 32  # rounding of cell counts, so that probes of similar size share cached grids
MARGIN_M = 3e-3  # grid beyond the probe's reach
WHOLE_M = 1e-3  # rounding of half the grid side, for the same reason
PULLED_REACH = 3.0  # half the grid side of a tabled press, in probe radii
FRICTION = 1.0  # friction coefficient between probe and silicone under a lateral load (assumed)


class Layered(NamedTuple):
    """A press by linear layers; a narrow contact is solved on a finer grid of its own."""

    pressed: StackContact
    contact: Contact
    is_narrow: bool = False

    @property
    def area_m2(self) -> float:
        if self.is_narrow:
            return self.pressed.area_m2
        x, y = self.contact.x_m, self.contact.y_m
        return float(self.contact.touching.sum() * (x[1] - x[0]) * (y[1] - y[0]))


def press(
    spec: PalmSpec,
    pose: Pose,
    probe: Probe | None = None,
    lateral_n: tuple[float, float] = (0.0, 0.0),
    moment_nm: float | None = None,
) -> Contact:
    """Press a probe into the membrane.

    Args:
        spec: Palm specification.
        pose: Position and depth; negative depth is a probe in the air. Depth limits: 6 mm for the spec's ball
            without a moment, the table's range for another tabled probe without a lateral load, else 1.5 mm.
        probe: Indenter; None for the spec's ball.
        lateral_n: Lateral force (x, y) [N], below friction times the normal force. Maximum ball shift: 2.25
            mm.
        moment_nm: Moment about z through the probe's axis, from x towards y [N m]; None for a probe that
            cannot rotate.

    Returns:
        Contact. Near the rim its force is too high unless the spec's rim is "applied", which corrects the
        ball up to 23.5 mm from the axis and 5 mm deep.
    """
    return within_material(spec, _pressed_by_law(spec, pose, probe, lateral_n, moment_nm))


def contact_strain(spec: PalmSpec, contact: Contact) -> float:
    """Return the mean contact pressure over Young's modulus; 0 without force."""
    area_m2 = math.pi * contact.radius_m**2
    return contact.force_n / (area_m2 * spec.youngs_modulus_pa) if contact.force_n > 0 < area_m2 else 0.0


def within_material(spec: PalmSpec, contact: Contact) -> Contact:
    """Return the contact, or raise `MaterialStrainError` beyond the material's strain limit."""
    strain = contact_strain(spec, contact)
    if strain > spec.max_strain:
        raise MaterialStrainError(
            f"the contact strains {spec.name} by {100 * strain:.3g} % (mean pressure over E), and its law "
            f"holds to {100 * spec.max_strain:.3g} %; press less, or state another max_strain"
        )
    return contact


def _pressed_by_law(
    spec: PalmSpec,
    pose: Pose,
    probe: Probe | None,
    lateral_n: tuple[float, float],
    moment_nm: float | None,
) -> Contact:
    for asked, value, unit in (("place", (pose.x_m, pose.y_m), "m"), ("lateral load", lateral_n, "N")):
        if not all(map(math.isfinite, value)):
            raise InputError(f"the {asked} {value} {unit} is not finite", code="not-finite")
    if moment_nm is not None and not math.isfinite(moment_nm):
        raise InputError(f"the moment {moment_nm} N m is not finite", code="not-finite")
    spec = pressed_at(spec, pose.x_m, pose.y_m)
    ball = own_ball(spec)
    probe = ball if probe is None else as_pair(upright_ball(probe))
    if -math.inf < pose.depth_m < 0:
        touching = _pressed_by_law(spec, replace(pose, depth_m=0.0), probe, (0.0, 0.0), None)
        return replace(touching, pose=pose)
    aside = lateral_n != (0.0, 0.0) or moment_nm not in (None, 0.0)
    if probe == ball and not aside:
        return _tabled(spec, pose)
    if probe == ball and not moment_nm and is_pulled_deep(spec):
        return _pulled_ball(spec, pose, lateral_n)
    tabled = None if aside and pose.depth_m > LINEAR_DEPTH_M * (1 + SAME) else _by_table(spec, pose, probe)
    if tabled is not None:
        return pulled(_as_layered(spec, tabled), lateral_n, moment_nm) if aside else tabled
    layered = press_layers(spec, pose, probe)
    return pulled(layered, lateral_n, moment_nm) if aside else layered.contact


def is_pulled_deep(spec: PalmSpec) -> bool:
    """Return whether a lateral load on the spec's ball is tabled at finite strain."""
    R = spec.indenter_radius_m
    return has_table(spec) and spec.friction == 0 and pulled_sphere_table().covers(spec.thickness_m / R)


def _tabled(spec: PalmSpec, pose: Pose, grid: tuple[Knots | None, Knots | None] = (None, None)) -> Contact:
    material = spec.youngs_modulus_pa, spec.thickness_m, spec.radius_m, spec.friction, spec.poisson_ratio
    return _near_rim(spec, press_finite_strain(own_ball(spec), pose, *material, *grid))


def _by_table(spec: PalmSpec, pose: Pose, probe: Probe) -> Contact | None:
    """Press an upright punch or a non-axisymmetric probe by its table; None if it has none."""
    around = _around(probe.radius_m + probe.length_m / 2)
    membrane = spec.youngs_modulus_pa, spec.thickness_m, spec.radius_m
    grid = pose.x_m + around, pose.y_m + around
    if probe.shape == "punch" and has_table(spec, probe):
        return press_finite_strain(probe, pose, *membrane, spec.friction, spec.poisson_ratio, *grid)
    if has_probe_table(spec, probe):
        return press_probe(probe_table_of(spec, probe), probe, pose, *membrane, *grid)
    return None


def _as_layered(spec: PalmSpec, contact: Contact) -> Layered:
    """A tabled contact prepared for a lateral load by linear layers."""
    held = np.where(contact.touching, contact.pressure_pa, 0.0)
    force_n, area_m2 = contact.force_n, math.pi * contact.radius_m**2
    surface = held, contact.displacement_m, contact.touching
    pressed = StackContact(
        contact.x_m, contact.y_m, *surface, force_n, area_m2, contact.pose.depth_m, stack_of(spec), 0, 0.0
    )
    return Layered(pressed, replace(contact, model=f"{contact.model}; lateral load by linear layers"))


def _around(radius_m: float) -> Knots:
    """Columns or rows that hold the whole dimple of a tabled press [m]."""
    reach = PULLED_REACH * radius_m
    return (np.arange(2 * CELLS) + 0.5) * (reach / CELLS) - reach


def _pulled_ball(spec: PalmSpec, pose: Pose, lateral_n: tuple[float, float]) -> Contact:
    """The spec's ball under a lateral load; an applied rim contributes to the load."""
    around = _around(spec.indenter_radius_m)
    contact = _tabled(spec, pose, (pose.x_m + around, pose.y_m + around))
    pull = lateral_n[0] - contact.lateral_n[0], lateral_n[1] - contact.lateral_n[1]
    modulus = spec.youngs_modulus_pa * applied_rim(spec, pose).force_ratio
    found = pulled_contact(contact, pressed(spec, pose.depth_m), modulus, pull, FRICTION)
    return replace(found, lateral_n=(float(lateral_n[0]), float(lateral_n[1])))


def pull_of_shift(spec: PalmSpec, pose: Pose, shift_m: float) -> float:
    """Return the lateral force caused by a monotonic shift of the spec's ball along the membrane [N]."""
    spec = pressed_at(spec, pose.x_m, pose.y_m)
    R, at = spec.indenter_radius_m, pressed(spec, pose.depth_m)
    table, unit = pulled_sphere_table(), spec.youngs_modulus_pa * applied_rim(spec, pose).force_ratio * R**2
    least = min(table.shift_of(at, FULL * FRICTION * at.force, FRICTION), MAX_SHIFT) * R
    if shift_m > least * (1 + SAME):
        raise RangeError(
            f"shifted by {1e3 * shift_m:.3g} mm at {1e3 * pose.depth_m:.3g} mm the probe slips over the "
            f"palm, or goes further than was solved; shift it by {1e3 * least:.3g} mm at most, or press "
            "deeper",
            code="sliding",
        )
    return table.force_of(at, shift_m / R, FRICTION) * unit


def load_with_rim(
    spec: PalmSpec, pose: Pose, probe: Probe, pull_n: tuple[float, float]
) -> tuple[float, float]:
    """Return the lateral load for `press` of a pull on a probe, including an applied rim's push [N]."""
    if probe != own_ball(spec) or not is_pulled_deep(spec):
        return pull_n
    spec = pressed_at(spec, pose.x_m, pose.y_m)
    effect = applied_rim(spec, pose)
    if effect.push_ratio == 0.0:
        return pull_n
    centred = pressed(spec, pose.depth_m).force * spec.youngs_modulus_pa * spec.indenter_radius_m**2
    x, y = lateral_of(effect, pose, centred)
    return pull_n[0] + x, pull_n[1] + y


def drawn_ball(spec: PalmSpec, pose: Pose) -> Contact:
    """Return a contact of the spec's ball with probe, position, and depth only, for drawing."""
    none, grid = np.zeros(0), np.zeros((0, 0))
    return Contact(
        none, none, grid, grid, grid > 0, math.nan, math.nan, own_ball(spec), pose, "a ball, drawn alone"
    )


def _near_rim(spec: PalmSpec, centred: Contact) -> Contact:
    """Apply the rim's effect to a tabled press."""
    effect = applied_rim(spec, centred.pose)
    if effect.force_ratio == 1.0 and effect.push_ratio == 0.0:
        return centred
    reach, R = rim_reach(spec), spec.indenter_radius_m
    held = "" if reach is None or effect.solved else (
        f", held as {reach.offset * R * 1e3:.3g} mm from the axis and {reach.depth * R * 1e3:g} mm deep"
    )  # fmt: skip
    return replace(
        centred,
        pressure_pa=centred.pressure_pa * effect.force_ratio,
        shear_pa=None if centred.shear_pa is None else centred.shear_pa * effect.force_ratio,
        force_n=centred.force_n * effect.force_ratio,
        lateral_n=lateral_of(effect, centred.pose, centred.force_n),
        model=f"{centred.model}; force and push near the rim from three dimensions{held}",
    )


def press_to_force(spec: PalmSpec, force_n: float, x_m: float = 0.0, y_m: float = 0.0) -> Contact:
    """Press the spec's ball to a normal force [N]."""
    return press(spec, Pose(x_m, y_m, depth_of_force(spec, force_n, x_m, y_m)))


def stack_of(spec: PalmSpec) -> Stack:
    """Return the membrane as one bonded layer."""
    return Stack((ElasticLayer(spec.thickness_m, spec.youngs_modulus_pa, spec.poisson_ratio),))


def press_layers(spec: PalmSpec, pose: Pose, probe: Probe) -> Layered:
    """Press any probe, including the spec's ball, by linear layers."""
    if not 0 <= pose.depth_m <= LINEAR_DEPTH_M * (1 + SAME):
        others = probes_with_table(spec)
        raise RangeError(
            f"depth {pose.depth_m * 1e3:.7g} mm of the probe ({probe.shape}) lies outside 0 to "
            f"{LINEAR_DEPTH_M * 1e3:g} mm, where linear layers hold; press less, or press the palm's own "
            f"ball or an upright punch that has a table{f', or one of {others}' if others else ''}, without "
            "lateral load",
            code="outside-linear-range",
        )
    spec = pressed_at(spec, pose.x_m, pose.y_m)
    across, down = _offsets(probe)
    x, y, stack = pose.x_m + across, pose.y_m + down, stack_of(spec)
    gap, is_narrow = gap_of(probe, x, y, (pose.x_m, pose.y_m)), False
    try:
        pressed = press_stack(stack, gap, x, y, depth_m=pose.depth_m)
    except RangeError:  # too few cells touch; what does not hold on cells of its own either is raised there
        pressed, is_narrow = press_narrow(stack, probe, pose, x, y), True
    _check_inside(spec, pressed, pose)
    return Layered(pressed, within_material(spec, pressed.as_contact(probe, pose)), is_narrow)


def pulled(layered: Layered, lateral_n: tuple[float, float], moment_nm: float | None = None) -> Contact:
    """Add a lateral load to a contact; arguments as of `press`."""
    pressed, contact = layered.pressed, layered.contact
    if not pressed.force_n > 0:
        asked = f"{math.hypot(*lateral_n):g} N" + (f" and {moment_nm:g} N m" if moment_nm else "")
        raise RangeError(f"a lateral load of {asked} on a probe that does not press", code="no-normal-force")
    axis = (contact.pose.x_m, contact.pose.y_m)
    sheared = shear_stack(pressed, FRICTION, force_n=lateral_n, moment_nm=moment_nm, axis_m=axis)
    return replace(
        contact,
        shear_pa=sheared.shear_pa,
        lateral_n=(float(lateral_n[0]), float(lateral_n[1])),
        moment_nm=sheared.moment_nm if moment_nm is None else float(moment_nm),
    )


def greatest_aside(layered: Layered) -> tuple[float, float]:
    """Return the limits that friction sets for force [N] and moment about the probe's axis [N m] alone."""
    contact = layered.contact
    x, y = contact.x_m - contact.pose.x_m, contact.y_m[:, None] - contact.pose.y_m
    cell = (x[1] - x[0]) * (contact.y_m[1] - contact.y_m[0])
    around = float((contact.pressure_pa * np.hypot(x, y)).sum() * cell)
    return FRICTION * contact.force_n, FRICTION * around


def _offsets(probe: Probe) -> tuple[np.ndarray, np.ndarray]:
    """Grid of square cells around a probe's axis [m]."""
    halves = [math.ceil((reach + MARGIN_M) / WHOLE_M - 1e-9) * WHOLE_M for reach in reaches_of(probe)]
    cell = min(CELL_M, 2 * max(halves) / CELLS)
    sides = [round(2 * half / cell) for half in halves]
    counts = [side if side <= CELLS else -(-side // BLOCK) * BLOCK for side in sides]
    across, down = ((np.arange(count) + 0.5 - count / 2) * cell for count in counts)
    return across, down


def _check_inside(spec: PalmSpec, pressed: StackContact, pose: Pose) -> None:
    y, x = np.nonzero(pressed.touching)
    furthest = (
        float(np.hypot(pressed.x_m[x], pressed.y_m[y]).max()) if len(x) else math.hypot(pose.x_m, pose.y_m)
    )
    if furthest > spec.radius_m:
        raise RangeError(
            f"the contact reaches {furthest * 1e3:.1f} mm from the membrane's axis, over its rim at "
            f"{spec.radius_m * 1e3:g} mm; press nearer to the middle"
        )
