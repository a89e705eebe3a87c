"""Volts to millimetres and pascals: what a table and a line say, and where they say nothing."""

import math

import pytest
from tests.refusals import refused

from palpate.core import InputError
from palpate.softness.real import HallTable, OffScaleError, PressureScale

BENT = HallTable(volts=(2.5, 3.1, 4.5), pushed_mm=(0.0, 4.0, 10.0))


@pytest.mark.parametrize(("volts", "pushed_mm"), [(2.5, 0), (2.8, 2), (3.1, 4), (3.8, 7), (4.5, 10)])
def test_a_table_is_straight_between_its_points(volts: float, pushed_mm: float) -> None:
    assert BENT.pushed_m(volts) == pytest.approx(1e-3 * pushed_mm, abs=1e-12)
    falling = HallTable(volts=tuple(5.0 - v for v in BENT.volts), pushed_mm=BENT.pushed_mm)
    assert falling.pushed_m(5.0 - volts) == pytest.approx(1e-3 * pushed_mm, abs=1e-12)


def test_a_table_that_begins_below_rest_does_not_excuse_readings_below_it() -> None:
    table = HallTable(volts=(2.0, 2.5, 4.5), pushed_mm=(-1.0, 0.0, 10.0))
    assert table.pushed_m(2.46) == pytest.approx(-0.08e-3)
    with refused("off-scale", OffScaleError, match="0 mm"):
        table.pushed_m(2.4)


@pytest.mark.parametrize(
    ("volts", "pushed_mm", "said"),
    [
        ((), (), "table-size"),
        ((2.5,), (0.0,), "table-size"),
        ((2.5, 4.5), (0.0,), "table-size"),
        ((2.5, 4.5, 4.0), (0.0, 5.0, 10.0), "not-monotone"),
        ((2.5, 2.5), (0.0, 10.0), "not-monotone"),
        ((2.5, 4.5), (0.0, 0.0), "not-monotone"),
        ((2.5, 4.5), (10.0, 0.0), "not-monotone"),
        ((2.5, 4.5), (1.0, 10.0), "no-zero"),
        ((2.5, math.nan), (0.0, 10.0), "not-finite"),
    ],
)
def test_a_table_that_is_none_is_refused(
    volts: tuple[float, ...], pushed_mm: tuple[float, ...], said: str
) -> None:
    with refused(said, InputError):
        HallTable(volts, pushed_mm)


def test_a_scale_leads_to_volts_and_back() -> None:
    scale = PressureScale(low_v=1.0, high_v=5.0, high_pa=100e3)
    assert [scale.volts(p) for p in (0.0, 25e3, 100e3)] == [1.0, 2.0, 5.0]
    assert scale.pressure_pa(scale.volts(37e3)) == pytest.approx(37e3)


@pytest.mark.parametrize(
    "wrong", [{"low_v": 5.0, "high_v": 1.0}, {"high_pa": 0.0}, {"high_pa": math.nan}, {"tolerance_pa": -1.0}]
)
def test_a_scale_that_is_none_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        PressureScale(**{"low_v": 1.0, "high_v": 5.0, "high_pa": 1e5, **wrong})
