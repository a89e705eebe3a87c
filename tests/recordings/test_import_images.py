"""A folder of images becomes a whole run, or a clear error and nothing at all."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import ImageError, InputError, LabelError, PalpateError, UnitError
from palpate.recordings import ImportReport, Run, import_images


def folder_of(
    tmp_path: Path, rng: np.random.Generator, names: list[str], size: tuple[int, ...] = (12, 16)
) -> Path:
    folder = tmp_path / "touch"
    (folder / "images").mkdir(parents=True)
    for name in names:
        Image.fromarray(rng.integers(0, 256, size, dtype=np.uint8)).save(folder / name)
    return folder


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    made = folder_of(tmp_path, rng, ["images/a.png", "images/b.png", "images/c.png"])
    label(made, "image_file,depth_mm,press,contact\na.png,1.5,1,true\nb.png,2.5,1,true\nc.png,0,2,false\n")
    return made


def label(folder: Path, text: str) -> None:
    (folder / "labels.csv").write_text(text, encoding="utf-8")


def imported(folder: Path, column: str = "image_file", **options: Any) -> tuple[Run, ImportReport]:
    run = folder.parent / "run"
    report = import_images(folder, run, labels=Path("labels.csv"), image_column=column, **options)
    return Run.open(run), report


def rejects(folder: Path, kind: type[PalpateError], *words: str, **options: Any) -> None:
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(kind) as caught:
        imported(folder, **options)
    for word in words:
        assert word in str(caught.value)
    assert sorted(folder.parent.rglob("*")) == before


def test_every_row_becomes_a_frame_with_its_pixels_labels_and_name(folder):
    run, report = imported(folder, sensor="s1", licence="CC0-1.0", origin="our own")
    assert [frame.name for frame in run.frames()] == ["a.png", "b.png", "c.png"]
    for frame in run.frames():
        assert np.array_equal(frame.image, np.asarray(Image.open(folder / "images" / frame.name)))
    assert run.labels["depth_mm"].tolist() == [1.5, 2.5, 0.0]
    assert run.labels["contact"].tolist() == [True, True, False]
    assert (run.manifest.sensor, run.manifest.licence, run.manifest.origin) == ("s1", "CC0-1.0", "our own")
    assert run.manifest.clock == "ordinal"
    assert run.times_s.tolist() == [0, 1, 2]
    assert report == ImportReport(
        3, ("image_file", "depth_mm", "press", "contact"), {"depth_mm": "mm"}, ("press",)
    )


def test_a_column_of_times_counts_from_its_first(folder):
    label(folder, "image_file,at_s\na.png,1700000000.5\nb.png,1700000000.75\nc.png,1700000002\n")
    run, _ = imported(folder, time_column="at_s")
    assert run.times_s.tolist() == [0, 0.25, 1.5]


def test_unlabelled_images_are_left_out_only_when_allowed(folder):
    label(folder, "image_file,depth_mm\na.png,1\n")
    rejects(folder, LabelError, "2 images", "images/b.png", "no row", "add their rows")
    assert len(imported(folder, allow_unlabelled=True)[0]) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "image_file,depth_mm\na.png,1\nb.png,2\nc.png,3\ngone.png,4\n",
            ("row 5", "'gone.png'", "remove the rows"),
        ),
        ("image_file,depth_mm\na.png,1\nb.png,2\nc.png,3\na.png,4\n", ("rows 2, 5", "'a.png'", "keep one")),
        ("image_file,depth_mm\na.png,1\nb.png,\nc.png,nan\n", ("rows 3, 4", "'depth_mm'", "fill it in")),
        ("image_file,depth_mm,depth_mm\na.png,1,1\n", ("row 1", "'depth_mm'")),
        ("file,depth_mm\na.png,1\n", ("'image_file'", "file, depth_mm")),
        ("image_file,depth_mm\n", ("no rows",)),
        ("image_file,depth_mm\n../secret.png,1\n", ("row 2", "without '..'")),
        ("image_file,depth_mm\n..\\secret.png,1\n", ("row 2", "without '..'")),
        ("image_file,depth_mm\n/etc/secret.png,1\n", ("row 2", "relative")),
        ("image_file,depth_mm\nC:\\secret.png,1\n", ("row 2", "relative")),
        ("image_file,depth_mm\n,1\n", ("row 2", "names no image")),
    ],
)
def test_labels_that_do_not_fit_the_images_are_refused_by_row(folder, text, words):
    label(folder, text)
    rejects(folder, LabelError, "labels.csv", *words)


def test_a_missing_table_and_a_missing_folder_are_named(folder, tmp_path):
    (folder / "labels.csv").rename(tmp_path / "labels.csv")
    rejects(folder, LabelError, "labels.csv", "not there")
    with refused("folder-missing", InputError):
        import_images(
            tmp_path / "gone", tmp_path / "run", labels=tmp_path / "labels.csv", image_column="image_file"
        )


def test_a_link_out_of_the_folder_is_refused(folder, tmp_path):
    (folder / "images" / "a.png").rename(tmp_path / "outside.png")
    (folder / "images" / "a.png").symlink_to(tmp_path / "outside.png")
    rejects(folder, LabelError, "row 2", "leads out of", "copy the image")


def test_images_of_different_sizes_are_refused_and_two_are_named(folder):
    Image.new("L", (9, 9)).save(folder / "images" / "b.png")
    rejects(folder, ImageError, "b.png is 9 × 9 px", "a.png is 16 × 12 px", "one size")


@pytest.mark.parametrize("damage", ["truncated", "empty", "deep"])
def test_one_image_that_cannot_be_read_refuses_the_folder_and_is_named(folder, damage):
    path = folder / "images" / "c.png"
    if damage == "deep":
        Image.fromarray(np.zeros((12, 16), np.uint16)).save(path)
    else:
        path.write_bytes(path.read_bytes()[: 60 if damage == "truncated" else 0])
    rejects(folder, ImageError, str(path))


def test_times_that_go_backwards_are_refused_by_row(folder):
    label(folder, "image_file,at_s\na.png,1\nb.png,3\nc.png,3\n")
    rejects(folder, LabelError, "row 4", "'at_s'", "sort", time_column="at_s")


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"rate_hz": 0.0}, "above 0 Hz"),
        ({"rate_hz": float("nan")}, "above 0 Hz"),
        ({"rate_hz": 1.0, "time_column": "press"}, "give one"),
    ],
)
def test_a_rate_that_is_none_is_refused(folder, options, word):
    rejects(folder, InputError, word, **options)


def test_a_disk_that_fills_up_leaves_nothing(folder, monkeypatch):
    def full(*_: object, **__: object) -> bool:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("palpate.recordings.run_writer.RunWriter.frame", full)
    rejects(folder, PalpateError, "no room left", "free some space")


def test_columns_without_a_unit_are_told_and_refused_where_asked(tmp_path) -> None:
    folder = tmp_path / "taps"
    folder.mkdir()
    for i in range(3):
        Image.fromarray(np.full((4, 6), 40 * i, np.uint8)).save(folder / f"{i}.png")
    rows = "".join(f"{i}.png,{i},{i},0.5,{i}\n" for i in range(3))
    (folder / "labels.csv").write_text("image_file,press,depth,force_N,row\n" + rows)
    given = {"labels": folder / "labels.csv", "image_column": "image_file"}
    with refused("unit-missing", UnitError, match="--unit"):
        import_images(folder, tmp_path / "strict", strict=True, **given)
    assert not (tmp_path / "strict").exists()
    report = import_images(folder, tmp_path / "run", **given)
    assert report.unitless == ("press", "depth", "row")
    assert report.no_targets == ("depth",)
    words = ["import", "images", str(folder), str(tmp_path / "told"), "--labels", "labels.csv", "--quiet"]
    told = CliRunner().invoke(app, words)
    assert told.exit_code == 0
    assert "depth: these" in told.stderr
    assert "no unit" not in told.stdout
    (line,) = [one for one in told.stderr.splitlines() if "no unit in depth" in one]
    again = shlex.split(line.split("that it is in: palpate ")[1])
    assert again[-2:] == ["--unit", "depth=mm"]
    mended = CliRunner().invoke(app, [*again, "--quiet"])
    assert mended.exit_code == 0
    assert not mended.stderr
    assert Run.open(tmp_path / "told-with-units").manifest.units == {"depth_mm": "mm", "force_N": "N"}


def test_one_picture_with_two_labels_is_told(tmp_path, rng) -> None:
    made = folder_of(tmp_path, rng, [f"images/{name}.png" for name in "abcd"])
    for name in "bd":
        (made / f"images/{name}.png").write_bytes((made / "images/a.png").read_bytes())
    label(made, "image_file,depth_mm,press\na.png,1.5,1\nb.png,2.5,1\nc.png,1,2\nd.png,1.5,2\n")
    (doubt,) = [one for one in imported(made)[1].doubts if "same picture" in one]
    assert doubt.startswith("the same picture has two labels (a.png, b.png), in 1 case: ")


def test_the_sensor_at_rest_looks_the_same_wherever_it_stands(tmp_path, rng) -> None:
    made = folder_of(tmp_path, rng, ["images/a.png", "images/b.png"])
    (made / "images/b.png").write_bytes((made / "images/a.png").read_bytes())
    label(made, "image_file,depth_mm,x_mm\na.png,0,1\nb.png,0,2\n")
    assert not any("same picture" in one for one in imported(made)[1].doubts)
