"""Presses off the centre: what they tell of the tables, and of places near the rim."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core.errors import RangeError
from palpate.mechanics.axisymmetric.shape_table import (
    OFF_CENTRE,
    SphereTable,
    edge_correction,
    edge_correction_held,
    edge_reach,
)

THICKNESSES = (2.0, 4.0)
DEPTHS = (0.2, 1.0)


def rows(which: str) -> list[dict[str, float]]:
    found: list[dict[str, float]] = json.loads(OFF_CENTRE.read_text(encoding="utf-8"))[which]
    return found


@pytest.mark.parametrize("row", [r for r in rows("presses") if r["offset"] == 0 and r["depth"] >= 0.2])
def test_a_mesh_and_elements_of_another_kind_give_the_tables_force(row: dict[str, float]) -> None:
    table = SphereTable.load(f"sphere-h{row['thickness']:g}-mu0")
    # Bricks in three dimensions against rings of triangles: 1 % is asked, 0.4 % was found.
    assert row["force"] == pytest.approx(table.at(row["depth"]).force, rel=5e-3)


@pytest.mark.parametrize("thickness", THICKNESSES)
@pytest.mark.parametrize("depth", DEPTHS)
def test_towards_the_rim_the_disc_gives_way_and_pushes_the_ball_out(thickness: float, depth: float) -> None:
    found = [edge_correction(c, depth, thickness) for c in np.linspace(0.0, 4.7, 23)]
    force, side = np.array(found).T
    assert (np.diff(force) < 1e-9).all()
    # Under a thick disc and a shallow press the push is below the solver's rounding until near the rim.
    assert (np.diff(side) > -1e-4).all()
    assert side[-1] > 0.005


@pytest.mark.parametrize("row", [r for r in rows("presses") if r["depth"] >= 0.2])
def test_at_the_places_that_were_solved_the_ratios_are_the_solutions_own(row: dict[str, float]) -> None:
    same = ("thickness", "depth")
    [middle] = [r for r in rows("presses") if r["offset"] == 0 and all(r[p] == row[p] for p in same)]
    effect = edge_correction(row["offset"], row["depth"], row["thickness"])
    assert effect.force_ratio == pytest.approx(row["force"] / middle["force"], rel=1e-9)
    assert effect.side_ratio == pytest.approx(-row["side_force"] / middle["force"], abs=1e-9)


@pytest.mark.parametrize("row", [r for r in rows("between") if r["depth"] >= 0.2])
def test_between_places_a_press_that_was_solved_there_is_met(row: dict[str, float]) -> None:
    same = ("thickness", "depth")
    [middle] = [r for r in rows("presses") if r["offset"] == 0 and all(r[p] == row[p] for p in same)]
    effect = edge_correction(row["offset"], row["depth"], row["thickness"])
    # Found: 5e-4 of the force, the push to as much of it.
    assert effect.force_ratio == pytest.approx(row["force"] / middle["force"], abs=1e-3)
    assert effect.side_ratio == pytest.approx(-row["side_force"] / middle["force"], abs=1e-3)


@pytest.mark.parametrize("thickness", THICKNESSES)
def test_work_saved_near_the_rim_is_the_work_of_the_push_on_the_way_there(thickness: float) -> None:
    """Frictionless contact has an energy U(c, d): its force is dU/dd, its push outwards -dU/dc."""
    table = SphereTable.load(f"sphere-h{thickness:g}-mu0")
    depth, offset = np.linspace(0.0, 1.0, 201), np.linspace(0.0, 4.7, 201)
    force, side = table.force_at(depth), edge_correction_held(offset, np.ones(201), thickness)[1]
    pushed = np.trapezoid(side * force[-1], offset)
    ratio, _ = edge_correction_held(np.full(201, 4.7), depth, thickness)
    saved = np.trapezoid((1 - ratio) * force, depth)
    assert pushed == pytest.approx(
        saved, rel=0.03
    )  # 0.5 and 2 % were found; at 0.6 R, where less is saved, 7 and 1 %


def test_beyond_what_was_solved_the_nearest_press_is_held_where_that_is_asked() -> None:
    reach = edge_reach(2.0)
    assert reach == (4.7, 1.0)
    far, deep = np.array([4.7, 5.6, 4.2, 4.2]), np.array([0.6, 0.6, 1.0, 1.2])
    ratio, side = edge_correction_held(far, deep, 2.0)
    assert (ratio[0], side[0], ratio[2], side[2]) == (ratio[1], side[1], ratio[3], side[3])
    assert (ratio[0], side[0]) == pytest.approx(edge_correction(4.7, 0.6, 2.0), rel=1e-12)
    with refused("outside-table", RangeError):
        edge_correction_held(far, deep, 3.0)


@pytest.mark.parametrize(
    ("offset", "depth", "thickness"),
    [(4.75, 0.5, 2.0), (1.0, 1.1, 2.0), (1.0, 0.5, 3.0), (np.nan, 0.5, 2.0)],
)
def test_beyond_what_was_solved_nothing_is_said(offset: float, depth: float, thickness: float) -> None:
    with pytest.raises(RangeError, match=r"\bR\b"):
        edge_correction(offset, depth, thickness)
