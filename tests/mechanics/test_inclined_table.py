"""Inclined tips at finite strain, as shipped: the head-on table's tip, small presses, and what is refused."""

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import RangeError
from palpate.mechanics.axisymmetric.tip_table import FOLDER, inclined_table, tip_table

FORCES = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
TABLE = inclined_table("base")
MODULI = [np.inf, 1e6, 0.2419e6]  # at both tilts; at 30 degrees softer ones too


@pytest.fixture(scope="module")
def table():
    return TABLE


def test_its_tip_and_specimens_are_those_of_the_head_on_table() -> None:
    upright = tip_table("base")
    path = resources.files("palpate.mechanics") / FOLDER / "inclined-base.npz"
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        tip, specimen = arrays["tip"], arrays["specimen"]
    assert_allclose(tip[:2], [1e3 * upright.radius_m, 1e3 * upright.skin_m])
    assert_allclose(tip[2:], [1e-6 * upright.skin_pa, 1e-6 * upright.gel_pa, upright.poisson_ratio])
    assert_allclose(specimen, [1e3 * upright.specimen_radius_m, 1e3 * upright.specimen_height_m])


@pytest.mark.parametrize("tilt", TABLE.tilt_rad)
@pytest.mark.parametrize("pa", MODULI)
def test_a_small_press_is_nearly_a_head_on_one_along_the_normal(table, tilt, pa) -> None:
    """A sphere has no side: approach along the normal and area are those of the normal force.

    Taken for the normal one, the force along the axis, or the approach, would be 15 or 41 % off.
    """
    c, lift = np.cos(tilt), np.array([0.1, 0.3])
    side, upright = table.press(pa, tilt), table.head_on.press(pa)
    assert_allclose(c * side.at("approach_m", lift), upright.at("approach_m", lift / c), rtol=0.03)
    assert_allclose(side.at("area_m2", lift), upright.at("area_m2", lift / c), rtol=0.06)


def test_at_30_degrees_a_rigid_plate_meets_nearly_the_head_on_tip_up_to_5_n_and_at_45_the_base_is_felt() -> (
    None
):
    """By approach along the normal at the same normal force; what holds the tip is nearer at the side."""
    upright = TABLE.head_on.press(np.inf)
    for tilt, lift, ratio in ((30.0, 4.0, 0.996), (45.0, 3.0, 0.932)):
        c = np.cos(np.deg2rad(tilt))
        side = TABLE.press(np.inf, np.deg2rad(tilt))
        approach = (
            c * side.at("approach_m", np.array([lift])) / upright.at("approach_m", np.array([lift / c]))
        )
        assert_allclose(approach, ratio, atol=0.01)


INNER = [
    (tilt, E)
    for tilt, softest, there in zip(TABLE.tilt_rad, TABLE.softest_pa, TABLE.solved, strict=True)
    for E in TABLE.specimen_pa[there]
    if softest < E < np.inf
]


@pytest.mark.parametrize(("tilt", "left_out"), INNER)
def test_a_modulus_that_is_left_out_is_read_from_its_neighbours(tilt, left_out) -> None:
    kept = TABLE.specimen_pa != left_out
    columns = {name: values[:, kept] for name, values in TABLE.columns.items()}
    other = replace(TABLE, specimen_pa=TABLE.specimen_pa[kept], columns=columns).press(left_out, tilt)
    press = TABLE.press(left_out, tilt)
    assert_allclose(other.at("approach_m", FORCES), press.at("approach_m", FORCES), rtol=0.005)
    assert_allclose(other.at("area_m2", FORCES), press.at("area_m2", FORCES), rtol=0.02)
    off = np.abs(other.at("moved_m", FORCES) - press.at("moved_m", FORCES))
    assert off.max() < 120e-6


@pytest.mark.parametrize(
    ("pa", "degrees"), [(1e6, 20.0), (1e6, 0.0), (1e6, 30.01), (3.4e4, 30.0), (9e4, 45.0), (np.nan, 30.0)]
)
def test_what_is_not_in_the_table_is_refused(table, pa, degrees) -> None:
    tilt = float(np.deg2rad(degrees))
    assert not table.holds(pa, tilt)
    with refused("outside-table", RangeError):
        table.press(pa, tilt)


@pytest.mark.parametrize("degrees", [30, 45])
def test_the_force_of_the_deepest_approach_is_inside_the_table(table, degrees) -> None:
    """Its last force is the cube of a cube root, which a rounding may lift past the table's end."""
    press = table.press(np.inf, np.deg2rad(degrees))
    for last_n in np.linspace(4.0, press.force_n[-1], 40):
        scaled = replace(press, force_n=press.force_n * last_n / press.force_n[-1])
        deepest = scaled.force_at(scaled.approach_m[-1:])
        assert_allclose(scaled.at("approach_m", deepest), scaled.approach_m[-1:], rtol=1e-6)


def test_a_force_beyond_the_table_is_refused(table) -> None:
    with refused("outside-table", RangeError, match=r"5\.5"):
        table.press(np.inf, TABLE.tilt_rad[0]).at("area_m2", np.array([5.6]))
