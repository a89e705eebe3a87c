"""Stiffness by a rigid plate: the slope comes back, a curve is flagged, and bad tables are named."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from palpate.calibration.compliance import plate_stiffness
from palpate.calibration.compliance.press_nuisances import NONE
from palpate.core.errors import InputError, LabelError


def written(folder, name: str, force_of, **more):
    """A trial at 5 mm/s and 200 Hz, its force in steps of 1/16 N with noise."""
    rng = np.random.default_rng(len(name))
    time = np.arange(700) / 200
    depth_mm = -1 + 5 * time
    force = force_of(np.maximum(depth_mm, 0.0)) + 0.02 * rng.standard_normal(len(time))
    table = pd.DataFrame(
        {"time_s": time, "force_raw_N": np.rint(force * 16) / 16, "actual_mm": depth_mm} | more
    )
    path = folder / f"{name}.csv"
    table[: int(np.searchsorted(force, 5.5)) + 1 or None].to_csv(path, index=False)
    return path


@pytest.mark.parametrize("kappa", [7.6, 3.1, 1.1])
@pytest.mark.cases(1)
def test_the_slope_of_force_over_deformation_is_the_stiffness(tmp_path, kappa) -> None:
    tables = [written(tmp_path, f"trial{'x' * k}", lambda d: kappa * d) for k in range(3)]
    found = plate_stiffness(tables)
    assert found["stiffness_N_per_mm"] == pytest.approx(kappa, rel=0.02)  # steps of 1/16 N over 24 samples
    assert found["low_N_per_mm"] <= found["stiffness_N_per_mm"] <= found["high_N_per_mm"]
    assert all(one["adjusted_r2"] > 0.99 for one in found["trials"])
    assert not found["flags"]


def test_the_interval_contains_what_all_trials_share(tmp_path) -> None:
    """Gain of 3 %, and a frame of 4 um/N under 3 N/mm, 1.2 %: together 3.23 % of the stiffness."""
    tables = [written(tmp_path, f"trial{'x' * k}", lambda d: 3.0 * d) for k in range(4)]
    none = plate_stiffness(tables, nuisances=NONE)
    both = plate_stiffness(tables, nuisances=replace(NONE, force_gain=0.03, frame_yield_m_n=4e-6))
    k = none["stiffness_N_per_mm"]
    assert both["stiffness_N_per_mm"] == k
    wide = (both["high_N_per_mm"] - both["low_N_per_mm"]) / 2
    assert wide == pytest.approx(1.96 * k * np.hypot(0.03, 0.004 * k), rel=0.01)
    assert none["high_N_per_mm"] - none["low_N_per_mm"] < wide / 2
    assert both["contained"] == {"force_gain": 0.03, "frame_yield_mm_per_N": pytest.approx(0.004)}


def test_a_force_that_is_no_line_is_flagged(tmp_path) -> None:
    jumps = written(tmp_path, "jumps", lambda d: 0.6 * (d > 0.1) + 4.5 * (d > 4) + 0.01 * d)
    assert "no line" in plate_stiffness([jumps])["flags"][0]


def test_what_is_no_press_of_a_plate_is_refused_in_words(tmp_path) -> None:
    with pytest.raises(InputError, match="no table"):
        plate_stiffness([])
    path = written(tmp_path, "short", lambda d: 3 * d)
    pd.read_csv(path).drop(columns="actual_mm").to_csv(tmp_path / "none.csv", index=False)
    with pytest.raises(LabelError, match="no column of position"):
        plate_stiffness([tmp_path / "none.csv"])
    turned = pd.read_csv(path).assign(actual_mm=lambda t: -t["actual_mm"])
    turned.to_csv(tmp_path / "turned.csv", index=False)
    with pytest.raises(InputError, match="turn the position's sign"):
        plate_stiffness([tmp_path / "turned.csv"])
