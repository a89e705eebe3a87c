"""Units at import: given by name, doubted by their numbers; rows that are shifted against the images."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from palpate.core import LabelError, UnitError
from palpate.recordings.exchange.label_files import unit_doubts, with_units


def table(**columns: object) -> pd.DataFrame:
    return pd.DataFrame(columns)


@pytest.mark.parametrize(
    ("renames", "units", "error", "words"),
    [
        ({"F": "force_N"}, {}, LabelError, ("'F'", "depth, load_N")),
        ({}, {"deep": "mm"}, LabelError, ("'deep'", "depth, load_N")),
        ({}, {"depth": "inch"}, UnitError, ("'inch'", "mm")),
        ({}, {"load_N": "mN"}, UnitError, ("N", "--rename load_N=load_mN")),
        ({"depth": "load_N"}, {}, LabelError, ("two columns", "'load_N'")),
        ({"depth": "load"}, {"load": "N"}, LabelError, ("two columns", "'load_N'")),
        ({"depth": " "}, {}, LabelError, ("to nothing",)),
        ({"depth": "own:depth_mm"}, {}, LabelError, ("rename it",)),
    ],
)
def test_a_name_or_a_unit_that_cannot_be_is_refused(renames, units, error, words) -> None:
    with pytest.raises(error) as caught:
        with_units(table(depth=[1.0], load_N=[2.0]), renames, units, "labels.csv")
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("depth_mm", (0, 3000), "--rename depth_mm=depth_um"),
        ("force_N", (0, 5000), "--rename force_N=force_mN"),
        ("depth_mm", (0, 0.003), "--rename depth_mm=depth_m"),
        ("tilt_deg", (-np.pi, np.pi), "--rename tilt_deg=tilt_rad"),
        ("tilt_rad", (-25, 25), "--rename tilt_rad=tilt_deg"),
    ],
)
def test_numbers_in_another_unit_are_doubted_with_the_mending_option(name, values, says) -> None:
    (doubt,) = unit_doubts(table(**{name: np.linspace(*values, 200)}))
    assert doubt.startswith(f"column {name} runs from")
    assert says in doubt


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("depth_mm", (0.5, 6)),
        ("tilt_x_deg", (-25, 25)),
        ("angle_deg", (-180, 180)),
        ("x_mm", (-800, 800)),
        ("force_N", (0, 60)),
        ("at_s", (0, 1.8e9)),
        ("modulus_Pa", (1e4, 7e10)),
        ("depth_mm", (0, 0)),
    ],
)
def test_numbers_that_touch_has_are_not_doubted(name, values) -> None:
    assert unit_doubts(table(**{name: np.linspace(*values, 200)})) == ()


def test_a_column_with_a_unit_that_holds_text_is_told() -> None:
    (doubt,) = unit_doubts(table(depth_mm=["1.5", "deep", "2"]))
    assert "row 3" in doubt


def test_a_code_of_missing_values_is_no_unit() -> None:
    """Two of 80 depths at -999: the rows are named, and no unit is guessed from them."""
    depths = np.random.default_rng(0).uniform(0.1, 2.0, 80)
    depths[[14, 52]] = -999
    (doubt,) = unit_doubts(table(depth_mm=depths))
    assert "hold -999" in doubt
    assert "rows 16" in doubt.replace(",", " and")
    assert "--rename" not in doubt
    depths[[14, 52]] = 99  # mm is a usual length, and 99 no usual depth of these presses
    assert "hold 99" in unit_doubts(table(x_mm=depths))[0]
    assert unit_doubts(table(x_mm=np.where(depths == 99, 30.0, depths))) == ()
    (meant,) = unit_doubts(table(depth_mm=1000 * np.where(depths == 99, 1.0, depths)))
    assert "--rename depth_mm=depth_um" in meant


@pytest.mark.parametrize("cell", ["inf", ""])
def test_cells_without_a_number_are_named_to_be_removed(cell) -> None:
    (doubt,) = unit_doubts(table(depth_mm=["0.5", cell, "1.5", cell]))
    assert doubt.endswith("it cannot be a target; fill in or remove rows 3, 5")
    assert "remove" not in unit_doubts(table(depth_mm=["deep", "flat"]))[0]
