"""A table of labels is read as it stands, or refused with its file, its row and a remedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from palpate.core import LabelError
from palpate.recordings.label_tables import label_kinds, read_labels, targets_from

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


def test_parquet_holds_the_same_as_csv_whatever_its_name(tmp_path):
    pytest.importorskip("pyarrow", reason=NO_PYARROW)
    table = read_labels(csv_file(tmp_path, "file,depth_mm,contact\na.png,1.5,true\nb.png,2,false\n"))
    path = tmp_path / "labels.table"
    table.to_parquet(path)
    pd.testing.assert_frame_equal(read_labels(path), table)


def test_a_kind_that_is_given_is_not_guessed(tmp_path):
    table = read_labels(csv_file(tmp_path, "batch\n007\n"), kinds={"batch": "text"})
    assert table["batch"].tolist() == ["007"]


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


def test_a_damaged_parquet_is_named(tmp_path):
    pytest.importorskip("pyarrow", reason=NO_PYARROW)
    rejects(csv_file(tmp_path, b"PAR1 and then nothing"), "Parquet")


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
