"""Light: closed forms of plates, matrix products, a point load, a ball, a disc, rays through the rim."""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
from numpy import ndarray
from scipy.linalg import expm

from oracles import Oracle
from oracles.plain_march import march_axisymmetric_plain, march_colour_plain
from palpate.mechanics.half_space.hertz import secondary_stress
from palpate.optics import (
    AxisymmetricField,
    Rays,
    assumed_camera,
    circular_amplitude,
    circular_dark_field,
    dark_field,
    graded_slices,
    linear_retarder,
    march,
    march_axisymmetric,
    march_colour,
    plane_amplitude,
    round_rim,
    single_retarder,
    spectral_to_linear,
    through,
)
from palpate.optics.image_chain import electrons
from palpate.optics.march import march_even

GREEN = np.array([550e-9])
RIM, INDEX = 28.5e-3, 1.41


def off(found: ndarray, wanted: ndarray) -> float:
    """Greatest difference of two lights, each 0 to 1."""
    return float(np.max(np.abs(np.asarray(found, float) - wanted)))


def one_plate() -> float:
    """A marched plate between crossed polarisers against sin^2(2 (theta - psi)) sin^2(pi N)."""
    order, axis = np.meshgrid(np.linspace(0, 3, 31), np.linspace(0, np.pi, 19))
    per_stress = np.pi / 20
    slices = [np.broadcast_to(order * part(2 * axis), (20, *order.shape)) for part in (np.cos, np.sin)]
    marched = march(slices[0].copy(), slices[1].copy(), per_stress)
    return max(
        off(dark_field(marched, psi), single_retarder(order, axis, psi)) for psi in (0.0, 0.3, np.pi / 4)
    )


def turning_plates() -> float:
    """Random slices against products of 2 x 2 matrices by matrix exponentials."""
    u, v = 0.7 * np.random.default_rng(0).normal(size=(2, 12, 40))
    s3, s1 = np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]])
    marched = march(u, v, 1.0)
    errors = []
    for psi in (0.0, 0.3):
        into, out = np.array([np.cos(psi), np.sin(psi)]), np.array([-np.sin(psi), np.cos(psi)])
        light = []
        for a, b in zip(u.T, v.T, strict=True):
            plates = [expm(1j * (p * s3 + q * s1)) for p, q in zip(a, b, strict=True)]
            light.append(abs(out @ reduce(lambda before, after: after @ before, plates) @ into) ** 2)
        errors.append(off(dark_field(marched, psi), np.array(light)))
    return max(errors)


def circular() -> float:
    """A plate between crossed circular polarisers: sin^2(pi N) whatever its axis."""
    order = np.linspace(0, 3, 40)
    exact = np.sin(np.pi * order) ** 2
    errors = []
    for axis in np.linspace(0, np.pi, 7):
        plate = linear_retarder(order, np.full(order.shape, axis))
        errors += [
            off(circular_dark_field(plate), exact),
            off(through(plate, circular_amplitude(GREEN)[0]), exact),
        ]
    return max(errors)


def disc() -> float:
    """Centre of a disc pressed across its diameter, marched, against N = 8 C P / (pi D lambda).

    The stress is that of two line loads, -2P/(pi t r) along the way to each, and an even tension P/(pi R t).
    """
    P, R, t, C = 20.0, 20e-3, 10e-3, 1e-9
    tension, towards_a_load = P / (math.pi * R * t), -2 * P / (math.pi * t * R)
    xx, zz = tension, tension + 2 * towards_a_load
    slices = np.full((50, 1), (xx - zz) * t / 50)
    marched = dark_field(march(slices, 0 * slices, math.pi * C / GREEN[0]), math.pi / 4)
    wanted = 8 * C * P / (math.pi * 2 * R * GREEN[0])
    return off(marched, np.sin(math.pi * np.array([wanted])) ** 2)


def _point_load(x: ndarray, y: ndarray, z: ndarray, force: float) -> tuple[ndarray, ndarray]:
    radial = -3 * force * z / (2 * np.pi * (x**2 + y**2 + z**2) ** 2.5)
    return radial * (x**2 - z**2), radial * 2 * x * z


def _point_light(x: ndarray, z: ndarray, force: float, C: float, psi: float) -> ndarray:
    r, phi = np.hypot(x, z), np.arctan2(x, z)
    turn = np.sin(2 * phi) if psi == 0 else np.cos(2 * phi)
    return np.asarray(turn**2 * np.sin(2 * C * force * np.cos(phi) / (GREEN[0] * r)) ** 2)


def point_load(compiled: bool) -> float:
    """Light through Boussinesq's field at nu = 1/2, 64 slices on the half ray, against its closed form."""
    force, C = 15.0, 1.7e-10
    x, z = np.meshgrid(np.linspace(-0.012, 0.012, 61), np.linspace(0.001, 0.012, 56))
    y, dy = graded_slices(np.hypot(x, z), 64)
    u, v = (part * dy for part in _point_load(x, y, z, force))
    errors = []
    for psi in (0.0, np.pi / 4):
        if compiled:
            optics = np.pi * C / GREEN, np.ones((1, 1)), plane_amplitude(psi, 1)
            light = march_colour(u, v, *optics, even=True)[..., 0]
        else:
            light = dark_field(march_even(u, v, np.pi * C / GREEN[0]), psi)
        errors.append(off(light, _point_light(x, z, force, C, psi)))
    return max(errors)


def even_slices() -> float:
    """The same with 64 even slices over 57 mm: what grading saves."""
    force, C = 15.0, 1.7e-10
    x, z = np.meshgrid(np.linspace(-0.012, 0.012, 61), np.linspace(0.001, 0.012, 56))
    dy = 28.5e-3 / 32
    y = ((np.arange(32) + 0.5) * dy)[:, None, None] * np.ones(x.shape)
    u, v = (part * dy for part in _point_load(x, y, z, force))
    return off(dark_field(march_even(u, v, np.pi * C / GREEN[0]), 0.0), _point_light(x, z, force, C, 0.0))


def ball_through_a_table() -> float:
    """Hertz's field at 1.5 orders, slice by slice in closed form, against the compiled march of a table."""
    a, p0, C = 3e-3, 1e5, 3e-9
    x, z = np.meshgrid(np.linspace(-3, 3, 41) * a, np.linspace(0.05, 3, 30) * a)
    y, dy = graded_slices(np.sqrt(x**2 + z**2 + a**2), 128)
    u, v = (part * dy for part in secondary_stress(x, y, z, a, p0))
    exact = dark_field(march_even(u, v, np.pi * C / GREEN[0]), np.pi / 4)
    end = 50 * a
    knots = 0.02 * np.sinh(np.linspace(0, np.arcsinh(1 / 0.02), 800))
    r, depth = knots * end, np.broadcast_to(knots[:, None] * end, (800, 800))
    none = np.zeros((1, 800))
    rr, twice = secondary_stress(r[None], none, depth, a, p0)
    tt, _ = secondary_stress(none, r[None], depth, a, p0)
    field = AxisymmetricField(r, knots, 0 * r, end, np.stack([rr, tt, 0 * rr, twice / 2]))
    far = np.full_like(x, 45 * a)
    rays = Rays(x, z, -far, far, np.sqrt(x**2 + z**2 + a**2))
    optics = np.pi * C / GREEN, np.ones((1, 1)), plane_amplitude(np.pi / 4, 1)
    return off(march_axisymmetric(field, rays, *optics, slices=256).light[..., 0], exact)


def compiled_slices() -> float:
    """Compiled and plain march of the same random slices, 31 bands, to colour."""
    u, v = np.random.default_rng(2).normal(size=(2, 40, 500)) * 3e2
    light = assumed_camera()
    optics = np.pi * 1e-9 / light.wavelength_m, light.weight, circular_amplitude(light.wavelength_m)
    return off(march_colour(u, v, *optics), march_colour_plain(u, v, *optics))


def compiled_table() -> float:
    """Compiled and plain march through a made-up dimple with a bulge, to colour."""
    r, zeta = 28.5e-3 * np.linspace(0, 1, 90) ** 1.5, np.linspace(0, 1, 40) ** 1.5
    surface = 2e-3 * np.exp(-((r / 3e-3) ** 2)) - 3e-4 * np.exp(-(((r - 6e-3) / 3e-3) ** 2))
    z = zeta[:, None] * (10e-3 - surface)
    decay = 1.8 / (r**2 + z**2 + 2.2e-6) ** 2
    stress = np.stack([-decay * r**2, -0.2 * decay * r**2, -decay * z**2, -decay * r * z])
    field = AxisymmetricField(r, zeta, surface, 10e-3, stress)
    x, down = np.linspace(-20e-3, 20e-3, 61), np.linspace(-1e-3, 11e-3, 40)[:, None]
    half = np.sqrt(28.5e-3**2 - x**2)
    rays = Rays(x, down, 4e-3 - half, 4e-3 + half, np.hypot(np.hypot(x, down), 3e-3))
    light = assumed_camera()
    optics = np.pi * 1e-9 / light.wavelength_m, light.weight, plane_amplitude(np.pi / 4, 31)
    fast, plain = (law(field, rays, *optics).light for law in (march_axisymmetric, march_axisymmetric_plain))
    return off(fast, plain)


def bands() -> float:
    """31 bands against 310, at orders to 4 (a plate's colours)."""
    order, colour = np.linspace(0, 4, 401), []
    for count in (31, 310):
        light = assumed_camera(count)
        plates = np.sin(np.pi * order * 550e-9 / light.wavelength_m[:, None]) ** 2
        colour.append(spectral_to_linear(plates, light))
    return off(colour[0], colour[1])


def three_wavelengths() -> float:
    """One wavelength a channel, as is usual, against 310 bands, at orders to 4."""
    order, light = np.linspace(0, 4, 401), assumed_camera(310)
    plates = np.sin(np.pi * order * 550e-9 / light.wavelength_m[:, None]) ** 2
    means = light.wavelength_m @ light.weight
    return off(np.sin(np.pi * order[:, None] * 550e-9 / means) ** 2, spectral_to_linear(plates, light))


def rim() -> float:
    """Each column's ray by Snell's law in vectors, wall by wall; over the disc's radius."""
    x = np.linspace(-28.4e-3, 28.4e-3, 57)
    rays = round_rim(x, RIM, INDEX)
    errors = []
    for i, at in enumerate(x):
        front = np.array([at, math.sqrt(RIM**2 - at**2)])
        inside = _refracted(np.array([0.0, -1.0]), front / RIM, 1 / INDEX)
        back = front - 2 * (front @ inside) * inside
        light = np.array([math.sin(rays.turn_rad[i]), math.cos(rays.turn_rad[i])])
        right = np.array([light[1], -light[0]])
        middle = rays.impact_m[i] * right
        ends = [middle + sign * rays.half_chord_m[i] * light for sign in (1, -1)]
        errors += [
            float(np.abs(end - wall).max()) / RIM for end, wall in zip(ends, (front, back), strict=True)
        ]
    return max(errors)


def _refracted(direction: ndarray, normal: ndarray, ratio: float) -> ndarray:
    cos_in = -direction @ normal
    return np.asarray(
        ratio * direction + (ratio * cos_in - math.sqrt(1 - ratio**2 * (1 - cos_in**2))) * normal
    )


def shot_noise() -> float:
    """Variance of a million noisy pixels against mean plus read noise squared."""
    drawn = electrons(np.full(1_000_000, 3000.0, np.float32), 5.0, np.random.default_rng(0))
    return abs(float(np.var(drawn, dtype=float)) / (3000 + 25) - 1)


def mitsuba() -> float:
    """Ten plates whose axes turn, between crossed polarisers, against a path tracer of Stokes vectors."""
    import mitsuba as mi

    mi.set_variant("scalar_spectral_polarized")
    errors = []
    for seed in range(3):
        u, v = 0.6 * np.random.default_rng(seed).normal(size=(2, 10, 1))
        marched = through(march(u, v, 1.0), plane_amplitude(0.3, 1)[0])[0]
        plates = [
            ({"type": "retarder", "delta": 2 * math.degrees(math.hypot(a, b))}, math.atan2(b, a) / 2)
            for a, b in zip(u[:, 0], v[:, 0], strict=True)
        ]
        first, last = ({"type": "polarizer"}, 0.3), ({"type": "polarizer"}, 0.3 + math.pi / 2)
        errors.append(abs(_traced([first, *plates, last]) / _traced([first]) - marched))
    return float(max(errors))


def _traced(sheets: list[tuple[dict[str, object], float]]) -> float:
    """What a camera sees of a lamp through sheets, each turned about the ray, lamp side first."""
    import mitsuba as mi

    place = mi.ScalarTransform4f

    def sheet(at: float, bsdf: dict[str, object], turn: float) -> dict[str, object]:
        to = place().translate([0, 0, at]) @ place().rotate([0, 0, 1], math.degrees(turn))
        return {"type": "rectangle", "to_world": to, "bsdf": bsdf}

    heights = np.linspace(0, 1, len(sheets) + 2)
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": len(sheets) + 8, "rr_depth": 1000},
        "lamp": sheet(0, {"type": "diffuse"}, 0.0) | {"emitter": {"type": "area", "radiance": 1.0}},
        "sensor": {
            "type": "radiancemeter",
            "to_world": place().look_at(origin=[0.1, 0.2, 2], target=[0.1, 0.2, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 1},
        },
    } | {f"sheet{i}": sheet(float(heights[i + 1]), *one) for i, one in enumerate(sheets)}
    return float(np.array(mi.render(mi.load_dict(scene), seed=3))[0, 0, 1])


ORACLES = (
    Oracle("A plate between crossed polarisers", "sin²2(θ−ψ) sin²πN", 1e-12, one_plate),
    Oracle("A plate between circular polarisers", "sin²πN, any axis", 1e-12, circular),
    Oracle("Plates whose axes turn", "products of 2 × 2 matrices (scipy)", 1e-12, turning_plates),
    Oracle(
        "Plates whose axes turn",
        "Mitsuba 3, a path tracer that carries Stokes vectors",
        1e-5,
        mitsuba,
        "mitsuba",
    ),
    Oracle("Disc pressed across its diameter: centre", "N = 8CP/(πDλ)", 1e-10, disc),
    Oracle("Point load, ν = ½, 64 slices", "the closed form (below)", 1e-5, lambda: point_load(False)),
    Oracle("Point load, compiled march", "the closed form (below)", 1e-5, lambda: point_load(True)),
    Oracle(
        "Ball at 1.5 orders, through a table", "its closed stress, slice by slice", 2e-3, ball_through_a_table
    ),
    Oracle("Compiled march of slices", "the plain march", 1e-5, compiled_slices),
    Oracle("Compiled march of a table", "the plain march", 2e-5, compiled_table),
    Oracle("31 bands, orders to 4", "310 bands", 1e-3, bands),
    Oracle("Rays through the rim, over R", "Snell's law in vectors", 1e-12, rim),
    Oracle("Noise of a bright pixel: variance", "Poisson's law and the read-out's", 1e-2, shot_noise),
)
