"""Tips on domes and layers at finite strain: separate solutions between the table's, and its limits."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.mechanics.axisymmetric.shape_table import SCALARS, shape_table
from palpate.mechanics.axisymmetric.tip_table import tip_table

FORCES = np.array([1.0, 3.0, 5.0])
# Solved by `tools/specimen_tables.py --check` and not in the table: area [mm2], approach and flattening [mm].
DOMES = {
    (0.13e6, 32e-3): ((154.94, 323.16, 432.75), (3.7329, 6.8605, 8.8099), (3.1608, 5.6028, 6.9602)),
    (0.05e6, 23e-3): ((165.64, 345.82, 465.10), (4.6531, 8.7906, 11.5133), (3.1579, 5.5570, 6.8337)),
    (0.3e6, 55e-3): ((161.48, 340.32, 458.47), (3.2159, 5.8200, 7.3879), (2.9750, 5.2880, 6.6006)),
    (np.inf, 32e-3): ((130.96, 278.86, 369.54), (3.3181, 5.9259, 7.4194), (3.3149, 5.9205, 7.4122)),
}
LAYERS = {
    (0.08e6, 3e-3): ((208.38, 424.89, 562.93), (2.6415, 4.6814, 5.8686), (2.5876, 4.6072, 5.7807)),
    (0.2e6, 1.5e-3): ((193.26, 402.55, 539.14), (2.6148, 4.6450, 5.8237), (2.6057, 4.6318, 5.8071)),
    (0.05e6, 6e-3): ((228.65, 453.18, 600.05), (2.7469, 4.8341, 6.0612), (2.4734, 4.4647, 5.6196)),
}


@pytest.fixture(scope="module")
def table():
    return shape_table("base")


def assert_as_solved(press, solved) -> None:
    area, approach, flattening = solved
    assert_allclose(1e6 * press.at("area_m2", FORCES), area, rtol=0.025)
    assert_allclose(1e3 * press.at("approach_m", FORCES), approach, rtol=0.002)
    assert_allclose(1e3 * press.at("flattening_m", FORCES), flattening, rtol=0.004)


@pytest.mark.parametrize("body", list(DOMES))
def test_a_dome_between_those_of_the_table_is_read_as_if_it_were_solved(table, body) -> None:
    assert_as_solved(table.dome(body[1], body[0]), DOMES[body])


@pytest.mark.parametrize("body", list(LAYERS))
def test_a_layer_between_those_of_the_table_is_read_as_if_it_were_solved(table, body) -> None:
    assert_as_solved(table.layer(body[1], body[0]), LAYERS[body])


@pytest.mark.parametrize("modulus_pa", [0.045e6, 0.1687e6, np.inf])
def test_a_dome_without_curvature_is_the_flat_cylinder(table, modulus_pa) -> None:
    flat, dome = tip_table("base").press(modulus_pa), table.dome(np.inf, modulus_pa)
    for column in SCALARS:
        assert_allclose(getattr(dome, column), getattr(flat, column), rtol=1e-9)
    assert_allclose(dome.inside_m, flat.inside_m, atol=1e-8)
    curved = table.dome(100e-3, modulus_pa)
    assert abs(curved.approach_m[-1] / flat.approach_m[-1] - 1) > 0.01  # and a slight dome is another body


def test_a_thin_layer_is_a_rigid_plate_and_a_thick_one_yields(table) -> None:
    plate = tip_table("base").press(np.inf).at("approach_m", FORCES)
    yields = np.array(
        [table.layer(h, 0.05e6).at("approach_m", FORCES) / plate - 1 for h in (1e-3, 3e-3, 8e-3)]
    )
    assert (np.diff(yields, axis=0) > 0).all()
    assert (np.abs(yields[0]) < 0.01).all()
    assert (yields[-1] > 0.05).all()


def test_what_was_not_solved_is_named(table) -> None:
    with refused("radius-outside-table", RangeError, match="20"):
        table.dome(15e-3, np.inf)
    with pytest.raises(RangeError, match="stiffer"):
        table.dome(30e-3, 1e4)
    with refused("thickness-outside-table", RangeError):
        table.layer(0.5e-3, 0.1e6)
    with refused("modulus-outside-table", RangeError, match=r"0\.03"):
        table.layer(2e-3, 1e4)
    with refused("no-table", InputError):
        shape_table("even")
    assert replace(table).least_radius_m == pytest.approx(20e-3)
