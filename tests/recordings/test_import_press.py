"""A press from a TIFF or a video and its table: the run holds what they held."""

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile
from numpy.testing import assert_allclose, assert_array_equal
from tests.refusals import refused

from palpate.core.errors import ExistsError, ImageError, InputError, LabelError
from palpate.recordings import Run
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.image_import import import_press


@pytest.fixture
def press(tmp_path, rng):
    """Eight frames at 20 Hz and 80 samples at 200 Hz."""
    frames = rng.integers(0, 256, (8, 32, 40), dtype=np.uint8)
    with tifffile.TiffWriter(tmp_path / "press.tif") as writer:
        for frame in frames:
            writer.write(frame, contiguous=False)
    i = np.arange(80)
    table = {"time_s": i / 200, "force_N": 0.05 * i, "actual_mm": 0.025 * i, "frame": i // 10}
    pd.DataFrame(table).to_csv(tmp_path / "force.csv", index=False)
    return frames, tmp_path


def test_frames_force_and_position_arrive_at_their_times(press) -> None:
    frames, folder = press
    import_press(folder / "press.tif", folder / "run", force=folder / "force.csv", sensor="tactip")
    run = Run.open(folder / "run")
    assert_array_equal(np.stack([frame.image for frame in run.frames()]), frames)
    assert_allclose(np.diff(run.times_s), 0.05)
    assert_allclose(run.labels["force_N"], 0.5 * np.arange(8))
    assert_allclose(run.labels["position_mm"], 0.25 * np.arange(8))
    assert len(run.force()) == 80
    assert_allclose(run.force()["fz_N"].iloc[-1], 3.95)
    assert_allclose(run.stage()["z_m"].iloc[-1], 79 * 25e-6)


def test_an_area_becomes_a_label_where_it_is_known(press) -> None:
    _, folder = press
    table = pd.read_csv(folder / "force.csv")
    table["true_area_mm2"] = [np.nan] * 25 + [1.0 + i for i in range(55)]
    table.to_csv(folder / "area.csv", index=False)
    import_press(folder / "press.tif", folder / "run", force=folder / "area.csv")
    run = Run.open(folder / "run")
    assert_allclose(run.labels["true_area_mm2"], [np.nan] * 3 + [6.0, 16.0, 26.0, 36.0, 46.0])
    assert run.manifest.units["true_area_mm2"] == "mm2"


def test_nothing_is_left_of_a_press_that_does_not_fit(press) -> None:
    _, folder = press
    short = pd.read_csv(folder / "force.csv").iloc[:50]
    short.to_csv(folder / "short.csv", index=False)
    with refused("frame-count", LabelError):
        import_press(folder / "press.tif", folder / "run", force=folder / "short.csv")
    assert not (folder / "run").exists()
    (folder / "taken").mkdir()
    with pytest.raises(ExistsError):
        import_press(folder / "press.tif", folder / "taken", force=folder / "force.csv")


def test_a_video_is_a_press_too(tmp_path, rng) -> None:
    writer = cv2.VideoWriter(
        str(tmp_path / "v.avi"), cv2.VideoWriter_fourcc(*"FFV1"), 30, (40, 32), isColor=True
    )
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write FFV1 videos")
    frames = rng.integers(0, 256, (6, 32, 40), dtype=np.uint8)
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()
    pd.DataFrame({"force_N": np.linspace(0, 3, 6)}).to_csv(tmp_path / "f.csv", index=False)
    import_press(tmp_path / "v.avi", tmp_path / "run", force=tmp_path / "f.csv", rate_hz=30.0)
    assert len(Run.open(tmp_path / "run")) == 6
    with open_sequence(tmp_path / "v.avi") as video:
        assert len(video) == 6
        assert_allclose(np.stack(list(video)).astype(float), frames, atol=3)


def test_what_is_no_sequence_is_refused(tmp_path) -> None:
    (tmp_path / "a.txt").write_text("no")
    (tmp_path / "b.avi").write_bytes(b"RIFF no video")
    (tmp_path / "empty").mkdir()
    for name, kind in (("a.txt", InputError), ("b.avi", ImageError), ("empty", InputError)):
        with pytest.raises(kind), open_sequence(tmp_path / name):
            pass
