"""A run that is exported and imported again is the same run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from tests.refusals import refused

from palpate.core import LabelError, ManualClock, RecordingError
from palpate.recordings import Manifest, Run, RunWriter, export_folder, import_images

KINDS = {"depth_mm": "number", "batch": "text", "contact": "flag"}


def recorded(path: Path, rng: np.random.Generator, note: str = "007", colour: bool = True) -> Run:
    manifest = Manifest.new(sensor="s1", rig="bench", licence="CC0-1.0", origin="test", labels=KINDS, seed=4)
    with RunWriter.create(path, manifest, clock=ManualClock(), overflow="wait") as writer:
        for i in range(5):
            labels = {"depth_mm": float(rng.normal()), "batch": note, "contact": bool(i % 2)}
            image = rng.integers(0, 256, (12, 16, 3) if colour else (12, 16), dtype=np.uint8)
            writer.frame(image, time_ns=i * 33_333_333, labels=labels)
        writer.force([0, 0, 1.5, 0, 0, 0], time_ns=7)
    return Run.open(path)


def back(folder: Path, run: Path) -> Run:
    import_images(folder, run, labels=Path("labels.csv"), image_column="frame_file")
    return Run.open(run)


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("note", ["007", "true", "1e3", 'with "quotes", commas\r\nand lines', "größer"])
def test_export_and_import_change_nothing(tmp_path, rng, note, colour):
    run = recorded(tmp_path / "run", rng, note, colour)
    assert export_folder(run, tmp_path / "folder") == 5
    again = back(tmp_path / "folder", tmp_path / "again")
    pd.testing.assert_frame_equal(again.labels, run.labels)
    assert np.array_equal(again.times_s, run.times_s)
    for i in range(5):
        assert np.array_equal(again.frame(i).image, run.frame(i).image)
    for name in ("sensor", "rig", "licence", "origin", "seed", "clock", "labels", "units"):
        assert getattr(again.manifest, name) == getattr(run.manifest, name)


def test_other_tools_read_the_folder_without_palpate(tmp_path, rng):
    run = recorded(tmp_path / "run", rng)
    told: list[tuple[int, int]] = []
    export_folder(run, tmp_path / "folder", lambda done, total: told.append((done, total)))
    table = pd.read_csv(tmp_path / "folder" / "labels.csv")
    assert table.columns.tolist() == ["frame_file", "frame_time_s", *KINDS]
    first = np.asarray(Image.open(tmp_path / "folder" / table["frame_file"][0]))
    assert np.array_equal(first, run.frame(0).image)
    force = pd.read_csv(tmp_path / "folder" / "force.csv")
    assert force["fz_N"].tolist() == [1.5]
    assert not (tmp_path / "folder" / "stage.csv").exists()
    assert told[-1] == (5, 5)


def test_a_text_that_a_spreadsheet_would_run_is_not_exported(tmp_path, rng):
    run = recorded(tmp_path / "run", rng, "=HYPERLINK(1)")
    with refused("spreadsheet-formula", LabelError, match="'batch'"):
        export_folder(run, tmp_path / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_exported_manifest_that_is_damaged_is_named(tmp_path, rng):
    export_folder(recorded(tmp_path / "run", rng), tmp_path / "folder")
    (tmp_path / "folder" / "manifest.json").write_text('{"labels": NaN}')
    with pytest.raises(RecordingError, match=r"manifest\.json"):
        back(tmp_path / "folder", tmp_path / "again")
    assert not (tmp_path / "again").exists()
