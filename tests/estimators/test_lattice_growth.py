"""Marks named by their cell: no wrong name, whatever is missing, turned, sheared, bent or pressed."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.rendered_boards import View

from palpate.core import RangeError
from palpate.estimators.lattice import ControlPoints, grow_lattices, named_as
from palpate.estimators.pins import find_pins
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import record_press


def wrong(cells: np.ndarray, truth: np.ndarray) -> int:
    """Marks whose cell is not the true one under the turn and step that fits most."""
    ones = np.column_stack([cells, np.ones(len(cells))])
    map_ = np.rint(np.linalg.lstsq(ones, truth, rcond=None)[0])
    assert abs(np.linalg.det(map_[:2])) == 1
    return int((np.abs(ones @ map_ - truth).max(axis=1) > 0).sum())


def random_view(rng: np.random.Generator, hexagonal: bool) -> View:
    return View(
        turn=rng.uniform(-0.7, 0.7),
        shear=rng.uniform(-0.2, 0.2),
        barrel=rng.uniform(0, 0.35),
        bulge=rng.uniform(0, 7),
        pitch=rng.uniform(18, 30),
        hexagonal=hexagonal,
    )


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.2, 0.3, 0.4])
@pytest.mark.cases(1)
def test_no_mark_has_a_wrong_cell_whatever_is_missing(kind, share) -> None:
    rng = np.random.default_rng(int(10 * share) + 10 * (kind == "square"))
    reached = []
    for _ in range(6):
        cells, places = random_view(rng, kind == "hexagonal").marks((20, 15))
        there = rng.random(len(cells)) >= share
        cells, places = cells[there], places[there] + rng.normal(0, 0.05, (there.sum(), 2))
        largest = grow_lattices(places, kind)[0]
        assert wrong(largest.cells, cells[largest.marks]) == 0
        reached.append(len(largest.cells) / len(cells))
    assert np.median(reached) > (0.95 if share < 0.35 else 0.8)


def test_each_side_of_a_gap_is_right_by_itself_and_a_reference_joins_them() -> None:
    rng = np.random.default_rng(5)
    for width, kind in ((1, "square"), (3, "hexagonal"), (6, "square")):
        cells, places = random_view(rng, kind == "hexagonal").marks((20, 15))
        reference = ControlPoints(cells, places, np.full(len(cells), 0.05))
        start = int(rng.integers(-6, 2))
        there = (cells[:, 0] < start) | (cells[:, 0] >= start + width)
        seen, at = cells[there], places[there] + rng.normal(0, 0.05, (there.sum(), 2))
        grown = grow_lattices(at, kind)
        for lattice in grown:
            assert wrong(lattice.cells, seen[lattice.marks]) == 0
        named, marks = named_as(reference, grown, at, kind)
        assert (named == seen[marks]).all()
        assert len(named) > 0.85 * len(seen)


def test_marks_that_lie_anywhere_form_no_lattice() -> None:
    rng = np.random.default_rng(6)
    for _ in range(3):
        grown = grow_lattices(rng.uniform(0, 400, (200, 2)))
        assert sum(len(lattice.cells) for lattice in grown) < 60


def test_a_step_by_whole_cells_is_not_told_from_none_and_one_by_half_has_no_name() -> None:
    cells, places = View(barrel=0.0).marks((12, 10))
    reference = ControlPoints(cells, places, np.zeros(len(cells)))
    for step in (0.2, 2.2):
        moved = places + np.array([24 * step, 0])
        named, marks = named_as(reference, grow_lattices(moved), moved)
        assert (named - cells[marks] == [round(step), 0]).all()
    moved = places + np.array([12.0, 12.0])
    assert not len(named_as(reference, grow_lattices(moved), moved, max_move=0.5)[0])


def test_the_tactip_s_pins_are_marks_of_the_same_kind() -> None:
    frame = next(iter(record_press(tactip(127), "specimen=1.571", seed=0).frames()))
    pins = find_pins(frame).xy_px
    kept = np.random.default_rng(7).permutation(len(pins))[20:]
    grown = grow_lattices(pins[kept], "hexagonal")
    largest = grown[0]
    assert len(largest.cells) > 0.5 * len(kept)
    # Neighbours of the lattice are neighbours in the image: one pitch apart, none far.
    at = pins[kept][largest.marks]
    tree = cKDTree(largest.cells)
    for i, j in tree.query_pairs(1.01):
        assert np.hypot(*(at[i] - at[j])) < 1.6 * largest.pitch


def test_another_kind_of_lattice_is_refused() -> None:
    with pytest.raises(RangeError, match="hexagonal"):
        grow_lattices(np.zeros((20, 2)), "triangular")
