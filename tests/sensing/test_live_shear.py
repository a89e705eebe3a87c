"""Touch on a patterned skin, live: as frame by frame from a file, once the untouched skin was shown."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused
from tests.sensing.live_stand_ins import HandedFrames

import palpate
from palpate.core import CertificateError, Frame, Pose, untouched
from palpate.estimators.shear import ShearReader
from palpate.sensing.frame_readers import read_touches
from palpate.sensing.live_loop import LiveLoop
from palpate.sensing.streaming.touch_readers import open_shear_reader


@pytest.fixture(scope="module")
def filmed() -> list[np.ndarray]:
    """The untouched skin of a virtual NUSense, and two presses."""
    sensor, rng = palpate.sensor("nusense"), np.random.default_rng(0)
    probe = sensor.probe("round")
    pressed = [sensor.press(probe, Pose(0.0, 0.0, depth_m)) for depth_m in (0.5e-3, 1e-3)]
    return [sensor.render(one, rng).image for one in (untouched(sensor), *pressed)]


def test_live_touch_is_that_of_a_file_once_the_skin_was_zeroed(filmed) -> None:
    reader, source = open_shear_reader("nusense"), HandedFrames(waits=True)
    frames = [Frame(image, i / 12, name=str(i)) for i, image in enumerate(filmed)]
    source.give(*frames, None)
    found = []

    class Keep:
        def on_frame(self, frame, readings) -> None:
            found.append({name: one.to_dict() for name, one in readings.items()})

        def on_force(self, samples) -> None:
            pass

    loop = LiveLoop(lambda: source, reader, source=source, subscribers=[Keep()])
    assert "untouched" in loop.advice
    with loop:
        loop.zero(filmed[0])
        loop.start()
        assert loop.wait(60.0)
        assert loop.advice == ""
    of_file = read_touches(frames, ShearReader(palpate.sensor("nusense").shear_skin(), frames[0]))
    expected = [touched.to_dict()["readings"] for touched in of_file]
    assert found == expected
    assert len(found) == 3


def test_a_frame_of_another_size_gives_none_and_says_why(filmed) -> None:
    reader = open_shear_reader("nusense", reference=filmed[0])
    assert len(reader.read(Frame(np.zeros((8, 8, 3), np.uint8)))) == 0
    assert "8" in reader.needs
    assert len(reader.read(Frame.unreadable("damaged", 0.0, "b.png"))) == 0


def test_a_folder_of_another_calibration_is_told_what_makes_one_of_force_by_marks(tmp_path) -> None:
    with refused("not-a-force-calibration", CertificateError):
        open_shear_reader("nusense", tmp_path)
