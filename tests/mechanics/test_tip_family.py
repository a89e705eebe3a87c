"""Tips between the tables: through every table, and near tips that were solved anew between them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import RangeError
from palpate.mechanics.axisymmetric.tip_table import ratio_range, shipped_tips, tip_between, tip_table

SOLVED = json.loads((Path(__file__).parent / "tips_between_tables.json").read_text())
"""By the solver of `tools/tip_tables.py`, each a minute; in no table."""


@pytest.mark.parametrize("name", shipped_tips())
def test_a_tip_of_a_table_s_ratio_is_the_table_s(name: str) -> None:
    table = tip_table(name)
    press = table.press(math.inf)
    found = tip_between(math.log(table.skin_pa / table.gel_pa))
    assert_allclose([found.skin_pa, found.gel_pa], [table.skin_pa, table.gel_pa], rtol=1e-5)
    depth = np.linspace(0.75e-3, 0.99 * press.approach_m[-1], 9)
    force = press.force_at(depth)
    assert_allclose(found.press.force_at(depth), force, rtol=1e-3)
    places = found.press.at("inside_m", found.press.force_at(depth))
    assert_allclose(places, press.at("inside_m", force), atol=2e-6)
    assert_allclose(
        found.press.at("area_m2", found.press.force_at(depth)), press.at("area_m2", force), rtol=0.02
    )


@pytest.mark.parametrize("ratio", SOLVED)
def test_a_tip_between_the_tables_is_the_one_that_was_solved_there(ratio: str) -> None:
    solved = SOLVED[ratio]
    found = tip_between(math.log(solved["skin_mpa"] / solved["gel_mpa"]))
    depth = 1e-3 * np.array(solved["approach_mm"])
    force = found.press.force_at(depth)
    assert_allclose(force * 1e6 * solved["gel_mpa"] / found.gel_pa, solved["force_n"], rtol=2e-3)
    places = found.press.at("inside_m", force)[:, solved["nodes"]]
    assert_allclose(places, 1e-3 * np.array(solved["inside_mm"]), atol=3e-6)
    other = tip_between(math.log(1.2 * solved["skin_mpa"] / solved["gel_mpa"]))  # a fifth off is seen
    assert (
        np.abs(other.press.at("inside_m", other.press.force_at(depth))[:, solved["nodes"]] - places).max()
        > 6e-6
    )
    assert np.abs(other.press.force_at(depth) / other.gel_pa / (force / found.gel_pa) - 1).min() > 0.03


def test_ratios_beyond_the_tables_are_refused() -> None:
    low, high = ratio_range()
    assert_allclose([low, high], [1, 60], rtol=1e-6)
    for ratio in (0.9 * low, 1.1 * high):
        with refused("outside-table", RangeError, match="60"):
            tip_between(math.log(ratio))
