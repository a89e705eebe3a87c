"""Laws of the frames that touch is read from."""

import cv2
import numpy as np

from palpate.recordings.exchange.frame_sequences import write_tiff
from palpate.sensing.frame_sources import open_source

IMAGES = [np.full((48, 64, 3), 40 * i, np.uint8) for i in range(3)]


def test_only_what_states_a_rate_or_times_has_a_clock(tmp_path):
    (tmp_path / "images").mkdir()
    for i, image in enumerate(IMAGES):
        cv2.imwrite(str(tmp_path / "images" / f"{i}.png"), image)
    write_tiff(tmp_path / "frames.tif", IMAGES)
    video = cv2.VideoWriter(str(tmp_path / "frames.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    for image in IMAGES:
        video.write(image)
    video.release()
    found = {}
    for name in ("images", "frames.tif", "frames.avi"):
        with open_source(tmp_path / name) as frames:
            found[name] = (frames.clocked, [frame.time_s for frame in frames])
    assert found == {
        "images": (False, [0.0, 1.0, 2.0]),
        "frames.tif": (False, [0.0, 1.0, 2.0]),
        "frames.avi": (True, [0.0, 0.04, 0.08]),
    }
