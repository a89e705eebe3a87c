"""The finite-strain tables of a rounded punch, against balances, linear layers and their own generator."""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from tests.refusals import refused

from palpate.core import InputError, Pose, Probe, RangeError
from palpate.mechanics.axisymmetric.shape_table import (
    EDGE,
    PunchTable,
    is_punched,
    press_finite_strain,
)
from palpate.mechanics.layers import bonded_layer as layer

HERE = Path(__file__).parent
REPOSITORY = HERE.parent.parent
E, R = 0.3e6, 4e-3
H, DISC = 2.5 * R, 2.85 * 2.5 * R
PUNCH = Probe("punch", R)
NAMES = PunchTable.shipped()
# below 1, since the disc ends and Hayes's layer does not
LIMIT = dict(zip(NAMES, (0.9935, 0.9956, 0.9973), strict=True))
STUDY = json.loads((REPOSITORY / "tools/punch_study.json").read_text())["meshes"]


def over_a_circle(values, r):
    return 2 * math.pi * float(CubicSpline(r, values * r).integrate(r[0], r[-1]))


def rounded_end(r, depth):
    """Depth of the punch's surface at r inside its radius."""
    return depth - EDGE + np.sqrt(EDGE**2 - np.clip(r - (1 - EDGE), 0, EDGE) ** 2)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("depth", [0.05, 0.33, 0.9])
def test_a_press_balances_its_force_and_its_skin_is_free_but_for_the_punch(name, depth):
    press = PunchTable.load(name).at(depth)
    assert -over_a_circle(press.stress[2, -1], press.r) == pytest.approx(press.force, rel=0.005)
    load = 2 * math.pi * np.trapezoid(press.top_load * press.r, press.r)
    assert load == pytest.approx(press.force, rel=0.01)
    under = press.r < press.contact_radius - 0.01
    assert np.abs(press.surface - rounded_end(press.r, depth))[under].max() < 1e-3
    beside = (press.r > press.contact_radius) & (press.r < 1)
    assert (press.surface > rounded_end(press.r, depth) - 1e-3)[beside].all()
    slope = np.gradient(press.surface, press.r)
    n = np.stack([slope, -np.ones_like(slope)]) / np.hypot(1, slope)
    rr, _, zz, rz = press.stress[:, 0]
    t = np.stack([rr * n[0] + rz * n[1], rz * n[0] + zz * n[1]])
    around = (press.r > 1.08) & (press.r < press.disc_radius - 0.3)
    assert np.abs(np.hypot(*t)[around]).max() < 0.02 * press.peak_pressure
    assert np.abs(rz[press.r < 0.85]).max() < 0.01 * press.peak_pressure


@pytest.mark.parametrize("name", NAMES)
def test_as_the_press_gets_shallow_its_force_tends_to_the_linear_layers(name):
    """Hayes's flat punch of the radius where the edge begins; what touches more grows as d^(2/3)."""
    table = PunchTable.load(name)
    a = 1 - EDGE
    flat = 2 * a / (1 - 0.49**2) * layer.punch_factor(a / table.thickness, 0.49)
    shallow = table.depth[1:6]
    slope, start = np.polyfit(shallow ** (2 / 3), table.force[1:6] / (flat * shallow), 1)
    assert start == pytest.approx(LIMIT[name], abs=0.001)
    assert 0.15 < slope < 0.35


def test_the_work_of_the_force_is_the_energy_of_the_strain():
    """Between the depths of the study, by the table's force: dW = F dd."""
    table = PunchTable.load("punch-h25-mu0")
    rows = [row for row in STUDY if row["cells_per_radius"] == 160]
    assert len(rows) >= 8
    for one, other in pairwise(rows):
        between = np.linspace(one["depth"], other["depth"], 201)
        work = np.trapezoid(table.force_at(between), between)
        assert other["energy"] - one["energy"] == pytest.approx(work, rel=8e-4)


def test_between_its_depths_a_table_reads_what_was_solved_there():
    table = PunchTable.load("punch-h25-mu0")
    with np.load(HERE / "between-punch-h25-mu0.npz") as solved:
        solved = dict(solved)
    assert len(solved["depth"]) >= 7
    for i, depth in enumerate(solved["depth"]):
        press = table.at(float(depth))
        assert press.force == pytest.approx(solved["force"][i], rel=3e-4)
        assert press.contact_radius == pytest.approx(solved["contact_radius"][i], rel=2e-3)
        assert press.peak_pressure == pytest.approx(solved["peak_pressure"][i], rel=0.01)
        assert np.abs(press.surface[::3] - solved["surface"][i]).max() < 1e-3
        error = np.abs(press.stress[:, ::3, ::3] - solved["stress"][i]) / np.abs(solved["stress"][i]).max()
        assert math.sqrt((error**2).mean()) < 4e-3
        assert error.max() < 0.12  # at the contact's edge, while it still moves over the rounding


def test_below_its_first_depth_a_table_reads_in_proportion():
    table = PunchTable.load("punch-h25-mu0")
    half = table.at(table.depth[1] / 2)
    assert half.force == pytest.approx(table.force[1] / 2, rel=0.01)
    np.testing.assert_allclose(half.stress, table.stress[1] * (half.force / table.force[1]), atol=1e-9)
    untouched = table.at(0.0)
    assert untouched.force == untouched.contact_radius == 0
    assert not untouched.surface.any()
    assert not untouched.stress.any()


def test_the_generator_gives_the_tables_force_and_balances_its_work_on_a_coarse_mesh(monkeypatch):
    pytest.importorskip("skfem", reason="the generator needs scikit-fem")
    monkeypatch.syspath_prepend(str(REPOSITORY / "tools"))
    from finite_strain.neo_hookean import NeoHookean
    from finite_strain.rounded_punch import PunchPress, punch_disc

    press = PunchPress(punch_disc(2.5, 1 / 24), NeoHookean(0.49))
    found = [
        (b.depth, press.force(b), press.energy(b)) for b in press.through([0.01, 0.02, 0.03, 0.04, 0.06])
    ]
    depth, force, energy = np.array([(0.0, 0.0, 0.0), *found]).T
    assert force[-1] == pytest.approx(PunchTable.load("punch-h25-mu0").at(0.06).force, rel=5e-3)
    assert energy[-1] == pytest.approx(CubicSpline(depth, force).integrate(0, 0.06), rel=3e-3)


@pytest.mark.parametrize("depth_m", [0.4e-3, 3.6e-3])
def test_the_pressure_on_the_grid_adds_up_to_the_force_wherever_the_press_is(depth_m):
    contact = press_finite_strain(PUNCH, Pose(4e-3, -6e-3, depth_m), E, H, DISC)
    cell = (contact.x_m[1] - contact.x_m[0]) * (contact.y_m[1] - contact.y_m[0])
    assert contact.pressure_pa.sum() * cell == pytest.approx(contact.force_n, rel=0.015)
    assert contact.displacement_m.max() == pytest.approx(depth_m, rel=1e-3)
    assert not contact.pressure_pa[~contact.touching].any() or (
        contact.pressure_pa[~contact.touching].max() < contact.pressure_pa.max()
    )
    assert contact.shear_pa is None
    assert is_punched(contact)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth_m": -1e-3}, "outside-table"),
        ({"depth_m": math.nan}, "outside-table"),
        ({"thickness_m": 12e-3}, "no-table"),
        ({"friction": 0.3}, "no-table"),
        ({"poisson_ratio": 0.5}, "no-table"),
        ({"disc_radius_m": 20e-3}, "disc-too-small"),
        ({"youngs_modulus_pa": -1.0}, "not-positive"),
        ({"x_m": 25e-3}, "contact-over-rim"),
    ],
)
def test_what_no_table_holds_is_refused_with_what_is_allowed(change, message):
    asked = {"x_m": 0.0, "depth_m": 2e-3, "youngs_modulus_pa": E, "thickness_m": H, "disc_radius_m": DISC}
    asked |= change
    pose = Pose(asked.pop("x_m"), 0.0, asked.pop("depth_m"))
    with refused(message, RangeError):
        press_finite_strain(PUNCH, pose, **asked)


@pytest.mark.parametrize("name", NAMES[:1])
def test_deeper_than_the_table_is_refused_with_its_depth(name):
    table = PunchTable.load(name)
    most = table.greatest_depth
    assert table.at(most).force > 0
    with pytest.raises(RangeError, match=rf"0 to {most:g} R"):
        table.at(most + 0.001)
    allowed = rf"of a punch of radius 4 mm lies outside 0 to {most * R * 1e3:g} mm"
    thick = table.thickness * R
    with pytest.raises(RangeError, match=allowed):
        press_finite_strain(PUNCH, Pose(0.0, 0.0, (most + 0.01) * R), E, thick, 2.85 * thick)


def test_other_shapes_and_a_leaning_punch_are_refused():
    for probe in (Probe("cylinder", R), Probe("punch", R, tilt_rad=0.01)):
        with refused("no-table", InputError):
            press_finite_strain(probe, Pose(0.0, 0.0, 1e-3), E, H, DISC)
    assert not PunchTable.holds(3.0, 0.0, 0.49)
    with refused("no-table", RangeError):
        PunchTable.of_disc(3.0, 0.0, 0.49)
