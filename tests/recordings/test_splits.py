"""Folds part the rows, and no group stands on both sides of a fold."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from tests.refusals import refused

from palpate.core import SplitError
from palpate.recordings.splits import Split, split


def assert_parts_all_rows(parted: Split, rows: int) -> None:
    assert sorted(np.concatenate(parted.folds).tolist()) == list(range(rows))
    for k, fold in enumerate(parted.folds):
        assert fold.size
        assert sorted([*fold, *parted.training_rows(k)]) == list(range(rows))


@settings(max_examples=30)
@given(
    presses=st.lists(st.integers(0, 12), min_size=30, max_size=80),
    folds=st.integers(2, 4),
    seed=st.integers(0, 9),
)
def test_group_folds_part_the_rows_and_share_no_group(presses, folds, seed):
    table = pd.DataFrame({"press": [*presses, 20, 21, 22, 23]})
    parted = split(table, "group:press", folds=folds, seed=seed)
    assert_parts_all_rows(parted, len(table))
    assert len(parted.folds) == folds
    for k, fold in enumerate(parted.folds):
        assert not set(parted.groups[fold]) & set(parted.groups[parted.training_rows(k)])


def test_random_folds_part_the_rows_evenly_and_by_seed():
    table = pd.DataFrame({"depth_mm": np.arange(23.0)})
    parted = split(table, "random", folds=5, seed=3)
    assert_parts_all_rows(parted, 23)
    assert {len(fold) for fold in parted.folds} == {4, 5}
    again, other = split(table, "random", folds=5, seed=3), split(table, "random", folds=5, seed=4)
    assert all(np.array_equal(a, b) for a, b in zip(parted.folds, again.folds, strict=True))
    assert any(not np.array_equal(a, b) for a, b in zip(parted.folds, other.folds, strict=True))


def test_group_folds_are_balanced_in_rows_as_far_as_the_groups_allow():
    table = pd.DataFrame({"press": np.repeat(np.arange(10), [40, 5, 5, 5, 5, 5, 5, 5, 5, 20])})
    sizes = sorted(len(fold) for fold in split(table, "group:press", folds=3).folds)
    assert sizes == [30, 30, 40]  # the group of 40 fills a fold; the rest part evenly


def test_leave_one_out_holds_out_each_group_once():
    table = pd.DataFrame({"mass_g": [0.0, 0.0, 135.5, 584.0, 584.0], "contact": [True] * 5})
    parted = split(table, "leave-one-out:mass_g")
    assert [fold.tolist() for fold in parted.folds] == [[0, 1], [2], [3, 4]]
    assert parted.groups.tolist() == ["0", "0", "135.5", "584", "584"]


@pytest.mark.parametrize(
    ("columns", "kind"),
    [
        ({"press": [1, 1, 2, 2], "location": ["a", "a", "b", "b"]}, "group:location"),
        ({"x_mm": [0, 0, 1, 1], "y_mm": [0, 0, 0, 0], "cycle": [1, 2, 1, 2]}, "group:x_mm,y_mm"),
        ({"x_mm": [0, 0, 1, 1], "press": [1, 1, 2, 2]}, "group:press"),
        ({"row": [0, 0, 1, 1], "col": [0, 1, 0, 1]}, "group:row,col"),
        ({"object": ["ball"] * 4, "trial": [1, 1, 2, 2]}, "group:trial"),
        ({"depth_mm": [1, 2, 3, 4]}, "random"),
    ],
)
def test_the_coarsest_group_that_can_be_held_out_is_chosen_and_said(columns, kind):
    parted = split(pd.DataFrame(columns), "auto", folds=2)
    assert parted.kind == kind
    assert all(name in parted.reason for name in parted.group_columns)
    assert "no column" in parted.reason or parted.group_columns


@pytest.mark.parametrize(
    ("spec", "folds", "words"),
    [
        ("group:pres", 5, ("'pres'", "press, depth_mm")),
        ("group:press", 5, ("2 groups", "5 folds", "leave-one-out:press", "at most 2")),
        ("group:one", 2, ("one group", "another column")),
        ("leave-one-out:one", 2, ("one group",)),
        ("leave-one-out:gap", 2, ("'gap'", "row 3", "fill")),
        ("group:blank", 2, ("'blank'", "row 2")),
        ("random", 1, ("at least 2",)),
        ("random", 9, ("fewer rows than folds",)),
        ("by-hand", 2, ("'by-hand'", "'random'", "group:COLUMN")),
        ("group:", 2, ("group:COLUMN",)),
    ],
)
def test_a_split_that_the_table_cannot_carry_is_refused_with_a_remedy(spec, folds, words):
    table = pd.DataFrame(
        {
            "press": ["a", "a", "b", "b"],
            "depth_mm": [1.0, 2.0, 3.0, 4.0],
            "one": ["x"] * 4,
            "gap": [1.0, np.nan, 2.0, 3.0],
            "blank": ["", "u", "v", "w"],
        }
    )
    with pytest.raises(SplitError) as caught:
        split(table, spec, folds=folds)
    for word in words:
        assert word in str(caught.value)


def test_blocks_are_consecutive_and_reach_over_the_whole_order_in_each_fold() -> None:
    table = pd.DataFrame({"x_mm": np.arange(403.0)})
    found = split(table, "blocks:10", folds=5)
    assert found.kind == "blocks:10"
    assert sorted(np.concatenate(found.folds).tolist()) == list(range(403))
    for fold in found.folds:
        sizes = np.diff(np.flatnonzero(np.append(np.append(True, np.diff(fold) > 1), True)))
        assert set(sizes.tolist()) <= {10, 20, 3, 13}  # two of one fold may follow each other; three are left
        assert (np.diff(np.append(np.append(0, fold), 403)) <= 91).all()  # in each round of five, one
    assert len(np.unique(found.groups)) == 41
    again = split(table, "blocks:10", folds=5)
    assert all(map(np.array_equal, found.folds, again.folds))


def test_a_block_ends_with_its_session() -> None:
    table = pd.DataFrame({"session": ["a"] * 7 + ["b"] * 8})
    found = split(table, "blocks:5", folds=2)
    lengths = [int((found.groups == name).sum()) for name in dict.fromkeys(found.groups)]
    assert lengths == [5, 2, 5, 3]


@pytest.mark.parametrize("spec", ["blocks:0", "blocks:", "blocks:2.5", "blocks:-3", "block", "session:a"])
def test_blocks_of_no_length_are_refused(spec) -> None:
    with pytest.raises(SplitError):
        split(pd.DataFrame({"x_mm": np.arange(20.0)}), spec, folds=2)


def test_too_few_blocks_are_refused_with_the_remedy() -> None:
    with refused("too-few-blocks", SplitError):
        split(pd.DataFrame({"x_mm": np.arange(20.0)}), "blocks:10", folds=5)


def test_sessions_are_the_coarsest_group_and_presses_count_within_them() -> None:
    table = pd.DataFrame({"session": [1, 1, 1, 2, 2, 2], "object": ["a", "b"] * 3, "press": [1, 2, 3] * 2})
    assert split(table, "auto", folds=2).group_columns == ("session",)
    by_press = split(table, "leave-one-out:press")
    assert (by_press.kind, by_press.group_columns) == ("leave-one-out:press", ("session", "press"))
    assert len(by_press.folds) == 6
    held = split(table, "session")
    assert [fold.tolist() for fold in held.folds] == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("table", [{"x_mm": [1.0, 2.0]}, {"session": ["a", "a"]}])
def test_a_split_by_session_needs_two(table) -> None:
    with refused("one-session", SplitError):
        split(pd.DataFrame(table), "session")
