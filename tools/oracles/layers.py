"""Linear layers: the closed kernel, a second way to solve a stack, two solvers of one contact."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from mpmath import mp
from numpy import ndarray
from scipy.linalg import expm

from oracles import Oracle, each_relative
from oracles.contact import summed_below
from palpate.mechanics.half_space import hertz
from palpate.mechanics.layers import contact_solver
from palpate.mechanics.layers.bonded_layer import sphere_force
from palpate.mechanics.layers.contact_solver import StackContact, press_stack
from palpate.mechanics.layers.stack import ElasticLayer, Stack, surface_compliance
from palpate.mechanics.layers.stack_friction import field_below, shear_stack

R, E, NU = 5e-3, 0.3e6, 0.49
PALM = Stack((ElasticLayer(10e-3, E, NU),))
THREE = Stack((ElasticLayer(1e-3, 3 * E, 0.45), ElasticLayer(4e-3, E, NU), ElasticLayer(3e-3, 0.2 * E, 0.3)))
ENDLESS = Stack((ElasticLayer(math.inf, E, NU),), "half-space")
DEPTH = 0.5e-3
CONTACT = math.sqrt(R * DEPTH)


def kernel() -> float:
    """One bonded layer's compliance against Burmister's closed form in 40 digits."""
    h = 10e-3
    s = np.geomspace(1e-3, 60, 40)
    with mp.workdps(40):
        closed = [_burmister(mp.mpf(v), mp.mpf("0.49")) for v in s]
    wanted = 2 * (1 - NU**2) / E * h / s * np.array([float(v) for v in closed])
    return each_relative(surface_compliance(PALM, s / h).normal, wanted)


def _burmister(s: mp.mpf, nu: mp.mpf) -> mp.mpf:
    below = (3 - 4 * nu) * mp.cosh(2 * s) + 2 * s**2 + 5 - 12 * nu + 8 * nu**2
    return ((3 - 4 * nu) * mp.sinh(2 * s) - 2 * s) / below


def three_layers() -> float:
    """Three unlike layers against the equations of elasticity integrated by matrix exponentials."""
    k = np.geomspace(20.0, 3000.0, 15)
    wanted = [_plane_strain(THREE, wave, 0.0)[1] for wave in k]
    return each_relative(surface_compliance(THREE, k).normal, np.array(wanted))


def _plane_strain(stack: Stack, k: float, z: float) -> ndarray:
    """U, W, T, S at depth z under a unit wave of pressure, plane strain, bonded to a floor."""

    def down(to: float) -> ndarray:
        through, top = np.eye(4), 0.0
        for layer in stack.layers:
            part = min(max(to - top, 0.0), layer.thickness_m)
            through, top = expm(_rates(layer, k) * part) @ through, top + layer.thickness_m
        return through

    floor = down(stack.thickness_m)
    at_top = np.array([0.0, 0.0, 0.0, -1.0])
    at_top[:2] = np.linalg.solve(floor[:2, :2], -floor[:2, 2:] @ at_top[2:])
    return np.asarray(down(z) @ at_top)


def _rates(layer: ElasticLayer, k: float) -> ndarray:
    mu, nu = layer.material
    lame = 2 * mu * nu / (1 - 2 * nu)
    stiff = lame + 2 * mu
    return np.array(
        [
            [0, k, 1 / mu, 0],
            [-lame * k / stiff, 0, 0, 1 / stiff],
            [k**2 * (stiff - lame**2 / stiff), 0, 0, k * lame / stiff],
            [0, 0, -k, 0],
        ]
    )


@lru_cache(maxsize=1)
def _paraboloid() -> StackContact:
    x = np.linspace(-1.2 * CONTACT, 1.2 * CONTACT, 128)
    return press_stack(ENDLESS, contact_solver.paraboloid(x, x, R), x, x, depth_m=DEPTH)


def pressed_half_space() -> float:
    """Force of a paraboloid on a half-space against Hertz."""
    return abs(_paraboloid().force_n / hertz.force_from_depth(DEPTH, R, E, NU) - 1)


def pressed_area() -> float:
    """Its contact area."""
    return abs(_paraboloid().area_m2 / (math.pi * CONTACT**2) - 1)


def pressed_layer() -> float:
    """A sphere on the palm's layer: cells and Fourier transforms against one integral equation."""
    x = np.linspace(-4.5e-3, 4.5e-3, 128)
    errors = []
    for d in (0.5e-3, 1e-3, 1.5e-3):
        found = press_stack(PALM, contact_solver.sphere(x, x, R), x, x, depth_m=d)
        errors.append(abs(found.force_n / sphere_force(d, R, 10e-3, E, NU) - 1))
    return max(errors)


def field_of_a_load() -> float:
    """Stress on planes under Hertz's pressure, by waves, against superposed point forces; over p0."""
    x = np.linspace(-4 * CONTACT, 4 * CONTACT, 256)
    depths = np.array([0.3, 0.66, 1.5]) * CONTACT
    r = np.hypot(x, x[:, None])
    found = field_below(ENDLESS, hertz.pressure(r, CONTACT, 1.0), x, x, depths)
    near = np.flatnonzero(np.abs(x) < 1.5 * CONTACT)[::12]
    rows, columns = (index.ravel() for index in np.meshgrid(near, near, indexing="ij"))
    errors = []
    for i, z in enumerate(depths):
        places = np.stack([x[columns], x[rows], np.full(rows.shape, z)], axis=1) / CONTACT
        closed = summed_below(places, NU)
        for name, (a, b) in {"xx": (0, 0), "zz": (2, 2), "xz": (0, 2), "xy": (0, 1)}.items():
            errors.append(float(np.abs(found.stress(name)[i][rows, columns] - closed[..., a, b]).max()))
    return max(errors)


def ray_sums() -> float:
    """Stress summed along rays through three bonded layers against plane strain, wave by wave."""
    width, z = 1.5e-3, 2e-3
    x = np.linspace(-20e-3, 20e-3, 241)
    load = np.exp(-(x**2 + x[:, None] ** 2) / width**2)
    step = x[1] - x[0]
    found = field_below(THREE, load, x, x, [z])
    k = (np.arange(400) + 0.5) * 8 / width / 400
    waves = np.array([_plane_strain(THREE, wave, z) for wave in k])
    sent = math.pi * width**2 * np.exp(-((k * width) ** 2) / 4) * (k[1] - k[0]) / math.pi
    at = slice(100, 141, 4)
    c, s = np.cos(k * x[at, None]), np.sin(k * x[at, None])
    wanted = {"zz": (c * waves[:, 3]) @ sent, "xz": (s * waves[:, 2]) @ sent}
    scale = np.abs(wanted["zz"]).max()
    return max(
        float(np.abs(found.stress(name)[0].sum(axis=0)[at] * step - part).max()) / scale
        for name, part in wanted.items()
    )


def sheared() -> float:
    """Shift of a sheared ball, nu = 0, against Mindlin."""
    x = np.linspace(-1.2 * CONTACT, 1.2 * CONTACT, 64)
    stack = Stack((ElasticLayer(math.inf, E, 0.0),), "half-space")
    contact = press_stack(stack, contact_solver.paraboloid(x, x, R), x, x, depth_m=DEPTH)
    errors = []
    for part in (0.2, 0.6, 0.9):
        pull = part * 0.6 * contact.force_n
        shift = shear_stack(contact, 0.6, force_n=(pull, 0.0)).shift_m[0]
        stiffness = hertz.tangential_stiffness(CONTACT, E, 0.0)
        mindlin = 1.5 * 0.6 * contact.force_n / stiffness * (1 - (1 - part) ** (2 / 3))
        errors.append(abs(shift / mindlin - 1))
    return max(errors)


ORACLES = (
    Oracle("One bonded layer: compliance", "Burmister's closed form, 40 digits (mpmath)", 1e-10, kernel),
    Oracle("Three layers: compliance", "matrix exponentials of the equations (scipy)", 1e-6, three_layers),
    Oracle("Pressed half-space: force", "Hertz", 1e-3, pressed_half_space),
    Oracle("Pressed half-space: area", "Hertz", 1e-2, pressed_area),
    Oracle("Ball on the palm's layer to 1.5 mm: force", "an integral equation (Hayes)", 3e-3, pressed_layer),
    Oracle("Stress on planes under a ball, over p0", "superposed Boussinesq forces", 3e-3, field_of_a_load),
    Oracle("Three layers: stress summed along rays", "plane strain, wave by wave", 3e-3, ray_sums),
    Oracle("Ball pulled sideways: shift", "Cattaneo and Mindlin", 3e-3, sheared),
)
