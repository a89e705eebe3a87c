"""A table reads back to the last bit, from text that other programs read too, or is refused by name."""

from __future__ import annotations

import gzip
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike
from tests.refusals import refused

from palpate.core import InputError, MissingExtraError
from palpate.recordings import label_tables, read_labels
from palpate.recordings.label_tables import read_table, write_table

TEXTS = ["007", "7", "true", "", "a,b", 'say "so"', "two\nlines", "old\r\nends", "nan", "µm ∂", "'", "1e3"]


def bits(values: ArrayLike) -> list[int]:
    return np.asarray(values, np.float64).view(np.int64).tolist()


def through_file(table: pd.DataFrame, folder: Path) -> pd.DataFrame:
    write_table(table, folder / "table.csv.gz")
    return read_table(folder / "table.csv.gz")


def test_every_float_reads_back_bit_for_bit(tmp_path: Path, rng: np.random.Generator) -> None:
    drawn = rng.integers(0, 2**64, 2_000, dtype=np.uint64).view(np.float64)  # every exponent, both signs
    drawn = drawn[~np.isnan(drawn)]
    edge = [0.0, -0.0, 0.1, 1 / 3, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, np.inf, -np.inf]
    values = np.concatenate([edge, drawn, [np.nan]])
    read = through_file(pd.DataFrame({"x_mm": values}), tmp_path)["x_mm"]
    assert bits(read) == bits(values)


def test_kinds_and_gaps_read_back_as_they_were(tmp_path: Path) -> None:
    count = len(TEXTS)
    table = pd.DataFrame(
        {
            "text": pd.Series(TEXTS, dtype=str),
            "flag": [True, False] * (count // 2),
            "row": np.arange(count) - 3,
            "whole_mm": np.arange(float(count)),
            "gap_mm": [np.nan, 1.5] * (count // 2),
            "flag, or not": pd.Series([True, None] * (count // 2), dtype=object),
            "never": pd.Series([None] * count, dtype=object),
            'a "name"': pd.Series(["", None] * (count // 2), dtype=str),
        }
    )
    pd.testing.assert_frame_equal(through_file(table, tmp_path), table)


def test_the_same_table_gives_the_same_bytes(tmp_path: Path, rng: np.random.Generator) -> None:
    table = pd.DataFrame({"x_mm": rng.standard_normal(100), "press": ["a"] * 100})
    for name in ("one.csv.gz", "another.csv.gz"):
        write_table(table, tmp_path / name)
    assert (tmp_path / "one.csv.gz").read_bytes() == (tmp_path / "another.csv.gz").read_bytes()


def test_a_cell_of_another_kind_is_refused(tmp_path: Path) -> None:
    with refused("cell-kind", InputError):
        write_table(pd.DataFrame({"when": pd.to_datetime(["2026-01-01"])}), tmp_path / "table.csv.gz")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('"a","b"\n1.0,2.0\n3.0\n', "2 cells of the header"),
        ('"a"\n"never ends\n', "damaged at character 4"),
        ('"a"\n1.0', "damaged at character 4"),
        ('"a"\nblue\n', "could not convert"),
        ("", "damaged at character 0"),
    ],
)
def test_a_damaged_table_is_refused_by_name(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "table.csv.gz"
    path.write_bytes(gzip.compress(text.encode()))
    with refused("table-unreadable", InputError):
        read_table(path)


@pytest.mark.parametrize("cut", [0, 12, -4])
def test_a_file_that_is_cut_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "table.csv.gz"
    write_table(pd.DataFrame({"x_mm": np.arange(9.0)}), path)
    path.write_bytes(path.read_bytes()[:cut])
    with refused("table-unreadable", InputError, match=r"table\.csv"):
        read_table(path)


def test_a_file_that_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "table.csv.gz"
    write_table(pd.DataFrame({"x_mm": np.zeros(1000)}), path)
    monkeypatch.setattr(label_tables, "MAX_TABLE_BYTES", 1000)
    with refused("table-unreadable", InputError, match="1000"):
        read_table(path)


@pytest.mark.parametrize("read", [read_table, read_labels])
def test_parquet_without_pyarrow_says_what_to_install(tmp_path: Path, monkeypatch, read) -> None:
    path = tmp_path / "labels.parquet"
    path.write_bytes(b"PAR1 and so on")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    needed = r"labels\.parquet.*pip install 'palpate\[parquet\]'"
    with pytest.raises(MissingExtraError, match=needed) as caught:
        read(path)
    assert "\n" not in str(caught.value)
