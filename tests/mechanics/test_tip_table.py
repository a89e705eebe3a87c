"""Head-on tips at finite strain: Hertz where strain is small, another code where it is not."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.core.errors import InputError, RangeError
from palpate.mechanics.axisymmetric.tip_table import shipped_tips, tip_table
from palpate.mechanics.half_space.hertz import Body

KAPPA = {"S1": 0.2419e6, "Sn": 0.1687e6, "S2": 0.0987e6, "S3": 0.035e6}
FORCES = np.array([1.0, 2.0, 3.0, 4.0, 5.0])

# Another finite-strain code, written apart from this one (8-node quadrilaterals, reduced integration), gave
# these for the base tip: area [mm2] and flattening [mm] at 1 to 5 N.
OTHER = {
    "S1": ((198, 322, 414, 492, 557), (2.53, 3.67, 4.47, 5.08, 5.57)),
    "Sn": ((206, 330, 423, 503, 571), (2.49, 3.62, 4.40, 5.00, 5.49)),
    "S2": ((217, 347, 450, 532, 600), (2.42, 3.51, 4.26, 4.83, 5.29)),
    "S3": ((262, 412, 528, 625, 712), (2.14, 3.07, 3.70, 4.17, 4.55)),
}


@pytest.mark.parametrize("name", list(OTHER))
def test_area_and_flattening_are_those_of_another_code(name) -> None:
    press = tip_table("base").press(KAPPA[name])
    area, flattening = OTHER[name]
    assert_allclose(1e6 * press.at("area_m2", FORCES), area, rtol=0.02)
    assert_allclose(1e3 * press.at("flattening_m", FORCES), flattening, rtol=0.01)


def test_a_table_ends_at_its_deepest_approach_but_for_rounding() -> None:
    press = tip_table("base").press(1.3e5)
    deepest = press.approach_m[-1:]
    assert press.force_at(deepest * (1 + 1e-7)) == press.force_at(deepest)
    with pytest.raises(RangeError) as refused:
        press.force_at(deepest * (1 + 2e-6))
    asked, end = re.findall(r"[\d.]+(?= mm)", str(refused.value))
    assert float(asked) > float(end)
    press.force_at(np.array([1e-3 * float(end)]))  # as printed


@pytest.mark.parametrize("specimen_mpa", np.linspace(0.04, 0.25, 7))
def test_the_force_of_the_deepest_approach_is_one_that_the_table_knows(specimen_mpa) -> None:
    press = tip_table("base").press(1e6 * specimen_mpa)
    press.at("area_m2", press.force_at(press.approach_m[-1:]))


def test_forces_and_approaches_belong_together() -> None:
    press = tip_table("base").press(1.3e5)
    force = np.linspace(0.1, 5.4, 40)
    assert_allclose(press.force_at(press.at("approach_m", force)), force, rtol=2e-3)
    assert press.force_at(np.array([-1e-3]))[0] == 0.0


@pytest.mark.parametrize("left_out", [4])
def test_a_modulus_between_two_of_the_table_is_read_as_if_it_were_solved(left_out) -> None:
    """A modulus of the table is left out and read from the others."""
    from dataclasses import replace

    table = tip_table("base")
    kept = np.delete(np.arange(len(table.specimen_pa)), left_out)
    thinner = replace(
        table,
        specimen_pa=table.specimen_pa[kept],
        columns={name: values[kept] for name, values in table.columns.items()},
    )
    E = float(table.specimen_pa[left_out])
    whole, read = table.press(E), thinner.press(E)
    for column in ("area_m2", "approach_m", "flattening_m"):
        assert_allclose(read.at(column, FORCES), whole.at(column, FORCES), rtol=6e-3)


def test_an_even_tip_obeys_hertz_while_strain_is_small() -> None:
    if "even" not in shipped_tips():
        pytest.skip("no table of an even tip is shipped")
    table = tip_table("even")
    press = table.press(KAPPA["S1"])
    plane = 1 - table.poisson_ratio**2
    both = Body(table.gel_pa / plane, table.radius_m).against(Body(KAPPA["S1"] / plane, np.inf))
    force = np.array([0.05, 0.1, 0.2])
    assert_allclose(press.at("area_m2", force), both.area_m2(force), rtol=0.06)
    assert_allclose(press.at("approach_m", force), both.approach_m(force), rtol=0.10)


def test_limits_are_named() -> None:
    press = tip_table("base").press(1e5)
    with pytest.raises(RangeError, match=r"5\.5 N"):
        press.at("area_m2", np.array([6.0]))
    with pytest.raises(RangeError, match="approach"):
        press.force_at(np.array([0.05]))
    with pytest.raises(RangeError, match="stiffer"):
        tip_table("base").press(1e3)
    with pytest.raises(InputError, match="there are"):
        tip_table("none")
