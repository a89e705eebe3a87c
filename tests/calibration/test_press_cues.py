"""Cues of a press and tests between specimens: a value a trial, and what cannot be told left out."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from palpate.calibration.compliance.press_cues import cues_of
from palpate.calibration.compliance.reference_stiffness import series_line
from palpate.calibration.compliance.specimen_comparison import cue_tests
from palpate.recordings.exchange.press_table import PressTable
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import VirtualPress, record_press


def press_table_of(trial: VirtualPress) -> PressTable:
    return PressTable(
        trial.time_s, trial.raw_n, trial.position_m, trial.true_area_m2, trial.frame_sample,
        "force_raw_N", "actual_mm", "true_area_mm2", False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def cues():
    made = record_press(tactip(), "S1=7.6", seed=3)
    return cues_of(list(made.frames()), press_table_of(made))


def test_cues_without_a_calibration_are_relative_ones(cues) -> None:
    row = cues.row(None)
    assert set(row) == {
        "series_stiffness_N_per_mm", "series_adjusted_r2", "accumulated_divergence", "frames",
        "divergence_regression_per_N", "divergence_secant_per_N", "divergence_paper_per_N",
    }  # fmt: skip
    assert np.isfinite(list(row.values())).all()
    assert (cues.late.force_n >= 2.5).all()
    assert cues.trial.area_m2.shape == cues.trial.press.force_n.shape


def test_force_over_position_is_the_stiffness_of_all_that_yields(rng) -> None:
    depth = np.linspace(-1e-3, 3e-3, 400)
    force = 2e3 * np.maximum(depth, 0)
    table = PressTable(
        np.arange(400) / 200, force, depth + 0.7, None, np.arange(400), "force_N", "position_mm", None, False
    )
    line = series_line(table)
    assert_allclose(line.slope, 2e3, rtol=1e-3)
    assert line.adjusted_r2 > 0.999


def test_p_values_are_corrected_for_all_cues_and_for_all_their_pairs(rng) -> None:
    """Three cues: Holm's factors are 3, 2, 1 for the cues, and 9 for the least of their nine pairs."""
    names = np.repeat(["a", "b", "c"], 6)
    table = pd.DataFrame({"specimen": names, "trial": np.tile(range(6), 3)})
    for cue, apart in (("far", 9.0), ("near", 1.0), ("alike", 0.0)):
        table[cue] = rng.standard_normal(18) + apart * np.repeat([0, 1, 2], 6)
    found = cue_tests(table)
    plain = [one["kruskal_p"] for one in found.values()]
    assert plain == sorted(plain)
    assert_allclose(found["far"]["kruskal_p_all_cues"], 3 * plain[0])
    assert_allclose(found["near"]["kruskal_p_all_cues"], max(3 * plain[0], min(1, 2 * plain[1])))
    least = min((pair for one in found.values() for pair in one["pairs"]), key=lambda p: p["rank_sum_p"])
    assert_allclose(least["rank_sum_p_all_cues"], 9 * least["rank_sum_p"])
