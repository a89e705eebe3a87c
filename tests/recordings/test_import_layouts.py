"""Layouts of the field, made by hand, come in by the very command that the page gives for each."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import LabelError
from palpate.recordings import Run, import_images

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "import-labelled-images.md"
LAYOUTS_OF_PAGE = PAGE.read_text(encoding="utf-8").split("\n## Layouts\n")[1].split("\n## ")[0]
SECTIONS = dict(re.findall(r"^### (.+?)\n(.*?)(?=^##|\Z)", LAYOUTS_OF_PAGE + "\n", re.M | re.S))
Truth = dict[str, list[float] | list[str]]


def picture(path: Path, k: int) -> None:
    """An image whose grey level says which one it is."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((6, 8), 10 * k, np.uint8)).save(path)


def sessions(home: Path) -> Truth:
    for name, first in (("data_train", 1), ("data_val", 4)):
        folder = home / "taps" / name
        for k in (1, 2, 3):
            picture(folder / "processed_images" / f"image_{k}.png", first + k - 1)
        rows = [f"image_{k}.png,0,0,{first + k - 1}.5,{-k},0,0" for k in (3, 1, 2)]
        text = "sensor_image,pose_1,pose_2,pose_3,pose_4,pose_5,pose_6\n" + "\n".join(rows) + "\n"
        (folder / "targets_images.csv").write_text(text)
    levels = [3, 1, 2, 6, 4, 5]
    return {
        "level": [10.0 * k for k in levels],
        "depth_mm": [k + 0.5 for k in levels],
        "tilt_x_deg": [-3, -1, -2] * 2,
        "session": ["data_train"] * 3 + ["data_val"] * 3,
    }


def two_columns(home: Path) -> Truth:
    for k in range(3):
        picture(home / "digit" / "tactile" / f"{k:04d}.png", k)
        picture(home / "digit" / "tactile_nobg" / f"{k:04d}.png", k + 10)
    rows = [f"tactile_nobg/{k:04d}.png,tactile/{k:04d}.png,{0.25 * k}" for k in range(3)]
    (home / "digit" / "metadata.csv").write_text("file_name,raw_file_name,fz_N\n" + "\n".join(rows))
    return {"level": [0, 10, 20], "fz_N": [0, 0.25, 0.5]}


def one_json(home: Path) -> Truth:
    names = ["image9_0.48.jpg", "image11_0.76.jpg", "image8_0.07.jpg"]
    labels = {}
    for k, name in enumerate(names):
        picture(home / "allsight" / "images" / name, k)
        pose = [[0.001 * k, 0.0, 0.02], [0.0, 0.92, 0.0, 0.38]]
        labels[name] = {"ft": [0.1, 0.2, -k - 0.5, 0.0, 0.0, 0.0], "pose": pose, "num": 9}
        labels[name]["frame"] = f"elsewhere/{name}"
    (home / "allsight" / "labels.json").write_text(json.dumps(labels, indent=3))
    return {"level": [0, 10, 20], "force_N": [-0.5, -1.5, -2.5], "pose_0_0_m": [0, 0.001, 0.002]}


def a_file_an_image(home: Path) -> Truth:
    for k in range(12):
        picture(home / "frames" / f"tap_{k}.png", k)
        about = {"force": {"x": 0.1, "z": -0.5 * k}, "press": k // 4}
        (home / "frames" / f"tap_{k}.json").write_text(json.dumps(about))
        picture(home / "wrenches" / "image" / f"img{k}.png", k)
        (home / "wrenches" / "wrench").mkdir(exist_ok=True)
        wrench = np.array([0, 0, -0.5 * k, 1, 2, 3])
        np.save(home / "wrenches" / "wrench" / f"w_{k}.npy", wrench if k % 2 else wrench[None])
    column = "force_N"
    return {"level": [10 * k for k in range(12)], column: [-0.5 * k for k in range(12)]}


def no_header(home: Path) -> Truth:
    for k in range(1, 11):
        picture(home / "shoal" / "images" / f"frame_{k}.png", k)
    rows = [f"  {0.1 * k:.2f}   {k}e-1" for k in range(1, 11)]
    (home / "shoal" / "force.txt").write_text("\n".join(rows) + "\n")
    steps = range(1, 11)
    return {
        "level": [10 * k for k in steps],
        "force_N": [round(0.1 * k, 2) for k in steps],
        "depth_mm": [k / 10 for k in steps],
    }


def decimal_commas(home: Path) -> Truth:
    for k, name in enumerate("abc"):
        picture(home / "gel" / f"{name}.png", k)
    text = '\ufeffimage;depth;Fz\r\na.png;1,5;-0,25\r\nb.png;2;"-0,5"\r\nc.png;2,25;0\r\n'
    (home / "gel" / "Messung.csv").write_text(text, encoding="utf-8")
    return {"level": [0, 10, 20], "depth_mm": [1.5, 2, 2.25], "force_N": [-0.25, -0.5, 0]}


def names(home: Path) -> Truth:
    for k, x in enumerate((-1.5, 0.25, 2.0)):
        picture(home / "pressed" / f"x{x}_y{2.0 * k}_F{0.75 * k}_{k}.png", k)
    return {
        "level": [0, 10, 20],
        "x_mm": [-1.5, 0.25, 2.0],
        "y_mm": [0, 2, 4],
        "force_N": [0, 0.75, 1.5],
        "press": [0, 1, 2],
    }


LAYOUTS: dict[str, Callable[[Path], Truth]] = {
    "A table a session": sessions,
    "A table beside other pictures": two_columns,
    "One JSON for all images": one_json,
    "A file an image": a_file_an_image,
    "An array or a table without a header": no_header,
    "Semicolons and decimal commas": decimal_commas,
    "Labels in the names": names,
}


def test_every_layout_of_the_page_is_tried() -> None:
    assert set(SECTIONS) == set(LAYOUTS)


@pytest.mark.parametrize("section", LAYOUTS)
def test_a_layout_comes_in_by_the_page_s_own_command(section, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    truth = LAYOUTS[section](tmp_path)
    commands = re.findall(r"^palpate (import images .+)$", SECTIONS[section], re.M)
    assert commands
    for i, command in enumerate(commands):
        words = [f"run-{i}" if word == "run" else word for word in shlex.split(command)]
        result = CliRunner().invoke(app, [*words, "--quiet"])
        assert result.exit_code == 0, result.output
        run = Run.open(tmp_path / f"run-{i}")
        level = [float(frame.image.mean()) for frame in run.frames()]
        order = np.argsort(level) if section == "Labels in the names" else np.arange(len(level))
        assert np.asarray(level)[order] == pytest.approx(truth["level"], abs=2)  # JPEG rounds
        for column, values in truth.items():
            name = (
                "fz_N"
                if column == "force_N" and "--in-order" in words and section == "A file an image"
                else column
            )
            if name != "level":
                assert run.labels[name].to_numpy()[order].tolist() == values, name


def taps(tmp_path: Path, count: int = 3) -> Path:
    folder = tmp_path / "taps"
    for k in range(count):
        picture(folder / f"{k}.png", k)
    return folder


def rejects(tmp_path: Path, *words: str, **options) -> None:
    with pytest.raises(LabelError) as caught:
        import_images(tmp_path / "taps", tmp_path / "run", **options)
    for word in words:
        assert word in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_a_comma_that_could_part_thousands_is_refused_until_said(tmp_path) -> None:
    folder = taps(tmp_path)
    (folder / "labels.csv").write_text("file;load_N\n0.png;1,234\n1.png;2,500\n2.png;9,000\n")
    rejects(tmp_path, "'1,234'", "1.234", "1234", "--decimal comma", labels="labels.csv")
    import_images(folder, tmp_path / "run", labels="labels.csv", decimal="comma")
    assert Run.open(tmp_path / "run").labels["load_N"].tolist() == [1.234, 2.5, 9.0]


def test_a_pickle_is_never_opened(tmp_path) -> None:
    folder = taps(tmp_path)
    pd.DataFrame({"a": [1]}).to_pickle(folder / "labels.pkl")
    rejects(tmp_path, "pickle", "numpy.save", labels="labels.pkl")
    np.save(folder / "objects.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    rejects(tmp_path, "without objects", labels="objects.npy")


def test_an_image_that_the_pattern_does_not_fit_is_named(tmp_path) -> None:
    picture(taps(tmp_path) / "odd.png", 1)
    rejects(tmp_path, "'0.png'", name_pattern="x{x_mm}.png")
    picture(tmp_path / "taps" / "x2.5.png", 7)
    rejects(tmp_path, "4 of 5", name_pattern="x{x_mm}.png")
    given = {"name_pattern": "x{x_mm}.png", "allow_unlabelled": True}
    import_images(tmp_path / "taps", tmp_path / "run", **given)
    assert Run.open(tmp_path / "run").labels["x_mm"].tolist() == [2.5]


def test_a_name_without_its_suffix_finds_the_only_image_and_no_other(tmp_path) -> None:
    folder = taps(tmp_path)
    (folder / "labels.csv").write_text("file,x_mm\n0,1\n1,2\n2,3\n")
    import_images(folder, tmp_path / "run", labels="labels.csv")
    assert Run.open(tmp_path / "run").labels["x_mm"].tolist() == [1, 2, 3]
    picture(folder / "1.bmp", 4)
    with refused("image-ambiguous", LabelError):
        import_images(folder, tmp_path / "other", labels="labels.csv")
