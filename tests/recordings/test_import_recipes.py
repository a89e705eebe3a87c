"""The import page's own lines of Python, run as they stand there, make folders that are imported."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.core import LabelError
from palpate.recordings import Run, import_images

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "import-labelled-images.md"
DEPTHS = [0.5, 1.0, 1.5, 2.0]


def lines_of(heading: str) -> str:
    part = PAGE.read_text(encoding="utf-8").split(f"### {heading}\n")[1].split("\n### ")[0]
    return re.search(r"```python\n(.*?)```", part, re.DOTALL)[1]


def test_a_video_becomes_images_by_the_lines_of_the_page(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    video = cv2.VideoWriter("presses.mp4", cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 48))
    for grey in (40, 90, 140, 190):
        video.write(np.full((48, 64, 3), grey, np.uint8))
    video.release()
    exec(lines_of("A video and a table with a row a frame"), {})
    Path("presses.csv").write_text("depth_mm\n" + "\n".join(map(str, DEPTHS)))
    import_images("frames", "run", labels="presses.csv", in_order=True, rate_hz=30)
    run = Run.open("run")
    assert run.labels["depth_mm"].tolist() == DEPTHS
    assert [frame.image.mean() for frame in run.frames()] == pytest.approx([40, 90, 140, 190], abs=8)


def test_an_array_becomes_images_by_the_lines_of_the_page(tmp_path, rng, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    images = rng.integers(0, 256, (4, 12, 16, 3), dtype=np.uint8)
    np.savez("presses.npz", images=images, depth_mm=DEPTHS)
    exec(lines_of("Images in an array"), {})
    Path("presses.npz").unlink()
    import_images(".", "run", labels="labels.csv")
    run = Run.open("run")
    assert run.labels["depth_mm"].tolist() == DEPTHS
    assert np.array_equal([frame.image for frame in run.frames()], images)


def pictures(folder: Path, names: list[str]) -> Path:
    folder.mkdir()
    for i, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((8, 8), 40 * i, np.uint8))
    return folder


def test_a_list_of_objects_is_found_beside_what_is_said_of_them_all(tmp_path) -> None:
    folder = pictures(tmp_path / "headed", ["a.png", "b.png"])
    samples = [{"image": "b.png", "depth_mm": 1.0}, {"image": "a.png", "depth_mm": 2.0}]
    whole = {"meta": {"sensor": "x"}, "samples": samples}
    (folder / "labels.json").write_text(json.dumps(whole))
    import_images(folder, tmp_path / "run", labels="labels.json")
    assert Run.open(tmp_path / "run").labels["depth_mm"].tolist() == [1.0, 2.0]
    whole["others"] = samples * 200
    (folder / "labels.json").write_text(json.dumps(whole))
    with pytest.raises(LabelError) as caught:
        import_images(folder, tmp_path / "other", labels="labels.json")
    assert len(str(caught.value)) < 1000
    assert "more" in str(caught.value)
