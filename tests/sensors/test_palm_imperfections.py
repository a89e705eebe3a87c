"""What differs from place to place in a membrane and in a picture of it: each against its closed form."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import RegularGridInterpolator
from scipy.linalg import expm
from tests.refusals import refused

from palpate.core import InputError, Pose, RangeError
from palpate.optics import Rays, march_axisymmetric, plane_amplitude
from palpate.optics.image_chain import AutoExposure
from palpate.sensors import palm
from palpate.sensors.palm import fringe_view
from palpate.sensors.palm.membrane_faults import (
    Glare,
    MirrorDirt,
    ResidualMap,
    UnevenGel,
    dirt_over,
    disc_modes,
    frozen_at,
    modulus_ratio,
    mottled,
    registered,
    side_modes,
    thickness_at,
)
from palpate.sensors.palm.mirror_view import contact_px
from palpate.sensors.palm.palm_press import press, press_layers, press_to_force
from palpate.sensors.palm.palm_render import housed, render_clean
from palpate.sensors.palm.palm_sensor import force_law_of
from palpate.sensors.palm.palm_variation import IMPERFECT, drawn_palm
from palpate.sensors.palm.press_corrections import rim_by_place
from palpate.sensors.palm.probe_shapes import parse_probe

SPEC = palm.debug()
BARE = replace(SPEC, extinction=0.0, rays_per_pixel=(1, 1))
REST = Pose(0.0, 0.0, 0.0)


def edge_on(spec, pose=REST, exact=True):
    return render_clean(press(spec, pose), spec, exact=exact)[0]


def untouched(spec, exact):
    """Light of the untouched membrane before the lamp, of its rows and visible columns; rays; rows."""
    way = fringe_view.march_fringes if exact else fringe_view.shift_fringes
    light = way(spec, 0.0, 0.0, 0.0)
    z, rays = spec.fringes.down_m, fringe_view.columns(spec, spec.fringes)
    rows = np.flatnonzero((z > 0.3e-3) & (z < spec.thickness_m - 0.3e-3))
    return light[rows][:, rays.visible], rays, z[rows]


@pytest.mark.parametrize(("exact", "off"), [(True, 2e-6), (False, 2e-4)])
def test_a_membrane_with_a_residual_map_is_at_rest_a_field_of_plates(exact, off) -> None:
    """Each pixel is sin^2(2 (theta - psi)) sin^2(delta / 2) of its ray's retardance and axis."""
    spec = replace(BARE, residual=ResidualMap(2e-7, seed=3), polariser_rad=0.3)
    light, rays, z = untouched(spec, exact)
    seen = fringe_view.spectrum(31)
    along, aside = frozen_at(spec, rays.impact_m[rays.visible], z[:, None])
    path = 2 * rays.half_chord_m[rays.visible]
    axis, delta = np.arctan2(aside, along) / 2, 2 * np.pi * np.hypot(along, aside) * path
    plate = np.sin(2 * (axis - 0.3)) ** 2
    half = delta[..., None] / 2 / seen.wavelength_m
    assert_allclose(light, (plate[..., None] * np.sin(half) ** 2) @ seen.weight, atol=off)
    assert light.max() > 2e-3


def test_residual_and_stress_together_are_a_product_of_jones_matrices() -> None:
    """A pressed ray with residual retardance against matrix exponentials of its slices, band by band."""
    field = fringe_view.field_at(BARE, 3e-3)
    s, z, reach, slices = 2e-3, 4e-3, 28e-3, 400
    frozen = np.array([900.0, -500.0])
    edges = np.linspace(np.arctan(-reach / 5e-3), np.arctan(reach / 5e-3), slices + 1)
    y = 5e-3 * np.tan((edges[1:] + edges[:-1]) / 2)
    dy = 5e-3 / np.cos((edges[1:] + edges[:-1]) / 2) ** 2 * np.diff(edges)
    r = np.hypot(s, y)
    top = np.interp(r, field.r_m, field.surface_m)
    zeta = (z - top) / (field.thickness_m - top)
    inside = r <= field.r_m[-1]
    read = RegularGridInterpolator((field.zeta, field.r_m), np.moveaxis(field.stress_pa, 0, -1))
    rr, tt, zz, rz = read(np.stack([zeta, np.minimum(r, field.r_m[-1])], -1)).T * inside
    cosine = s / r
    u = ((rr - tt) * cosine**2 + tt - zz + frozen[0]) * dy
    v = (2 * rz * cosine + frozen[1]) * dy
    seen, psi = fringe_view.spectrum(31), BARE.polariser_rad
    half = BARE.stress_optic.half_phase(seen.wavelength_m)
    s3, s1 = np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]])
    into, out = np.array([np.cos(psi), np.sin(psi)]), np.array([-np.sin(psi), np.cos(psi)])
    wanted = []
    for h in half[::10]:
        plates = [expm(1j * h * (p * s3 + q * s1)) for p, q in zip(u, v, strict=True)]
        wanted.append(abs(out @ reduce(lambda before, after: after @ before, plates) @ into) ** 2)
    one = np.array([s])
    for pa in (tuple(frozen), (np.array([frozen[0]]), np.array([frozen[1]]))):
        marched = march_axisymmetric(
            field, Rays(one, one * 0 + z, one * 0 - reach, one * 0 + reach, one * 0 + 5e-3), half[::10],
            np.eye(len(half[::10])), plane_amplitude(psi, len(half[::10])), 400, pa,
        ).light[0]  # fmt: skip
        assert_allclose(marched, wanted, atol=2e-4)
    with pytest.raises(InputError, match="finite"):
        march_axisymmetric(
            field, Rays(one, one, -one, one, one), half, np.eye(31), plane_amplitude(psi, 31),
            frozen_pa=(np.array([np.nan]), 0.0),
        )  # fmt: skip


def test_modes_have_no_mean_and_a_mean_square_of_one() -> None:
    radius, turn = np.meshgrid((np.arange(1000) + 0.5) / 1000, np.arange(64) / 64 * 2 * np.pi)
    weight = radius / radius.sum()
    modes = disc_modes(radius * np.cos(turn), radius * np.sin(turn))
    assert_allclose(np.einsum("ixy,jxy,xy->ij", modes, modes, weight), np.eye(7), atol=2e-5)
    assert_allclose((modes * weight).sum((1, 2)), 0, atol=1e-5)
    at = (np.arange(400) + 0.5) / 200 - 1
    sides = side_modes(*np.meshgrid(at, at))
    assert_allclose(np.einsum("ixy,jxy->ij", sides, sides) / 160_000, np.eye(11), atol=2e-3)


def test_a_harder_place_carries_more_and_turns_light_more_and_keeps_its_shape() -> None:
    uneven = replace(SPEC, gel=UnevenGel(0.05, seed=2))
    ratios = []
    for x_m in (-12e-3, 12e-3):
        pose = Pose(x_m, 2e-3, 3e-3)
        ratio = modulus_ratio(uneven, x_m, 2e-3)
        found, even = press(uneven, pose), press(SPEC, pose)
        assert_allclose(found.force_n, ratio * even.force_n)
        assert_array_equal(found.displacement_m, even.displacement_m)
        there = replace(SPEC, youngs_modulus_pa=ratio * SPEC.youngs_modulus_pa)
        assert_allclose(edge_on(uneven, pose), edge_on(there, pose), atol=1e-5)
        assert_allclose(press_to_force(uneven, found.force_n, x_m, 2e-3).pose.depth_m, 3e-3, rtol=1e-9)
        punch, shallow = parse_probe("punch:6"), replace(pose, depth_m=0.5e-3)
        both = [press_layers(spec, shallow, punch).contact.force_n for spec in (uneven, SPEC)]
        assert_allclose(both[0], ratio * both[1])
        ratios.append(ratio)
    assert np.ptp(ratios) > 0.03
    around = replace(uneven, gel=UnevenGel(0.05, seed=3))
    assert modulus_ratio(around, 5e-3, 0.0) != modulus_ratio(uneven, 5e-3, 0.0)


def test_a_thinner_place_is_stiffer_by_the_table_of_its_own_thickness() -> None:
    uneven = replace(SPEC, gel=UnevenGel(thickness=0.02, seed=2))
    pose = Pose(14e-3, 0.0, 3e-3)
    thick_m = thickness_at(uneven, pose.x_m, pose.y_m)
    assert 0.005 < abs(thick_m / SPEC.thickness_m - 1) < 0.06
    there = replace(SPEC, thickness_m=thick_m)
    found, even = press(uneven, pose), press(SPEC, pose)
    assert_allclose(found.force_n, press(there, pose).force_n)
    assert (found.force_n > even.force_n) == (thick_m < SPEC.thickness_m)
    for exact in (True, False):
        for one, other in zip(
            *(render_clean(press(s, pose), s, exact=exact) for s in (uneven, there)), strict=True
        ):
            assert_allclose(one, other, atol=1e-5)


def test_a_rig_s_force_law_is_harder_where_the_gel_is_and_refuses_an_uneven_thickness() -> None:
    uneven = replace(SPEC, gel=UnevenGel(0.05, seed=2))
    x, y, depth = np.array([-9e-3, 4e-3]), np.array([2e-3, 8e-3]), np.array([1e-3, 3e-3])
    spec = replace(uneven, rim="applied")
    found = rim_by_place(spec)(x, y, depth)
    law = force_law_of(spec, parse_probe("sphere:10"))
    for i in range(2):
        wanted = press(spec, Pose(x[i], y[i], depth[i]))
        own = np.interp(depth[i], law.depth_m, law.force_n)
        assert_allclose(found.ratio[i] * own, wanted.force_n, rtol=1e-3)
        assert_allclose(found.lateral_ratio[i] * wanted.force_n, wanted.lateral_n, atol=1e-9)
    assert rim_by_place(SPEC) is None
    with pytest.raises(RangeError, match="even thickness"):
        rim_by_place(replace(SPEC, gel=UnevenGel(thickness=0.01)))


def test_dirt_dims_the_mirror_s_view_alone_and_stays_where_it_is() -> None:
    dirty = replace(SPEC, dirt=MirrorDirt(20, texture=0.05, seed=1))
    for pose in (REST, Pose(3e-3, 0.0, 3e-3)):
        clean, seen = (render_clean(press(s, pose), s) for s in (SPEC, dirty))
        assert_array_equal(seen[0], clean[0])
        assert_allclose(seen[1], clean[1] * dirt_over(dirty)[..., None], rtol=1e-6)
    assert dirt_over(replace(dirty, dirt=MirrorDirt(1, speck_m=2e-3))).min() > 0.3
    at = np.meshgrid(np.linspace(0, 9e-3, 50), np.linspace(0, 7e-3, 40))
    square = np.mean([mottled(MirrorDirt(seed=k), *at, 0.03) ** 2 for k in range(200)], axis=0)
    assert_allclose(square, 1, atol=0.5)
    assert_allclose(square.mean(), 1, atol=0.03)


def test_glare_adds_the_same_light_whatever_is_pressed_and_goes_with_the_lamp() -> None:
    shiny = replace(SPEC, glare=Glare(2, peak=0.1, seed=5))
    added = []
    for lamp, pose in ((1.0, REST), (1.0, Pose(3e-3, 0.0, 3e-3)), (0.5, REST)):
        clean, seen = (
            render_clean(press(s, pose), s) for s in (replace(one, lamp_gain=lamp) for one in (SPEC, shiny))
        )
        added.append([(b - a) / lamp for a, b in zip(clean, seen, strict=True)])
    for first, other in zip(added[0], added[1], strict=True):
        assert_allclose(other, first, atol=1e-6)
    for first, other in zip(added[0], added[2], strict=True):
        assert_allclose(other, first, atol=1e-6)
        assert 0.03 < first.max() <= 0.2
        assert first.min() >= 0


def test_a_region_is_turned_by_its_angle_about_its_middle_and_then_moved() -> None:
    view = replace(palm.small().mirror, turn_rad=0.1, shift_px=(1.5, -0.5))
    spec = replace(palm.small(), mirror=view)
    dot = np.zeros((*view.size_px[::-1], 3), np.float32)
    x_m, y_m = 10e-3, -4e-3
    upright = contact_px(palm.small(), x_m, y_m)
    dot[int(upright[1]) - 1 : int(upright[1]) + 2, int(upright[0]) - 1 : int(upright[0]) + 2] = 1
    mass = registered(dot, view)[..., 0]
    rows, columns = np.indices(mass.shape) + 0.5
    found = np.array([(mass * columns).sum(), (mass * rows).sum()]) / mass.sum()
    centre = np.array([int(upright[0]) + 0.5, int(upright[1]) + 0.5])
    away, moved = centre - view.middle_px, found - view.middle_px
    c, s = np.cos(0.1), np.sin(0.1)
    wanted = np.array([[c, -s], [s, c]]) @ away + [1.5, -0.5]
    assert_allclose(moved, wanted, atol=0.05)
    assert_allclose(contact_px(spec, x_m, y_m), np.array(view.middle_px) + np.array([[c, -s], [s, c]])
                    @ (np.array(upright) - view.middle_px) + [1.5, -0.5])  # fmt: skip
    with pytest.raises(RangeError, match="rad"):
        replace(spec, mirror=replace(view, turn_rad=0.5))


def test_a_camera_s_own_exposure_moves_in_whole_steps_towards_its_target() -> None:
    auto = AutoExposure(0.1, steps_per_stop=3, max_stops=1.0)
    for mean, stops in ((0.1, 0), (0.1 * 2 ** (-0.4), 1 / 3), (0.9, -1), (0.0, 1)):
        assert_allclose(np.log2(auto.gain(np.full((2, 2, 3), mean))), stops, atol=1e-12)
    spec = replace(SPEC, auto_exposure=AutoExposure(0.02))
    for pose in (REST, Pose(0.0, 0.0, 4e-3)):
        plain, own = (housed(render_clean(press(s, pose), s), s) for s in (SPEC, spec))
        steps = 3 * np.log2(own.mean() / plain.mean())
        assert_allclose(steps, round(steps), atol=1e-4)
        assert abs(np.log2(own.mean() / 0.02)) <= 1 / 6 + 1e-6
    views = palm.render_views(press(spec, REST), spec, np.random.default_rng(0))
    whole = palm.render(press(spec, REST), spec, np.random.default_rng(0)).image
    assert_array_equal(views[0], whole[spec.fringes.window])


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: UnevenGel(modulus=0.5), "modulus-variation"),
        (lambda: UnevenGel(seed=-1), "seed"),
        (lambda: ResidualMap(1e-3), "residual-birefringence"),
        (lambda: MirrorDirt(texture=2.0), "dirt-range"),
        (lambda: Glare(spots=100), "spot-count"),
        (lambda: Glare(peak=-1.0), "glare-range"),
        (lambda: AutoExposure(0.0), "exposure-range"),
    ],
)
def test_faults_that_cannot_be_are_refused(make, code) -> None:
    with refused(code):
        make()


def test_an_imperfect_copy_has_every_fault_and_a_plain_one_none(rng) -> None:
    copies = [drawn_palm(SPEC, rng, IMPERFECT) for _ in range(40)]
    for differs in (
        lambda c: c.thickness_m, lambda c: c.gel.modulus, lambda c: c.gel.thickness,
        lambda c: c.frozen_axis_rad, lambda c: c.residual.birefringence, lambda c: c.residual.seed,
        lambda c: c.dirt.texture,
        lambda c: c.glare.peak, lambda c: c.mirror.turn_rad, lambda c: c.fringes.turn_rad,
    ):  # fmt: skip
        assert len({differs(one) for one in copies}) == 40
    assert {one.dirt.specks for one in copies} > {3, 6}
    assert 10 < sum(one.auto_exposure.max_stops > 1 / 6 for one in copies) < 30
    plain = drawn_palm(SPEC, rng)
    assert (plain.gel, plain.residual, plain.dirt, plain.glare) == (
        UnevenGel(),
        ResidualMap(),
        MirrorDirt(),
        Glare(),
    )
    assert plain.thickness_m == SPEC.thickness_m == thickness_at(SPEC, 1e-3, 0.0)
