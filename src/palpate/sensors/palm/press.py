"""A probe on the palm's membrane: the finite-strain table for the ball, linear layers for all else.

The table reaches 6 mm. Linear layers are right to some 4 % in force up to 1.5 mm under a 10 mm ball, and to
that depth they are allowed; a ball under lateral load is of them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from palpate.core.contact import Contact, Pose, Probe
from palpate.core.errors import InputError, RangeError
from palpate.mechanics.press_table import press_finite_strain
from palpate.mechanics.stack import Layer, Stack
from palpate.mechanics.stack_contact import StackContact, press_stack
from palpate.mechanics.stack_friction import shear_stack
from palpate.sensors.palm.field import depth_of_force
from palpate.sensors.palm.shapes import gap_of, reach_of
from palpate.sensors.palm.spec import PalmSpec

LINEAR_DEPTH_M = 1.5e-3
CELLS = 160  # of the grid's side
MARGIN_M = 3e-3  # of grid beyond the probe's reach
FRICTION = 1.0  # between probe and clean silicone, where a lateral load is asked for. Assumed.


def press(
    spec: PalmSpec, pose: Pose, probe: Probe | None = None, lateral_n: tuple[float, float] = (0.0, 0.0)
) -> Contact:
    """Press a probe into the membrane.

    Args:
        spec: the palm.
        pose: where, and how deep: up to 6 mm for the spec's ball, to 1.5 mm for all else; negative for a
            probe in the air. The contact must lie inside the membrane's rim.
        probe: what presses; None for the spec's ball.
        lateral_n: force along x and y on top [N]; less than friction times the normal force.

    Returns:
        The contact. Both laws hold for a membrane wide around the contact; towards the rim the force is too
        high, by how much is on the verification page.

    Raises:
        InputError: a place or a load that is not a number.
        RangeError: the depth lies beyond the law, the contact reaches over the rim, or the probe would slip.
    """
    for asked, value, unit in (("place", (pose.x_m, pose.y_m), "m"), ("lateral load", lateral_n, "N")):
        if not all(map(math.isfinite, value)):
            raise InputError(f"the {asked} {value} {unit} is not finite; give two numbers in {unit}, x and y")
    ball = Probe("sphere", spec.indenter_radius_m)
    probe = probe or ball
    if -math.inf < pose.depth_m < 0:
        return replace(press(spec, replace(pose, depth_m=0.0), probe), pose=pose)
    if probe == ball and lateral_n == (0.0, 0.0):
        return press_finite_strain(
            probe,
            pose,
            spec.youngs_modulus_pa,
            spec.thickness_m,
            spec.radius_m,
            spec.friction,
            spec.poisson_ratio,
        )
    return _linear(spec, pose, probe, lateral_n)


def press_to_force(spec: PalmSpec, force_n: float, x_m: float = 0.0, y_m: float = 0.0) -> Contact:
    """Press the spec's ball until it carries a force.

    Args:
        spec: the palm.
        force_n: 0 to that of the table's deepest press [N].
        x_m, y_m: where [m].

    Raises:
        RangeError: the force lies beyond the table, or the contact reaches over the rim.
    """
    return press(spec, Pose(x_m, y_m, depth_of_force(spec, force_n)))


def stack_of(spec: PalmSpec) -> Stack:
    """The membrane as one bonded layer."""
    return Stack((Layer(spec.thickness_m, spec.youngs_modulus_pa, spec.poisson_ratio),))


def _linear(spec: PalmSpec, pose: Pose, probe: Probe, lateral_n: tuple[float, float]) -> Contact:
    if not 0 <= pose.depth_m <= LINEAR_DEPTH_M:
        raise RangeError(
            f"depth {pose.depth_m * 1e3:g} mm of a {probe.shape} lies outside 0 to "
            f"{LINEAR_DEPTH_M * 1e3:g} mm, where linear layers hold; press less, or press the palm's own "
            "ball without lateral load"
        )
    half = reach_of(probe) + MARGIN_M
    offsets = (np.arange(CELLS) + 0.5 - CELLS / 2) * 2 * half / CELLS
    x, y = pose.x_m + offsets, pose.y_m + offsets
    found = press_stack(stack_of(spec), gap_of(probe, x, y, (pose.x_m, pose.y_m)), x, y, depth_m=pose.depth_m)
    _check_inside(spec, found, pose)
    contact = found.as_contact(probe, pose)
    if lateral_n == (0.0, 0.0):
        return contact
    if not found.force_n > 0:
        raise RangeError(f"a lateral load of {math.hypot(*lateral_n):g} N on a probe that does not press")
    sheared = shear_stack(found, FRICTION, force_n=lateral_n)
    return replace(contact, shear_pa=sheared.shear_pa, lateral_n=(float(lateral_n[0]), float(lateral_n[1])))


def _check_inside(spec: PalmSpec, found: StackContact, pose: Pose) -> None:
    y, x = np.nonzero(found.touching)
    furthest = float(np.hypot(found.x_m[x], found.y_m[y]).max()) if len(x) else math.hypot(pose.x_m, pose.y_m)
    if furthest > spec.radius_m:
        raise RangeError(
            f"the contact reaches {furthest * 1e3:.1f} mm from the membrane's axis, over its rim at "
            f"{spec.radius_m * 1e3:g} mm; press nearer to the middle"
        )
