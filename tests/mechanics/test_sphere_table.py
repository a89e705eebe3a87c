import math
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, RegularGridInterpolator
from tests.refusals import refused

from palpate.core import InputError, Pose, Probe, RangeError
from palpate.mechanics.axisymmetric.shape_table import (
    SphereTable,
    press_finite_strain,
)
from palpate.mechanics.layers import bonded_layer as layer

HERE = Path(__file__).parent
REPOSITORY = HERE.parent.parent
E, R, DISC = 0.3e6, 5e-3, 28.5e-3
BALL = Probe("sphere", R)


def over_a_circle(values, r):
    return 2 * math.pi * float(CubicSpline(r, values * r).integrate(r[0], r[-1]))


def top_traction(press):
    """Normal and tangential part of s.n on the deformed top."""
    slope = np.gradient(press.surface, press.r)
    n = np.stack([slope, -np.ones_like(slope)]) / np.hypot(1, slope)
    rr, _, zz, rz = press.stress[:, 0]
    t = np.stack([rr * n[0] + rz * n[1], rz * n[0] + zz * n[1]])
    return (t * n).sum(axis=0), t[1] * n[0] - t[0] * n[1]


@pytest.mark.parametrize("name", SphereTable.shipped())
@pytest.mark.parametrize("depth", [0.2, 1.2])
def test_a_press_balances_its_force_and_its_skin_is_free_but_for_the_sphere(name, depth):
    table = SphereTable.load(name)
    press = table.at(depth)
    # the stress is projected to a smooth field, and its peak at the bonded rim is read on a few knots
    assert -over_a_circle(press.stress[2, -1], press.r) == pytest.approx(press.force, rel=0.01)
    load = 2 * math.pi * np.trapezoid(press.top_load * press.r, press.r)
    assert load == pytest.approx(press.force, rel=0.01)  # the edge lies somewhere within a knot of 0.02 R
    normal, tangential = np.array(top_traction(press)) / press.peak_pressure
    around = (press.r > press.contact_radius + 0.06) & (press.r < 5.5)
    assert max(np.abs(normal[around]).max(), np.abs(tangential[around]).max()) < 0.01
    under = (press.r > 0.1) & (press.r < press.contact_radius - 0.06)
    if table.friction == 0:
        assert np.abs(tangential[under]).max() < 0.015
    else:
        assert (press.top_friction[under] < 0.002).all()  # inwards, against the skin that flows out
        held = np.abs(press.top_friction[under]) / press.peak_pressure
        assert (held + table.friction * normal[under]).max() < 0.03  # within Coulomb's cone
    sphere = depth - 1 + np.sqrt(1 - np.minimum(press.r, 1) ** 2)
    # the contact is held by springs that give way by less than 0.001 R
    assert np.abs(press.surface - sphere)[press.r < press.contact_radius - 0.02].max() < 1.5e-3
    beyond = (press.r > press.contact_radius + 0.02) & (press.r < 1)
    assert (press.surface - sphere > -1e-3)[beyond].all()


def test_below_its_first_depth_stress_on_the_base_goes_as_the_force():
    table = SphereTable.load("sphere-h2-mu0")
    press, first = table.at(table.depth[1] / 2), table.stress[1][2, -1]
    wanted = first * (press.force / table.force[1])
    np.testing.assert_allclose(press.stress[2, -1], wanted, atol=0.02 * np.abs(wanted).max())


@pytest.mark.parametrize("thickness", [2.0, 4.0])
def test_as_the_press_gets_shallow_its_force_tends_to_the_small_strain_layers(thickness):
    table = SphereTable.load(f"sphere-h{thickness:g}-mu0")
    shallow = [d for d in table.depth if 0.02 <= d <= 0.2]
    linear = np.array([layer.sphere_force(d, 1.0, thickness, 1.0, 0.49) for d in shallow])
    presses = [table.at(d) for d in shallow]
    excess = np.array([p.force for p in presses]) / linear - 1
    radius = np.array([p.contact_radius for p in presses])
    # finite strain takes a share in proportion to a/R: 3 to 4 % at 0.2 R. The springs of the contact take
    # 0.2 % at the shallowest depth, the mesh as much
    slope, start = np.polyfit(radius, excess, 1)
    assert abs(start) < 0.004
    assert -0.10 < slope < -0.05
    assert np.abs(excess - start - slope * radius).max() < 0.002


def test_between_thicknesses_a_table_reads_what_is_solved_there():
    """A disc 2.1 R thick, drawn from 2, 2.2 and another, against solving it."""
    table = SphereTable.of_disc(2.1, 0.0, 0.49)
    with np.load(HERE / "between-sphere-h21-mu0.npz") as solved:
        for i, depth in enumerate(solved["depth"]):
            found = table.at(float(depth))
            assert found.force == pytest.approx(solved["force"][i], rel=3e-4)
            assert found.contact_radius == pytest.approx(solved["contact_radius"][i], rel=2.5e-3)
            surface = np.interp(solved["r"], found.r, found.surface)
            np.testing.assert_allclose(surface, solved["surface"][i], atol=2e-3 * depth)
            read = RegularGridInterpolator((found.zeta, found.r), np.moveaxis(found.stress, 0, -1))
            at = np.stack(np.meshgrid(solved["zeta"], solved["r"], indexing="ij"), axis=-1)
            off = np.moveaxis(read(at), -1, 0) - solved["stress"][i]
            assert np.sqrt(np.mean(off**2)) < 2e-3 * np.abs(solved["stress"][i]).max()


def test_a_thickness_outside_those_solved_is_refused_and_friction_has_its_own():
    for asked in ((1.7, 0.0, 0.49), (3.0, 0.0, 0.49), (2.1, 0.5, 0.49), (2.1, 0.0, 0.45)):
        assert not SphereTable.holds(*asked)
        with refused("no-table", RangeError):
            SphereTable.of_disc(*asked)
    thin, thick = (SphereTable.of_disc(h, 0.0, 0.49).at(0.8).force for h in (1.9, 2.1))
    assert thin > SphereTable.load("sphere-h2-mu0").at(0.8).force > thick, "a thinner disc is stiffer"


@pytest.mark.parametrize("name", SphereTable.shipped())
def test_between_its_depths_a_table_reads_what_is_solved_there(name):
    table = SphereTable.load(name)
    with np.load(HERE / f"between-{name}.npz") as solved:
        solved = dict(solved)
    for i, depth in enumerate(solved["depth"]):
        press = table.at(float(depth))
        assert press.force == pytest.approx(solved["force"][i], rel=3e-4)
        assert press.contact_radius == pytest.approx(solved["contact_radius"][i], rel=1e-3)
        assert press.peak_pressure == pytest.approx(solved["peak_pressure"][i], rel=1e-3)
        assert np.abs(press.surface[::4] - solved["surface"][i]).max() < 3e-3
        error = np.abs(press.stress[:, ::4, ::4] - solved["stress"][i]) / np.abs(solved["stress"][i]).max()
        assert math.sqrt((error**2).mean()) < 2.5e-3
        assert error.max() < 0.065  # at the contact's edge, where the stress turns within one cell


def test_the_generator_gives_the_tables_force_on_a_coarse_mesh(monkeypatch):
    pytest.importorskip("skfem", reason="the generator needs scikit-fem")
    monkeypatch.syspath_prepend(str(REPOSITORY / "tools"))
    from finite_strain.disc import Disc
    from finite_strain.neo_hookean import NeoHookean
    from finite_strain.press import Press

    press = Press(Disc(2.0, 1 / 12), NeoHookean(0.49), 0.0)
    *_, last = press.through([0.02, 0.06, 0.1, 0.15, 0.2])
    # four times coarser: five cells from the axis to the edge
    assert press.force(last) == pytest.approx(SphereTable.load("sphere-h2-mu0").at(0.2).force, rel=0.01)


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("depth_m", [1e-3, 5e-3])
def test_the_load_on_the_grid_adds_up_to_the_force_wherever_the_press_is(friction, depth_m):
    contact = press_finite_strain(BALL, Pose(4e-3, -6e-3, depth_m), E, 4 * R, DISC, friction)
    cell = (contact.x_m[1] - contact.x_m[0]) * (contact.y_m[1] - contact.y_m[0])
    # 27 cells a sphere radius: the cut rim is worth 1 %
    assert contact.pressure_pa.sum() * cell == pytest.approx(contact.force_n, rel=0.015)
    assert contact.displacement_m.max() == pytest.approx(depth_m, rel=0.01)
    assert (contact.pressure_pa[~contact.touching] < 1e-2 * contact.pressure_pa.max()).mean() > 0.97
    assert (contact.shear_pa is None) == (friction == 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth_m": 6.1e-3}, "outside-table"),
        ({"depth_m": math.nan}, "outside-table"),
        ({"thickness_m": 15e-3}, "no-table"),
        ({"friction": 0.3}, "no-table"),
        ({"poisson_ratio": 0.5}, "no-table"),
        ({"disc_radius_m": 20e-3}, "disc-too-small"),
        ({"youngs_modulus_pa": -1.0}, "not-positive"),
        ({"radius_m": 0.0}, "not-positive"),
        ({"x_m": 25e-3}, "contact-over-rim"),
    ],
)
def test_what_no_table_holds_is_refused_with_what_is_allowed(change, message):
    asked = {"radius_m": R, "x_m": 0.0, "depth_m": 3e-3, "youngs_modulus_pa": E, "thickness_m": 2 * R}
    asked |= {"disc_radius_m": DISC} | change
    probe = Probe("sphere", asked.pop("radius_m"))
    pose = Pose(asked.pop("x_m"), 0.0, asked.pop("depth_m"))
    with refused(message, RangeError):
        press_finite_strain(probe, pose, **asked)


def test_other_shapes_names_and_places_are_refused():
    with refused("no-table", InputError):
        press_finite_strain(Probe("cylinder", R), Pose(0.0, 0.0, 1e-3), E, 2 * R, DISC)
    with pytest.raises(InputError, match="finite position"):
        press_finite_strain(BALL, Pose(math.nan, 0.0, 1e-3), E, 2 * R, DISC)
    with pytest.raises(InputError, match="sphere-h2-mu0"):
        SphereTable.load("sphere-h3-mu0")
    for depth in (-0.1, 1.3, math.nan, math.inf):
        with refused("outside-table", RangeError, match="1.2"):
            SphereTable.load("sphere-h2-mu0").at(depth)
