"""A table of labels is read as it stands, or refused with its file, its row and a remedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.refusals import refused

from palpate.core import InputError, LabelError, UnitError
from palpate.recordings.label_tables import finite, label_kinds, label_values, read_labels, targets_from

NO_PYARROW = "needs pyarrow, which reads Parquet"


def csv_file(folder: Path, text: str | bytes) -> Path:
    path = folder / "labels.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def rejects(path: Path, *words: str) -> None:
    with pytest.raises(LabelError) as caught:
        read_labels(path)
    for word in (str(path), *words):
        assert word in str(caught.value)


def test_numbers_texts_and_flags_are_told_apart(tmp_path):
    table = read_labels(
        csv_file(tmp_path, "file,depth_mm,contact,n\na.png,1.5,true,\nb.png,-2e-3,False,+7\n")
    )
    assert label_kinds(table) == {"file": "text", "depth_mm": "number", "contact": "flag", "n": "number"}
    assert table["depth_mm"].tolist() == [1.5, -2e-3]
    assert table["contact"].tolist() == [True, False]
    assert np.isnan(table["n"][0])


def test_a_spreadsheets_marks_and_line_ends_change_nothing(tmp_path):
    plain = read_labels(csv_file(tmp_path, "file,depth_mm\na.png,1\n"))
    marked = read_labels(csv_file(tmp_path, "\ufefffile, depth_mm\r\na.png,1\r\n\r\n"))
    pd.testing.assert_frame_equal(plain, marked)


def test_parquet_holds_the_same_as_csv_whatever_its_name(tmp_path):
    pytest.importorskip("pyarrow", reason=NO_PYARROW)
    table = read_labels(csv_file(tmp_path, "file,depth_mm,contact\na.png,1.5,true\nb.png,2,false\n"))
    path = tmp_path / "labels.table"
    table.to_parquet(path)
    pd.testing.assert_frame_equal(read_labels(path), table)


def test_a_kind_that_is_given_is_not_guessed(tmp_path):
    table = read_labels(csv_file(tmp_path, "batch\n007\n"), kinds={"batch": "text"})
    assert table["batch"].tolist() == ["007"]


def test_a_given_kind_that_does_not_fit_is_refused(tmp_path):
    with pytest.raises(LabelError, match="kind"):
        read_labels(csv_file(tmp_path, "batch\nblue\n"), kinds={"batch": "flag"})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ("empty",)),
        ("file,depth_mm\n", ("no rows",)),
        ("file,depth_mm,depth_mm\na,1,2\n", ("row 1", "'depth_mm'", "more than once", "rename")),
        ("file,\na,1\n", ("row 1", "column 2", "no name")),
        ("file;depth_mm\na;1;2\n", ("row 2", "3 cells", "the header has 2")),
        ("file,depth_mm\na,1\nb,2,3\n", ("row 3", "3 cells", "the header has 2")),
        ("file,depth_mm\na,1\n\nb,2\n", ("row 3", "0 cells")),
        ('file,depth_mm\na,1\n"b,2\n', ("row 3", "quotes")),
        (b"file,depth_mm\na,1\n\xe9.png,2\n", ("row 3", "UTF-8")),
        ("file,note\na,fine\nb,=1+1\n", ("row 3", "'note'", "formula", "write the value")),
        ("file,note\na,+cmd|' /C calc'!A0\n", ("row 2", "formula")),
        ("file,note\na,-2+3\n", ("row 2", "formula")),
        ("file,note\n@SUM(A1),1\n", ("row 2", "'file'", "formula")),
        ("file,=depth\na,1\n", ("row 1", "formula")),
    ],
)
def test_a_damaged_table_is_refused_by_file_and_row(tmp_path, text, words):
    rejects(csv_file(tmp_path, text), *words)


def test_a_missing_table_is_named(tmp_path):
    rejects(tmp_path / "gone.csv", "not there")


def test_a_damaged_parquet_is_named(tmp_path):
    pytest.importorskip("pyarrow", reason=NO_PYARROW)
    rejects(csv_file(tmp_path, b"PAR1 and then nothing"), "Parquet")


def test_parquet_columns_that_are_no_labels_are_refused(tmp_path):
    pytest.importorskip("pyarrow", reason=NO_PYARROW)
    path = tmp_path / "labels.parquet"
    pd.DataFrame({"when": pd.to_datetime(["2026-01-01"])}).to_parquet(path)
    rejects(path, "'when'", "timestamp")


def test_targets_come_in_the_order_asked_and_in_the_units_of_their_names(tmp_path):
    table = read_labels(csv_file(tmp_path, "file,depth_mm,force_N\na,1,10\nb,2,20\n"))
    assert targets_from(table, ["force_N", "depth_mm"], "labels.csv").tolist() == [[10, 1], [20, 2]]


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ("shear_mm", ("no column 'shear_mm'", "depth_mm")),
        ("material_mm", ("text", "'soft'", "row 2")),
        ("gap_mm", ("'gap_mm'", "row 3", "remove the rows")),
        ("flat_mm", ("2 everywhere", "nothing to learn")),
    ],
)
def test_a_column_that_cannot_be_learnt_is_refused(column, words):
    table = pd.DataFrame(
        {
            "depth_mm": [1.0, 2.0],
            "material_mm": ["soft", "hard"],
            "gap_mm": [1.0, np.inf],
            "flat_mm": [2.0, 2.0],
        }
    )
    with pytest.raises(LabelError) as caught:
        targets_from(table, [column], "my-run")
    for word in ("my-run", *words):
        assert word in str(caught.value)


def test_every_row_without_a_number_is_counted_and_the_first_are_named():
    table = pd.DataFrame({"depth_mm": [1.0, 2.0] + [np.nan] * 8})
    with refused("not-finite", LabelError):
        targets_from(table, ["depth_mm"], "my-run")


def test_a_target_without_a_unit_is_refused_with_an_example():
    with pytest.raises(UnitError, match="depth_mm"):
        targets_from(pd.DataFrame({"depth": [1.0, 2.0]}), ["depth"], "my-run")


@pytest.mark.parametrize("columns", [[], ["depth_mm", "depth_mm"]])
def test_targets_are_at_least_one_and_each_once(columns):
    with pytest.raises(LabelError, match="once"):
        targets_from(pd.DataFrame({"depth_mm": [1.0, 2.0]}), columns, "my-run")


@pytest.mark.parametrize(
    ("values", "count"),
    [(np.array(["a"]), 1), ([], 1), ([1.0], 2), ([np.nan], 1), ([np.inf], 1), (np.array([[1.0]]), 1)],
)
def test_what_is_not_so_many_finite_numbers_is_refused(values, count):
    with refused("finite-numbers", InputError, match=str(count)):
        finite(values, count, "a wrench")


KINDS = {"contact": "flag", "press": "text", "depth_mm": "number"}


@pytest.mark.parametrize("flag", [True, False, np.True_, np.False_])
@pytest.mark.parametrize("number", [1.5, 2, np.float32(0.5), np.int64(3)])
def test_labels_of_their_column_s_kind_come_as_plain_values(flag, number):
    found = label_values({"contact": flag, "press": "p1", "depth_mm": number}, KINDS)
    assert found == {"contact": bool(flag), "press": "p1", "depth_mm": float(number)}
    assert [type(value) for value in found.values()] == [bool, str, float]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("contact", 1),
        ("contact", "true"),
        ("press", 3.0),
        ("depth_mm", True),
        ("depth_mm", np.True_),
        ("depth_mm", "1.5"),
        ("depth_mm", np.nan),
    ],
)
def test_a_label_of_another_kind_than_its_column_is_refused(name, value):
    with refused("label-kind", LabelError, match=str(name)):
        label_values({name: value}, KINDS)
