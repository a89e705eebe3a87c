"""Shuffled folds beside blocks: what a label that follows the order makes of either."""

import numpy as np
import pandas as pd
import pytest

from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.coverage.conformal import fit_intervals
from palpate.calibration.sessions.order_check import (
    ScoredSplit,
    label_gap,
    order_card,
    split_beside,
    told_by_order,
)
from palpate.core import ManualClock
from palpate.estimators import read_card
from palpate.recordings import Manifest, Run, RunWriter, Split, split

pytestmark = pytest.mark.usefixtures("changes_untried")

N = 200


def recorded(out, values: np.ndarray, rng: np.random.Generator) -> Run:
    """Frames that show nothing but how late it is: a background that drifts, without a touch."""
    labels = {"depth_mm": "number"}
    clock = ManualClock()
    with RunWriter.create(
        out, Manifest.new(sensor="s", labels=labels), clock=clock, overflow="wait"
    ) as writer:
        for i, value in enumerate(values):
            clock.sleep(0.1)
            late = 60 + 100 * i / len(values) + rng.normal(0, 1, (16, 20))
            writer.frame(late.astype(np.uint8), labels={"depth_mm": float(value)})
    return Run.open(out)


PLAN = CalibrationPlan(("depth_mm",), size_px=(8, 10))


def test_a_sorted_label_makes_shuffled_folds_meaningless_and_the_card_says_so(tmp_path, rng) -> None:
    calibrate(recorded(tmp_path / "run", np.linspace(0, 5, N), rng), PLAN, tmp_path / "cal")
    order = read_card(tmp_path / "cal").order
    shuffled, blocks = order.splits
    assert (shuffled.kind, blocks.kind) == ("random", "blocks")
    assert shuffled.meaningless == ("depth_mm",)
    assert blocks.meaningless == ("depth_mm",)
    assert shuffled.r2["depth_mm"] > 0.9  # a certificate of the clock
    assert order.rank_correlation["depth_mm"] == pytest.approx(1)
    assert "shuffled folds are meaningless" in order.text
    assert "Of depth_mm blocks are meaningless, too" in order.text
    assert "only another session does" in order.text
    assert "Read the blocks" not in order.text


def test_a_shuffled_label_leaves_both_comparable(tmp_path, rng) -> None:
    calibrate(recorded(tmp_path / "run", rng.uniform(0, 5, N), rng), PLAN, tmp_path / "cal")
    order = read_card(tmp_path / "cal").order
    assert all(not one.meaningless for one in order.splits)
    assert all(one.r2["depth_mm"] < 0.2 for one in order.splits)
    assert order.splits[1].rows == N


@pytest.mark.slow
def test_long_blocks_of_a_sorted_label_are_the_meaningless_ones(tmp_path, rng) -> None:
    plan = CalibrationPlan(("depth_mm",), size_px=(8, 10), split="blocks:40")
    calibrate(recorded(tmp_path / "run", np.linspace(0, 5, N), rng), plan, tmp_path / "cal")
    order = read_card(tmp_path / "cal").order
    long = order.splits[0]
    assert long.kind == "blocks:40"
    assert long.meaningless == ("depth_mm",)
    assert "measure extrapolation alone" in order.text
    # The very rows, shuffled in time, are as good by long blocks as by others.
    mixed = recorded(tmp_path / "mixed", rng.permutation(np.linspace(0, 5, N)), rng)
    calibrate(mixed, plan, tmp_path / "cal-mixed")
    assert not read_card(tmp_path / "cal-mixed").order.splits[0].meaningless


def test_what_is_costly_to_train_leaves_the_other_split_out_and_says_so(tmp_path, rng) -> None:
    run = recorded(tmp_path / "run", np.linspace(0, 5, N), rng)
    calibrate(run, CalibrationPlan(("depth_mm",), size_px=(8, 10), scored_folds=1), tmp_path / "cal")
    order = read_card(tmp_path / "cal").order
    assert len(order.splits) == 1
    assert "Blocks of the order in which rows were taken were left out" in order.text


@pytest.mark.parametrize("kind", ["random", "blocks"])
def test_a_clock_passes_every_split_that_neighbours_pass_and_no_other(kind, rng) -> None:
    """A cubic in the row's number, without any picture: it reads a ramp by blocks as by shuffled folds.

    Of a label that comes and goes within a few blocks, and of noise, it reads nothing.
    """
    n, each = np.arange(400.0), {}
    for name, values in {"ramp": n, "noise": rng.normal(size=400)}.items():
        parts = split(pd.DataFrame({"x": values}), kind, folds=5, seed=0)
        held_out = np.empty((400, 1))
        for fold in parts.folds:
            rest = np.setdiff1d(np.arange(400), fold)
            held_out[fold, 0] = np.polyval(np.polyfit(n[rest] / 400, values[rest], 3), n[fold] / 400)
        intervals = fit_intervals(held_out, values[:, None], np.arange(400), 0.9)
        order = order_card([ScoredSplit(parts, held_out)], values[:, None], ["x"], intervals, "")
        each[name] = order.splits[0]
    assert each["ramp"].r2["x"] > 0.999
    assert each["ramp"].meaningless == ("x",)
    assert each["noise"].r2["x"] < 0.1
    assert each["noise"].meaningless == ()


def test_blocks_are_to_be_read_where_they_hide_what_neighbours_tell() -> None:
    """A label that comes and goes within a block: shuffled folds are passed by neighbours, blocks are not."""
    values = np.sin(2 * np.pi * np.arange(400) / 16)[:, None]
    table = pd.DataFrame({"x": values[:, 0]})
    blocks = Split("blocks:20", (), np.arange(400) // 20, tuple(np.arange(400).reshape(20, 20)), "")
    both = [ScoredSplit(parts, 0.9 * values) for parts in (split(table, "random", folds=5), blocks)]
    intervals = fit_intervals(0.9 * values, values, np.arange(400), 0.9)
    order = order_card(both, values, ["x"], intervals, "")
    assert [one.meaningless for one in order.splits] == [("x",), ()]
    assert "Read the blocks" in order.text


def test_what_is_sorted_is_not_sent_to_blocks_that_were_not_scored() -> None:
    values = np.arange(400.0)[:, None]
    alone = [ScoredSplit(split(pd.DataFrame({"x": values[:, 0]}), "random", folds=5), values + 1)]
    intervals = fit_intervals(values + 1, values, np.arange(400), 0.9)
    said = order_card(alone, values, ["x"], intervals, "").text
    assert "Blocks would not tell either" in said
    assert "Read the blocks" not in said


def test_the_neighbours_tell_a_ramp_and_not_noise(rng) -> None:
    folds = split(pd.DataFrame({"x": np.arange(500.0)}), "random", folds=5).folds
    assert told_by_order(np.arange(500.0), folds) > 0.999
    # Two neighbours' mean of white noise has half its variance: R2 is 1 - 1.5.
    assert told_by_order(rng.normal(size=500), folds) == pytest.approx(-0.55, abs=0.2)


def test_the_gap_of_a_ramp_is_a_quarter_of_a_block() -> None:
    values = np.arange(1000.0)
    blocks = [np.arange(k, k + 100) for k in range(0, 1000, 100)]
    # Distances to the nearer end of a block of 100 are 1 to 50; at both ends of the range, twice as far.
    assert label_gap(values, blocks) == pytest.approx(0.028, abs=0.004)


def test_rows_in_groups_need_no_other_split() -> None:
    table = pd.DataFrame({"press": np.repeat(np.arange(20), 5), "x": np.arange(100.0)})
    assert split_beside(table, split(table, "auto"), 5, 0) is None
    assert split_beside(table, split(table, "random"), 5, 0) is None
    alone = table[["x"]]
    assert split_beside(alone, split(alone, "auto"), 5, 0).kind == "blocks"
    assert split_beside(alone, split(alone, "blocks"), 5, 0).kind == "random"
