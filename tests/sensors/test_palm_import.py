"""The palm's own tables and photographs become a run that keeps what belongs together, or a clear error."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import InputError, LabelError, PalpateError
from palpate.recordings import Run, check
from palpate.sensors.palm.palm_import import import_palm

HEADER = "t_s,indent_mm,phase,Fx,Fy,Fz,x_mm,y_mm,image_file\n"
DEPTHS = (0.0, 0.1, 5.0)
SAMPLES, PHOTOS, MANY = 5, 2, 12
PLACES = ((4, 6, 1), (4, 6, 2), (10, 7, 1))  # row, column, cycle
FRAMES = len(PLACES) * (len(DEPTHS) + 1) * PHOTOS + MANY - PHOTOS


def force_n(depth_mm: float, sample: int) -> tuple[float, float, float]:
    """Of one sample: negative in compression, as an ATI sensor under a probe reads it."""
    return 0.01 * sample, -0.02 * depth_mm, -2.0 * depth_mm + 0.003 * (sample - 2) + 0.001


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Two cycles at one place and one at another, three depths down and the last checkpoint up."""
    made = tmp_path / "dataset"
    for row, column, cycle in PLACES:
        lines = []
        for phase, depth in (*(("down", depth) for depth in DEPTHS), ("up", 0.0)):
            shot = f"Cycle_r{row}c{column}_{cycle}_{phase}_{depth:.3f}mm"
            (made / "images" / shot).mkdir(parents=True)
            for k in range(MANY if (cycle, depth, phase) == (2, 5.0, "down") else PHOTOS):
                photo = rng.integers(0, 255, (12, 16, 3), dtype=np.uint8)
                Image.fromarray(photo).save(made / "images" / shot / f"photo_{k}.png")
            for i in range(SAMPLES):
                cells = (0.01 * i + depth, depth, phase, *force_n(depth, i), 7.0 * column, -7.0 * row)
                lines.append(",".join(map(str, (*cells, f"images/{shot}"))))
        table(made, f"r{row}c{column}_{cycle}").write_text(HEADER + "\n".join(lines) + "\n")
    return made


def table(folder: Path, press: str) -> Path:
    return folder / f"Cycle_Indent5mm_{press}.csv"


def change(path: Path, old: str, new: str) -> None:
    """In the first place where it stands."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def imported(folder: Path, **options: Any) -> Run:
    import_palm(folder, folder.parent / "run", **options)
    return Run.open(folder.parent / "run")


def not_imported(folder: Path, kind: type[PalpateError], *words: str, **options: Any) -> None:
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(kind) as caught:
        imported(folder, **options)
    for word in words:
        assert word in str(caught.value), str(caught.value)
    assert sorted(folder.parent.rglob("*")) == before, "nothing half-made is left"


def test_every_photograph_becomes_a_frame_with_its_pixels_and_its_shots_labels(folder: Path) -> None:
    run = imported(folder)
    labels = run.labels
    assert len(run) == FRAMES
    for k in (0, 17, len(run) - 1):
        path = folder / labels["image_file"][k]
        assert np.array_equal(run.frame(k).image, np.asarray(Image.open(path)))
    deepest = labels[(labels["location"] == "r4c6") & (labels["cycle"] == 2) & (labels["depth_mm"] == 5.0)]
    assert len(deepest) == MANY
    told = deepest.iloc[3]
    assert (told["press"], told["phase"], told["shot"]) == ("r4c6/2", "down", "r4c6/2/down/5000/0")
    assert (told["row"], told["column"], told["x_mm"], told["y_mm"]) == (4, 6, 42.0, -28.0)
    mean = np.mean([force_n(5.0, i) for i in range(SAMPLES)], axis=0)
    assert told[["force_x_N", "force_y_N", "force_N"]].tolist() == pytest.approx([mean[0], mean[1], -mean[2]])
    assert told["force_sd_N"] == pytest.approx(0.003 * np.std(range(SAMPLES), ddof=1))
    assert told["t_s"] == pytest.approx(5.02)
    assert run.manifest.clock == "ordinal"
    assert check(run.path).sound


def test_photographs_of_a_shot_come_in_the_order_of_their_numbers(folder: Path) -> None:
    labels = imported(folder).labels
    names = labels["image_file"][labels["shot"] == "r4c6/2/down/5000/0"].str.extract(r"(\d+)\.png")[0]
    assert names.astype(int).tolist() == list(range(MANY))


@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_force_is_positive_in_compression_whichever_way_fz_points(folder: Path, turned: float) -> None:
    for path in folder.glob("*.csv"):
        read = pd.read_csv(path)
        read["Fz"] *= turned
        read.to_csv(path, index=False)
    labels = imported(folder).labels
    assert labels["force_N"][labels["depth_mm"] == 5.0].min() > 9.9
    # Noise about zero keeps its sign: rectified, a resting sensor would read a force.
    assert labels["force_N"][labels["reference"]].unique() == pytest.approx([-0.001])


def test_tables_that_disagree_about_the_sign_are_refused(folder: Path) -> None:
    path = table(folder, "r10c7_1")
    read = pd.read_csv(path)
    read["Fz"] *= -1
    read.to_csv(path, index=False)
    not_imported(folder, LabelError, "r4c6_1.csv", "r10c7_1.csv", "sign")


@pytest.mark.parametrize("name", ["Cycle_r4c6_3.csv", "x.CSV"])
def test_a_table_of_another_name_is_refused(folder: Path, name: str) -> None:
    shutil.copy(table(folder, "r4c6_1"), folder / name)
    not_imported(folder, LabelError, name, "not named as")


def test_two_tables_of_one_press_are_refused(folder: Path) -> None:
    shutil.copy(table(folder, "r4c6_1"), table(folder, "r04c6_1"))
    not_imported(folder, LabelError, "r04c6_1.csv", "same press")


@pytest.mark.parametrize("column", ["Fz", "image_file"])
def test_a_missing_column_is_named(folder: Path, column: str) -> None:
    path = table(folder, "r4c6_2")
    pd.read_csv(path).drop(columns=column).to_csv(path, index=False)
    not_imported(folder, LabelError, "r4c6_2.csv", "row 1", repr(column))


@pytest.mark.parametrize(("column", "value"), [("t_s", "nan"), ("Fz", "much"), ("x_mm", "1_5"), ("Fx", "")])
def test_a_cell_that_is_no_finite_number_is_named_by_file_and_row(
    folder: Path, column: str, value: str
) -> None:
    path = table(folder, "r4c6_2")
    read = pd.read_csv(path, dtype=str)
    read.loc[6, column] = value
    read.to_csv(path, index=False)
    not_imported(folder, LabelError, "r4c6_2.csv", "row 8", column)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("down", "sideways", ("row 2", "'sideways'", "down or up")),
        (",0.1,down", ",5.2,down", ("row 7", "5.2", "0 to 5")),
        (",0.1,down", ",0.3,down", ("row 7", "misfiled")),
        ("images/Cycle_r4c6_1_down_0.1", "images/Cycle_r4c7_1_down_0.1", ("row 7", "misfiled")),
        (
            ",42.0,-28.0,images/Cycle_r4c6_1_down_0.1",
            ",42.1,-28.0,images/Cycle_r4c6_1_down_0.1",
            ("row 8", "x_mm"),
        ),
        ("images/Cycle_r4c6_1_down_0.000mm", "gone", ("row 2", "'gone'", "copy it there")),
        ("images/Cycle_r4c6_1_down_0.000mm", "", ("row 2", "names no image_file")),
        ("images/Cycle_r4c6_1_down_0.000mm", "../secret", ("row 2", "without '..'")),
        ("images/Cycle_r4c6_1_down_0.000mm", "/etc", ("row 2", "stay inside")),
        ("images/Cycle_r4c6_1_down_0.000mm", "D:\\ERP\\images", ("row 2", "stay inside")),
        ("images/Cycle_r4c6_1_down_0.000mm", "=1+1", ("row 2", "formula")),
    ],
)
def test_a_cell_that_does_not_fit_is_named_by_file_and_row(
    folder: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    (folder.parent / "secret").mkdir()
    change(table(folder, "r4c6_1"), old, new)
    not_imported(folder, LabelError, "r4c6_1.csv", *words)


def test_a_shot_without_photographs_is_refused(folder: Path) -> None:
    shot = folder / "images" / "Cycle_r4c6_2_down_0.100mm"
    for photo in shot.iterdir():
        photo.unlink()
    not_imported(folder, LabelError, "r4c6_2.csv", "row 7", "no photograph")


def test_links_that_lead_out_of_the_folder_are_refused(folder: Path, rng: np.random.Generator) -> None:
    outside = folder.parent / "outside.png"
    shutil.copy(folder / "images" / "Cycle_r4c6_1_down_0.000mm" / "photo_0.png", outside)
    link = folder / "images" / "Cycle_r4c6_1_down_0.000mm" / "photo_99.png"
    try:
        link.symlink_to(outside)
    except OSError:
        pytest.skip("links cannot be made here")
    not_imported(folder, LabelError, "r4c6_1.csv", "row 2", "leads out")


def test_a_photograph_of_two_shots_is_refused(folder: Path) -> None:
    first = folder / "images" / "Cycle_r4c6_1_down_0.000mm" / "photo_0.png"
    link = folder / "images" / "Cycle_r4c6_2_down_0.100mm" / "photo_99.png"
    try:
        link.symlink_to(first)
    except OSError:
        pytest.skip("links cannot be made here")
    not_imported(folder, LabelError, "two shots", "r4c6_1.csv", "r4c6_2.csv")


def test_photographs_that_no_table_names_are_left_out_only_when_allowed(folder: Path) -> None:
    table(folder, "r10c7_1").unlink()
    not_imported(folder, LabelError, "8 photographs", "Cycle_r10c7_1")
    assert len(imported(folder, allow_unlabelled=True)) == FRAMES - 4 * PHOTOS


def test_a_table_that_is_too_large_is_not_read(folder: Path) -> None:
    with table(folder, "r4c6_1").open("ab") as file:
        file.truncate(1 << 25)
    not_imported(folder, LabelError, "r4c6_1.csv", "33554432 bytes")


def test_no_folder_and_no_tables_are_told(tmp_path: Path) -> None:
    with refused("folder-missing", InputError):
        import_palm(tmp_path / "none", tmp_path / "run")
    with refused("no-table", InputError):
        import_palm(tmp_path, tmp_path / "run")


def test_the_verb_imports_and_tells_what_it_found(folder: Path) -> None:
    run = folder.parent / "run"
    said = CliRunner().invoke(
        app, ["import", "palm", str(folder), str(run), "--licence", "CC-BY-4.0", "--quiet"]
    )
    assert said.exit_code == 0, said.output
    assert f"{FRAMES} frames" in said.output
    assert "force_N [N]" in said.output
    assert Run.open(run).manifest.licence == "CC-BY-4.0"
    again = CliRunner().invoke(app, ["import", "palm", str(folder), str(run), "--json", "--quiet"])
    assert again.exit_code == 2
