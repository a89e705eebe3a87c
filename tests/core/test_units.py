"""Units at the edges are those of the SI's own tables, and a column's name says which is meant."""

import pytest
from scipy import constants
from tests.refusals import refused

from palpate.core.errors import UnitError
from palpate.core.units import UNITS, has_unit, split_column, unit

FACTORS = {
    "mm": constants.milli,
    "um": constants.micro,
    "mm2": constants.milli**2,
    "deg": constants.degree,
    "mm2_per_N": constants.milli**2,
    "mN": constants.milli,
    "kgf": constants.kilogram_force,
    "Nmm": constants.milli,
    "kPa": constants.kilo,
    "MPa": constants.mega,
    "N_per_mm": 1 / constants.milli,
    "g": constants.gram,
    "ms": constants.milli,
}


@pytest.mark.parametrize("symbol", UNITS)
def test_a_unit_has_its_factor_to_si(symbol: str) -> None:
    one = unit(symbol)
    assert one.factor == pytest.approx(FACTORS.get(symbol, 1.0), rel=1e-15)
    assert (one.si == symbol) == (symbol not in FACTORS)
    assert UNITS[one.si].factor == 1.0


@pytest.mark.parametrize("symbol", UNITS)
def test_a_value_goes_to_si_and_back(symbol: str) -> None:
    one = unit(symbol)
    assert one.to_si(2.5) == pytest.approx(2.5 * FACTORS.get(symbol, 1.0), rel=1e-15)
    assert one.from_si(one.to_si(2.5)) == pytest.approx(2.5, rel=1e-15)


def test_the_longest_unit_that_a_name_ends_in_is_meant() -> None:
    quantity, found = split_column("stiffness_N_per_mm")
    assert (quantity, found.symbol) == ("stiffness", "N_per_mm")
    assert split_column("spread_mm2_per_N")[1].symbol == "mm2_per_N"
    assert split_column("top_left_m") == ("top_left", UNITS["m"])


@pytest.mark.parametrize("name", ["depth", "mm", "_mm", "depth_mm_", "depth_inch", "depth_MM", ""])
def test_a_name_without_a_unit_is_refused(name: str) -> None:
    assert not has_unit(name)
    with refused("no-unit", UnitError):
        split_column(name)
