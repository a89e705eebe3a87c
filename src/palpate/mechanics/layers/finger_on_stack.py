"""Frictionless elastic ball on a stack of bonded layers, exact for small strain.

Compliances of ball and stack add. With the ball as Hertz's paraboloid, 1/E = 1/E_top + 1/E_ball (Young's
moduli over 1 - nu^2), and the stack's compliance C(k),

    C(k) + 2 / (E_ball k) = 2 M(k) / (E k),        M -> 1 at short waves,
    g(t) - (2/pi) int_0^a g(s) int_0^inf [1 - M(k)] cos(k s) cos(k t) dk ds = d - t^2 / R,     g(a) = 0,

as in `bonded_layer`, and F = 2 E int_0^a g dt. The ball takes (E / E_ball) g(0) of the displacement d at the
axis. Layers are laterally unbounded, hence too stiff for a narrow specimen.

Reference: W. C. Hayes et al., J. Biomech. 5 (1972) 541, doi:10.1016/0021-9290(72)90010-3, for one layer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from palpate.core import Float, RangeError, ndarray
from palpate.mechanics.half_space.hertz import MAX_SLOPE
from palpate.mechanics.half_space.hertz_pairs import Body
from palpate.mechanics.layers.influence import PHASE, panels
from palpate.mechanics.layers.stack import Stack, surface_compliance

MAX_STRAIN = 0.2  # maximum depth over the stack's thickness
NODES = 48  # nodes over the contact
TOP_END = 25.0  # k h beyond which 1 - M vanishes
STACK_START = 1e-4  # k times the stack's thickness of the first panel

Points = Float[ndarray, " n"]
Waves = Float[ndarray, " k"]


class BallPress(NamedTuple):
    """Contact radius [m], displacement of ball against floor [m], force [N], and the stack's part [m]."""

    radius_m: float
    approach_m: float
    force_n: float
    sunk_m: float


@dataclass(frozen=True, slots=True)
class PressCourse:
    """Presses by rising contact radius, the first row at rest: contact radius, approach, force, and depth of
    the stack at the axis.
    """

    radius_m: Points
    approach_m: Points
    force_n: Points
    sunk_m: Points

    @property
    def area_m2(self) -> Points:
        return np.pi * self.radius_m**2


def press_to_radius(stack: Stack, ball: Body, radius_m: float) -> BallPress:
    """Press an elastic ball on a stack to a contact radius, at most half the ball's [m].

    Example:
        >>> from palpate.mechanics.layers.stack import ElasticLayer
        >>> silicone = Stack((ElasticLayer(7e-3, 0.2e6, 0.499), ElasticLayer(7e-3, 0.1e6, 0.499)))
        >>> press = press_to_radius(silicone, Body(66.7e3, 15e-3), 5e-3)
        >>> round(press.force_n, 2), round(press.approach_m * 1e3, 2)
        (0.59, 1.61)
    """
    widest = MAX_SLOPE * ball.radius_m
    if not 0.0 <= radius_m <= widest * (1 + 1e-12):
        raise RangeError(
            f"a contact of {radius_m * 1e3:g} mm lies outside 0 to {widest * 1e3:g} mm, half of the ball's "
            "radius, where Hertz's ball holds; press less, or take a larger ball",
            code="outside-law",
        )
    if radius_m == 0.0:
        return BallPress(0.0, 0.0, 0.0, 0.0)
    top = stack.layers[0].reduced_modulus_pa
    E, a = 1 / (1 / top + 1 / ball.modulus_pa), radius_m
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    t = a * np.concatenate([[0.0], (1 + nodes) / 2, [1.0]])  # axis and rim have no weight
    weights = a * np.concatenate([[0.0], weights / 2, [0.0]])
    k, dk = _waves(stack, a)
    rest = (2 / (top * k) - surface_compliance(stack, k).normal) * E * k / 2  # 1 - M
    waves = np.cos(np.outer(t, k))
    inverse = np.linalg.inv(np.eye(len(t)) - 2 / np.pi * (waves * rest * dk) @ waves.T * weights)
    flat, curved = inverse.sum(axis=1), inverse @ (t**2 / ball.radius_m)
    depth = float(curved[-1] / flat[-1])
    g = depth * flat - curved
    return BallPress(a, depth, float(2 * E * (weights @ g)), depth - float(E / ball.modulus_pa * g[0]))


def press_course(stack: Stack, ball: Body, count: int = 40, until_n: float | None = None) -> PressCourse:
    """Press an elastic ball on a stack in even steps of contact radius.

    Args:
        stack: Layers.
        ball: Ball, possibly rigid.
        count: Presses after rest, 2 or more.
        until_n: Force of the last press [N]; by default the limit of small strain: a contact of half the
            ball's radius, or a fifth of the stack's thickness.
    """
    widest = MAX_SLOPE * ball.radius_m
    deepest = MAX_STRAIN * stack.thickness_m
    if press_to_radius(stack, ball, widest).sunk_m > deepest:
        widest = brentq(
            lambda a: press_to_radius(stack, ball, a).sunk_m - deepest,
            1e-3 * widest,
            widest,
            xtol=1e-300,
            rtol=1e-12,
        )
    if until_n is not None:
        most = press_to_radius(stack, ball, widest).force_n
        if not 0 < until_n <= most * (1 + 1e-9):
            raise RangeError(
                f"a press to {until_n:g} N; above 0 and at most {most:.4g} N are allowed, where the contact "
                "has half of the ball's radius or the stack is pressed in by a fifth of its thickness",
                code="outside-law",
            )
        if until_n < most:
            widest = brentq(
                lambda a: press_to_radius(stack, ball, a).force_n - until_n,
                0.0,
                widest,
                xtol=1e-300,
                rtol=1e-13,
            )
    presses = [press_to_radius(stack, ball, a) for a in np.linspace(0.0, widest, count + 1)]
    return PressCourse(*(np.array(column) for column in zip(*presses, strict=True)))


def _waves(stack: Stack, radius_m: float) -> tuple[Waves, Waves]:
    """Gauss points and weights in k on panels that grow from the longest waves, then follow cos(k a)."""
    h = stack.layers[0].thickness_m
    if math.isinf(h):  # a half-space, where 1 - M is 0
        h = radius_m
    total = sum(slab.thickness_m for slab in stack.slabs) or h
    return panels(STACK_START / total, TOP_END / h, 60, PHASE / radius_m)
