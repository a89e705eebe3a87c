"""Label columns called as the code calls columns of its own go through every verb."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from typer.testing import CliRunner

from palpate.cli import app
from palpate.recordings import Run

NAMES = (
    "row",
    "frame",
    "index",
    "name",
    "valid",
    "why",
    "fold",
    "time_s",
    "session",
    "run",
    "group",
    "column",
)


def palpate(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, (words, result.output, result.exception)
    return result.stdout


def taps(folder: Path, seed: int) -> Path:
    """A spot whose place is a label, beside a number under each of the names."""
    rng, columns = np.random.default_rng(seed), np.arange(32)
    folder.mkdir()
    rows = []
    for i in range(48):
        x_mm = float(rng.uniform(-2, 2))
        line = 40 + 150 * np.exp(-((columns - 16 - 4 * x_mm) ** 2) / 20)
        image = (line + rng.normal(0, 2, (24, 32))).clip(0, 255).astype(np.uint8)
        Image.fromarray(image).save(folder / f"{i}.png")
        rows.append(
            {"image_file": f"{i}.png", "x_mm": x_mm, **{n: 3 * k + i // 4 for k, n in enumerate(NAMES)}}
        )
    pd.DataFrame(rows).to_csv(folder / "labels.csv", index=False)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "split", ["auto", *(pytest.param(f"group:{by}", marks=pytest.mark.slow) for by in ("row", "frame"))]
)
def test_from_import_to_comparison(split, tmp_path) -> None:
    quiet = ("--quiet", "--json")
    for name, seed in (("run", 0), ("other", 1)):
        folder = taps(tmp_path / f"{name}-taps", seed)
        palpate("import", "images", folder, tmp_path / name, "--labels", "labels.csv", *quiet)
        table = pd.read_csv(folder / "labels.csv")
        for column in NAMES:
            assert Run.open(tmp_path / name).labels[column].tolist() == table[column].tolist()
        assert json.loads(palpate("check", tmp_path / name, "--json"))["sound"]
    cal, small = tmp_path / "cal", tmp_path / "small"
    plan = ("calibrate", tmp_path / "run", "--targets", "x_mm", "--split", split, "--folds", 3, "--quiet")
    palpate(*plan, "--size", "12x16", "--out", cal)
    palpate(*plan, "--size", "6x8", "--out", small)
    found = json.loads(palpate("evaluate", cal, tmp_path / "other", "--out", cal / "other.json", *quiet))
    assert found["frames_scored"] == 48
    palpate("report", cal, "--out", tmp_path / "page.html")
    assert json.loads(palpate("compare", cal, small, "--json"))["comparable"]
    lines = palpate("read", tmp_path / "other", "--with", cal, "--json").splitlines()
    assert len(lines) == 48
    if split != "group:frame":
        palpate("adapt", cal, tmp_path / "other", "--out", tmp_path / "adapted", "--quiet")
    palpate("export", tmp_path / "run", tmp_path / "exported", "--quiet")
    exported = pd.read_csv(tmp_path / "exported" / "labels.csv")
    assert exported["row"].tolist() == Run.open(tmp_path / "run").labels["row"].tolist()
    again = ("--labels", "labels.csv", "--image-column", "frame_file")
    palpate("import", "images", tmp_path / "exported", tmp_path / "again", *again, *quiet)
    assert Run.open(tmp_path / "again").labels.equals(Run.open(tmp_path / "run").labels)
