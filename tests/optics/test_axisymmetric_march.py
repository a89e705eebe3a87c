import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.core import InputError, RangeError
from palpate.mechanics import secondary_stress
from palpate.optics import (
    AxisymmetricField,
    Rays,
    StressOpticLaw,
    assumed_camera,
    circular_amplitude,
    dark_field,
    frozen_stress,
    graded_slices,
    march_axisymmetric,
    march_colour,
    plane_amplitude,
)
from palpate.optics.march import march_even

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from oracles.plain_march import march_axisymmetric_plain, march_colour_plain

RADIUS, THICKNESS, CONTACT = 28.5e-3, 10e-3, 3e-3
LAW = StressOpticLaw(1e-9)
GREEN = np.array([550e-9])
ONE = np.ones((1, 1))
# bilinear reading and single precision on both sides; one 8-bit step is 4e-3
ROUNDING = 2e-5


def graded(end, core, count):
    """Knots from 0 to `end`, evenly spaced within `core` of 0 and ever wider beyond."""
    return core * np.sinh(np.linspace(0, np.arcsinh(end / core), count))


def dimple_field():
    """A made-up smooth stress under a dimple with a bulge around it; it need not be in equilibrium."""
    r, zeta = graded(RADIUS, 2e-3, 90), np.linspace(0, 1, 40) ** 1.5
    surface = 2e-3 * np.exp(-((r / CONTACT) ** 2)) - 3e-4 * np.exp(-(((r - 2 * CONTACT) / CONTACT) ** 2))
    z = zeta[:, None] * (THICKNESS - surface)
    decay = 2e5 * CONTACT**2 / (r**2 + z**2 + CONTACT**2 / 4) ** 2
    stress = np.stack([-decay * r**2, -0.2 * decay * r**2, -decay * z**2, -decay * r * z])
    return AxisymmetricField(r, zeta, surface, THICKNESS, stress)


def view(columns=60, rows=50, off_centre=0.0, highest=-1e-3):
    x, z = np.linspace(-20e-3, 20e-3, columns), np.linspace(highest, 11e-3, rows)[:, None]
    half = np.sqrt(RADIUS**2 - x**2)
    return Rays(x, z, -half + off_centre, half + off_centre, np.hypot(np.hypot(x, z), CONTACT))


def incompressible_field(stress_at, end, knots):
    """A table of a half-space's stress, of which only what birefringence sees is known: (x = r, y = 0) gives

    s_rr - s_zz and 2 s_rz, (x = 0, y = r) gives s_tt - s_zz; s_zz itself may be taken as zero.
    """
    r, zeta = graded(end, 0.02 * end, knots[0]), graded(1.0, 0.02, knots[1])
    z = np.broadcast_to((zeta * end)[:, None], (knots[1], knots[0]))
    rr, twice_rz = stress_at(r[None, :], 0 * r[None, :], z)
    tt, _ = stress_at(0 * r[None, :], r[None, :], z)
    return AxisymmetricField(r, zeta, 0 * r, end, np.stack([rr, tt, 0 * rr, twice_rz / 2]))


def assert_equal_light(one, other, tolerance=ROUNDING):
    np.testing.assert_allclose(one.light, other.light, atol=tolerance)
    np.testing.assert_allclose(one.skin_m, other.skin_m, atol=1e-7)
    np.testing.assert_allclose(one.outside_m, other.outside_m, atol=1e-7)


@pytest.mark.parametrize(("off_centre", "frozen"), [(0.0, (0.0, 0.0)), (-5e-3, (2e3, -1e3))])
def test_the_compiled_march_is_the_plain_one(off_centre, frozen):
    spectrum = assumed_camera()
    optics = LAW.half_phase(spectrum.wavelength_m), spectrum.weight
    for amplitude in (plane_amplitude(np.pi / 4, 31), circular_amplitude(spectrum.wavelength_m)):
        args = dimple_field(), view(30, 25, off_centre), *optics, amplitude
        fast = march_axisymmetric(*args, frozen_pa=frozen)
        assert fast.light.shape == (25, 30, 3)
        assert fast.light.max() > 0.2
        assert_equal_light(fast, march_axisymmetric_plain(*args, frozen_pa=frozen))


def test_a_point_load_shows_the_closed_form():
    """I = sin^2(2 phi) sin^2(2 C F cos(phi) / (lambda r)), phi from the load's line, polariser upright.

    The axes do not turn along the ray, so only quadrature is at stake: the stack of 64 graded slices errs by
    3e-7. Through a table the bilinear reading comes on top, 4e-6 at 1600 x 1600 knots and four times as
    much at half as many; the stress is singular at the load, and the rays stay 1.5 mm away from it.
    """
    force, end = 1.0, 0.1

    def boussinesq(x, y, z):
        rho = np.maximum(np.sqrt(x**2 + y**2 + z**2), 1e-4)
        radial = -3 * force * z / (2 * np.pi * rho**5)
        return radial * (x**2 - z**2), radial * 2 * x * z

    x, z = np.meshgrid(np.linspace(-4e-3, 4e-3, 21), np.linspace(1.5e-3, 5e-3, 15))
    y, dy = graded_slices(np.hypot(x, z), 32)
    halves = [part * dy for part in boussinesq(x, y, z)]
    r, phi = np.hypot(x, z), np.arctan2(abs(x), z)
    exact = np.sin(2 * phi) ** 2 * np.sin(2 * 1e-9 * force * np.cos(phi) / (GREEN[0] * r)) ** 2
    assert exact.max() > 0.5
    optics = LAW.half_phase(GREEN), ONE, plane_amplitude(np.pi / 2, 1)
    for law in (march_colour, march_colour_plain):
        np.testing.assert_allclose(law(*halves, *optics, even=True)[..., 0], exact, atol=1e-6)

    long = np.full_like(x, 0.99 * end)
    field = incompressible_field(boussinesq, end, knots=(1600, 1600))
    marched = march_axisymmetric(field, Rays(x, z, -long, long, r), *optics)
    np.testing.assert_allclose(marched.light[..., 0], exact, atol=1e-5)


def hertz(x, y, z):
    return secondary_stress(x, y, z, CONTACT, 1e5)


def wide(x, z):
    end = np.full_like(x, 45 * CONTACT)
    return Rays(x, z, -end, end, np.sqrt(x**2 + z**2 + CONTACT**2))


def test_a_ball_shows_what_the_closed_field_shows():
    """Hertz's closed field at 1.5 fringes, marched slice by slice, against the same through a table of it.

    Measured at worst: 7e-4 at 800 x 800 knots, 2e-4 at 1600 x 1600.
    """
    x, z = np.meshgrid(np.linspace(-3, 3, 41) * CONTACT, np.linspace(0.05, 3, 30) * CONTACT)
    y, dy = graded_slices(np.sqrt(x**2 + z**2 + CONTACT**2), 128)
    difference, shear = hertz(x, y, z)
    law = replace(LAW, coefficient_per_pa=3e-9)
    exact = dark_field(march_even(difference * dy, shear * dy, float(law.half_phase(GREEN)[0])), np.pi / 4)
    optics = law.half_phase(GREEN), ONE, plane_amplitude(np.pi / 4, 1)
    field = incompressible_field(hertz, 50 * CONTACT, knots=(800, 800))
    marched = march_axisymmetric(field, wide(x, z), *optics, slices=256)
    assert exact.max() > 0.9
    np.testing.assert_allclose(marched.light[..., 0], exact, atol=1e-3)


@pytest.mark.parametrize(("highest", "slices"), [(0.0, 64), (-1e-3, 128)])
def test_twice_the_slices_or_bands_change_no_8_bit_step(highest, slices):
    """The 999th of 1000 pixels, at up to 5 fringes, from 31 bands on.

    64 slices do from the surface at rest downwards; rows above it, which cut short pieces off the bulge,
    want 128.
    """
    field, rays = dimple_field(), view(120, 90, highest=highest)
    law = replace(LAW, coefficient_per_pa=3.3e-9)

    def light(slices, bands):
        spectrum = assumed_camera(bands)
        optics = law.half_phase(spectrum.wavelength_m), spectrum.weight, plane_amplitude(np.pi / 4, bands)
        marched = march_axisymmetric(field, rays, *optics, slices=slices).light
        marched[rays.offset_m**2 + (rays.depth_m + 3e-3) ** 2 < 5e-3**2] = 0  # a ball lies in the dimple
        return marched

    base = light(slices, 31)
    assert np.quantile(abs(light(2 * slices, 31) - base), 0.999) < 1 / 255
    assert np.quantile(abs(light(slices, 62) - base), 0.999) < 1 / 255


def test_air_and_what_lies_under_the_skin_leave_the_light_alone():
    x = np.zeros(3)
    rays = Rays(x + 25e-3, np.array([-2e-3, 5e-3, 11e-3]), x - 9e-3, x + 9e-3, x + 5e-3)
    optics = LAW.half_phase(GREEN), ONE
    dark = march_axisymmetric(dimple_field(), rays, *optics, plane_amplitude(0.3, 1))
    bright = march_axisymmetric(dimple_field(), rays, *optics, plane_amplitude(0.3, 1, light_field=True))
    np.testing.assert_allclose(dark.skin_m, [0, 18e-3, 0], rtol=1e-5)
    np.testing.assert_allclose(dark.light[[0, 2]], 0.0, atol=1e-12)
    np.testing.assert_allclose(bright.light[[0, 2]], 1.0, atol=1e-6)


def test_the_length_in_the_skin_is_the_ray_s_less_the_dimple_s():
    """A cone-shaped dimple, whose straight side the cut-off slices meet exactly."""
    r = np.linspace(0, 20e-3, 201)
    surface = np.maximum(2e-3 - r / 5, 0)
    field = AxisymmetricField(r, np.array([0.0, 1.0]), surface, THICKNESS, np.zeros((4, 2, 201)))
    depth = np.array([0.5e-3, 1.0e-3, 1.5e-3])
    zero = 0 * depth
    rays = Rays(zero, depth, zero - 15e-3, zero + 15e-3, zero + 3e-3)
    marched = march_axisymmetric(field, rays, LAW.half_phase(GREEN), ONE, plane_amplitude(0.3, 1))
    gap = 2 * 5 * (2e-3 - depth)
    np.testing.assert_allclose(marched.skin_m, 30e-3 - gap, rtol=1e-5)


@pytest.mark.parametrize("axis", [0.4])
def test_frozen_birefringence_is_a_plate_of_its_order_and_axis(axis):
    field = dimple_field()
    quiet = replace(field, stress_pa=0 * field.stress_pa)
    rays = Rays(np.zeros(1), np.array([5e-3]), np.array([-20e-3]), np.array([28e-3]), np.array([4e-3]))
    frozen = frozen_stress(0.3 * GREEN[0] / 48e-3, axis, LAW)
    optics = LAW.half_phase(GREEN), ONE, plane_amplitude(0.1, 1)
    marched = march_axisymmetric(quiet, rays, *optics, frozen_pa=frozen)
    plate = np.sin(2 * (axis - 0.1)) ** 2 * np.sin(np.pi * 0.3) ** 2
    assert marched.light[0, 0] == pytest.approx(plate, abs=ROUNDING)


def test_tables_that_cannot_be_are_refused():
    field = dimple_field()
    broken = field.stress_pa.copy()
    broken[2, 3, 4] = np.nan
    for change in (
        {"stress_pa": broken},
        {"r_m": field.r_m[::-1].copy()},
        {"r_m": field.r_m + 1e-3},
        {"zeta": field.zeta * 0.9},
    ):
        with pytest.raises(InputError):
            replace(field, **change)
    with pytest.raises(RangeError, match="no skin"):
        replace(field, thickness_m=1e-3)


@pytest.mark.parametrize(("part", "value"), [("offset_m", np.nan), ("end_m", -30e-3), ("scale_m", 0.0)])
def test_rays_that_cannot_be_are_refused(part, value):
    one = {name: np.zeros(1) for name in ("offset_m", "depth_m")}
    one |= {"start_m": np.full(1, -1e-2), "end_m": np.full(1, 1e-2), "scale_m": np.full(1, 1e-3)}
    with pytest.raises((InputError, RangeError)):
        Rays(**(one | {part: np.full(1, value)}))


def test_marches_that_cannot_be_are_refused():
    optics = LAW.half_phase(GREEN), ONE, plane_amplitude(0.3, 1)
    with pytest.raises(InputError, match="slices"):
        march_axisymmetric(dimple_field(), view(), *optics, slices=0)
    with pytest.raises(InputError, match="frozen"):
        march_axisymmetric(dimple_field(), view(), *optics, frozen_pa=(np.nan, 0.0))
