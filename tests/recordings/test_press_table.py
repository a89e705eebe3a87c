"""The table of a press: its quantities by their units, its rows beside the frames."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.refusals import refused

from palpate.core.errors import LabelError
from palpate.recordings.exchange.press_table import press_rows, read_press_table


def written(tmp_path, columns, name="force.csv"):
    pd.DataFrame(columns).to_csv(tmp_path / name, index=False)
    return tmp_path / name


def fast(frames=6, every=10) -> dict[str, np.ndarray]:
    """As the report records: 200 Hz, and the number of the latest of 20 frames a second."""
    n = frames * every
    return {
        "time_s": np.arange(n) / 200,
        "force_raw_N": np.linspace(0, 5, n),
        "force_N": np.linspace(0, 5, n) * 0.99,
        "desired_mm": np.arange(n) * 0.025,
        "actual_mm": np.arange(n) * 0.025 + 0.01,
        "frame": np.arange(n) // every,
    }


def test_a_frame_belongs_to_the_first_sample_that_names_it(tmp_path) -> None:
    found = read_press_table(written(tmp_path, fast()), 6)
    assert_array_equal(found.frame_sample, np.arange(6) * 10)
    assert found.force_column == "force_raw_N"
    assert_allclose(found.position_m[1] - found.position_m[0], 25e-6)
    assert_allclose(found.time_s[-1], 59 / 200)


@pytest.mark.parametrize("frame_sample", [[], [1, 3], [0, 3, 3], [0, 8]])
def test_frames_without_a_sample_of_their_own_are_not_written(frame_sample) -> None:
    time = np.arange(8) / 200
    with refused("frame-order", LabelError):
        press_rows(time, time, time, time, np.array(frame_sample, int))


def test_a_row_a_frame_needs_no_numbers_of_frames(tmp_path) -> None:
    table = {"Fz_N": np.linspace(0, -3, 8)}
    found = read_press_table(written(tmp_path, table), 8, rate_hz=20.0)
    assert_array_equal(found.frame_sample, np.arange(8))
    assert found.turned
    assert_allclose(found.force_n[-1], 3)
    assert found.position_m is None


@pytest.mark.parametrize(
    ("change", "frames", "said"),
    [
        ({}, 7, "frame-count"),
        ({}, 5, "frame-count"),
        ({"frame": np.array([0] * 30 + [5] * 30)}, 6, "frame-count"),
        ({"frame": np.array([0] * 30 + [1] * 29 + [0])}, 2, "frame-numbers"),
        ({"time_s": np.zeros(60)}, 6, "time-order"),
        ({"force_raw_N": np.where(np.arange(60) == 3, np.nan, 1.0)}, 6, "not-finite"),
        ({"force_raw_N": np.array(["x"] * 60)}, 6, "not-finite"),
    ],
)
def test_a_table_that_does_not_fit_says_where(tmp_path, change, frames, said) -> None:
    with refused(said, LabelError):
        read_press_table(written(tmp_path, fast() | change), frames)


def test_a_table_without_force_rate_or_unit_says_what_is_missing(tmp_path) -> None:
    with refused("force-missing", LabelError):
        read_press_table(written(tmp_path, {"load": np.ones(4)}), 4, rate_hz=20.0)
    with refused("force-unit", LabelError):
        read_press_table(
            written(tmp_path, {"load": np.ones(4)}, "b.csv"), 4, rate_hz=20.0, force_column="load"
        )
    with refused("time-missing", LabelError):
        read_press_table(written(tmp_path, {"force_N": np.ones(4)}, "c.csv"), 4)
    with refused("row-count", LabelError):
        read_press_table(written(tmp_path, {"force_N": np.ones(4)}, "d.csv"), 5, rate_hz=20.0)


def test_an_area_is_read_where_there_is_one_and_truth_comes_first(tmp_path) -> None:
    areas = np.where(np.arange(60) < 9, np.nan, 2.5)
    found = read_press_table(written(tmp_path, fast() | {"area_mm2": areas}), 6)
    assert_allclose(found.area_m2, areas * 1e-6)
    assert found.area_column == "area_mm2"
    both = fast() | {"area_mm2": areas, "true_area_mm2": np.full(60, 3.0)}
    found = read_press_table(written(tmp_path, both, "b.csv"), 6)
    assert_allclose(found.area_m2, 3e-6)
    assert read_press_table(written(tmp_path, fast(), "c.csv"), 6).area_m2 is None


@pytest.mark.parametrize("wrong", [-1.0, np.inf, "wide"])
def test_what_is_no_area_says_where(tmp_path, wrong) -> None:
    areas = [1.0] * 59 + [wrong]
    with refused("area", LabelError):
        read_press_table(written(tmp_path, fast() | {"area_mm2": areas}), 6)
