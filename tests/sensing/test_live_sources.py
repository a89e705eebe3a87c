"""Sources of live frames: none of a file's is lost, whoever writes it; a camera's keep their own time."""

from __future__ import annotations

import io
import os
import shutil
import sys
import threading
import time
import types

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage
from tests.fakes.video_capture import FakeVideoCapture
from tests.refusals import refused

from palpate.core import (
    DeviceError,
    Frame,
    ImageError,
    InputError,
    ManualClock,
    MissingExtraError,
    StorageError,
)
from palpate.core.provenance import Provenance
from palpate.recordings import Manifest, RunWriter
from palpate.recordings.exchange.image_files import encode
from palpate.recordings.exchange.image_stream import ImageCutter
from palpate.rig.real.uvc_camera import UvcCamera, UvcSettings
from palpate.sensing.frame_sources import open_source
from palpate.sensing.live_sources import (
    CameraFrames,
    HandFrames,
    NoFrameYetError,
    is_simulated,
    open_live_source,
)
from palpate.sensing.streaming.replayed_frames import PipedFrames


def images(count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.integers(0, 255, (12, 16), dtype=np.uint8) for _ in range(count)]


def all_of(source, timeout_s: float = 5.0) -> list:
    frames = []
    while (frame := source.grab(timeout_s)) is not None:
        frames.append(frame)
    source.close()
    return frames


def video(path, pictures, rate_hz: float = 50.0):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), rate_hz, (16, 12), isColor=True)
    for picture in pictures:
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def test_a_lossless_video_gives_its_frames_and_their_times(tmp_path) -> None:
    made = images(5)
    found = all_of(open_live_source(video(tmp_path / "five.avi", made)))
    assert [frame.index for frame in found] == [0, 1, 2, 3, 4]
    assert [frame.time_s for frame in found] == pytest.approx([0, 0.02, 0.04, 0.06, 0.08])
    for frame, image in zip(found, made, strict=True):
        assert np.array_equal(frame.image, image)
    assert open_live_source(tmp_path / "five.avi").waits


def test_a_paced_video_plays_at_its_own_rate_and_goes_on_in_time_when_repeated(tmp_path) -> None:
    path = video(tmp_path / "five.avi", images(5), rate_hz=50.0)
    source = open_live_source(path, paced=True, repeat=True)
    assert not source.waits
    begun_s = time.monotonic()
    frames = [source.grab(1.0) for _ in range(11)]
    took_s = time.monotonic() - begun_s
    assert took_s > 0.19
    steps = np.diff([frame.time_s for frame in frames])
    assert steps == pytest.approx(np.full(10, 0.02))
    assert [frame.index for frame in frames] == list(range(11))
    assert np.array_equal(frames[0].image, frames[5].image)
    source.close()


def test_a_folder_that_fills_gives_every_image_once_in_order(tmp_path) -> None:
    made = images(6, seed=1)
    (tmp_path / "frame-0.png").write_bytes(encode(made[0]).tobytes())

    def fill() -> None:
        for i, image in enumerate(made[1:], start=1):
            time.sleep(0.05)
            data = encode(image).tobytes()
            with (tmp_path / f"frame-{i}.png").open("wb") as file:  # half of it, then the rest
                file.write(data[: len(data) // 2])
                file.flush()
                time.sleep(0.05)
                file.write(data[len(data) // 2 :])

    writer = threading.Thread(target=fill)
    writer.start()
    found = all_of(open_live_source(tmp_path, idle_s=0.6))
    writer.join()
    assert [frame.name for frame in found] == [f"frame-{i}.png" for i in range(6)]
    assert not [frame.fault for frame in found if frame.fault]
    for frame, image in zip(found, made, strict=True):
        assert np.array_equal(frame.image, image)


def test_a_folder_that_is_taken_away_while_it_is_read_is_named(tmp_path) -> None:
    folder = tmp_path / "filling"
    folder.mkdir()
    (folder / "a.png").write_bytes(encode(images(1, seed=2)[0]).tobytes())
    source = open_live_source(folder, idle_s=5.0)
    assert source.grab(1.0) is not None
    shutil.rmtree(folder)
    with refused("file-access", StorageError):
        source.grab(1.0)


def test_a_run_that_is_being_written_gives_every_frame_and_ends_with_its_writer(tmp_path) -> None:
    made, clock = images(8, seed=3), ManualClock()
    writer = RunWriter.create(tmp_path / "run", Manifest.new(sensor="spots", labels={}), clock=clock)
    writer.frame(made[0])
    writer.sync()
    source = open_live_source(tmp_path / "run", idle_s=5.0)
    found = [source.grab(2.0)]

    def record() -> None:
        for image in made[1:]:
            clock.sleep(0.1)
            writer.frame(image)
            writer.sync()
        writer.close()

    recorder = threading.Thread(target=record)
    recorder.start()
    begun_s = time.monotonic()
    found += all_of(source)
    recorder.join()
    assert time.monotonic() - begun_s < 4.0  # by the end of the writer, not of its patience
    assert [frame.index for frame in found] == list(range(8))
    for frame, stored in zip(found, open_source(tmp_path / "run"), strict=True):
        assert np.array_equal(frame.image, stored.image)
        assert frame.time_s == pytest.approx(stored.time_s, abs=1e-9)
        assert frame.name == stored.name


@pytest.mark.parametrize("provenance", [Provenance.SIMULATED, Provenance.MEASURED])
def test_frames_of_a_virtual_sensor_are_called_simulated_however_they_come(
    provenance: Provenance, tmp_path
) -> None:
    expected = provenance is Provenance.SIMULATED
    manifest = Manifest.new(sensor="spots", labels={}, provenance=provenance)
    with RunWriter.create(tmp_path / "run", manifest) as writer:
        writer.frame(images(1)[0])
        writer.sync()
        assert is_simulated(open_live_source(tmp_path / "run")) == expected, "while it is written"
    assert is_simulated(open_live_source(tmp_path / "run")) == expected
    assert is_simulated(open_live_source(tmp_path / "run", paced=True)) == expected
    assert not is_simulated(open_live_source(video(tmp_path / "taps.avi", images(2))))


def test_what_is_given_to_a_pipe_comes_out_whatever_lies_between(rng) -> None:
    made = images(4, seed=4)
    jpeg = io.BytesIO()
    PillowImage.fromarray(made[1]).save(jpeg, "JPEG", quality=100)
    files = [encode(made[0]).tobytes(), jpeg.getvalue(), encode(made[2]).tobytes(), encode(made[3]).tobytes()]
    between = b"--frame\r\nContent-Type: image/jpeg\r\n\r\n"
    stream = between.join(files)
    cutter, found = ImageCutter(), []
    for at in range(0, len(stream), 7):
        found += cutter.feed(stream[at : at + 7])
    assert found == files


def test_a_png_that_is_cut_short_in_a_pipe_is_one_that_cannot_be_read_and_the_next_follows() -> None:
    whole = [encode(image).tobytes() for image in images(2, seed=8)]
    for end in (20, len(whole[0]) // 2, len(whole[0]) - 1):
        found = list(ImageCutter().feed(whole[0] + whole[1][:end] + whole[1]))
        assert found == [whole[0], whole[1][:8], whole[1]]


def test_standard_input_gives_images_and_then_ends() -> None:
    made = images(3, seed=7)
    read, write = os.pipe()
    with os.fdopen(read, "rb") as stream:
        source = PipedFrames(stream)
        with pytest.raises(NoFrameYetError):
            source.grab(0.02)
        os.write(write, b"".join(encode(image).tobytes() for image in made))
        os.close(write)
        found = all_of(source)
    assert [frame.index for frame in found] == [0, 1, 2]
    for frame, image in zip(found, made, strict=True):
        assert np.array_equal(frame.image, image)


def grabbed(source, count: int, timeout_s: float) -> list:
    return [source.grab(timeout_s) for _ in range(count)]


def fake_camera(rate_hz: float = 100.0):
    capture = FakeVideoCapture(rate_hz=rate_hz)
    settings = UvcSettings(size_px=(64, 48), rate_hz=rate_hz, exposure_s=5e-3)
    return capture, UvcCamera("fake", settings, opener=lambda where: capture)


def fake_where(monkeypatch) -> None:
    monkeypatch.setattr("palpate.rig.real.uvc_camera.device", lambda address: address)


def test_every_frame_of_a_camera_comes_not_every_other(monkeypatch) -> None:
    fake_where(monkeypatch)
    capture, camera = fake_camera()
    with CameraFrames(camera, "camera fake", behind_ns=10_000_000) as source:
        found = [source.grab(1.0) for _ in range(20)]
        capture.drop(3)
        found += [source.grab(1.0) for _ in range(5)]
    names = [int(frame.name) for frame in found]
    assert names == list(range(names[0], names[0] + 25))
    assert sum(frame.lost for frame in found) == 3
    ages_s = [frame.arrived_ns / 1e9 - frame.time_s for frame in found]
    assert ages_s == pytest.approx([0.01] * 25)


def test_a_camera_that_gives_nothing_says_so_and_one_that_is_gone_says_that(monkeypatch) -> None:
    fake_where(monkeypatch)
    capture, camera = fake_camera()
    with CameraFrames(camera, "camera fake") as source:
        source.grab(1.0)
        capture.resume.clear()
        capture.hangs.wait(1.0)
        with pytest.raises(NoFrameYetError):
            grabbed(source, 60, 0.05)  # those that were on their way come still
        capture.unplugged = True
        capture.resume.set()
        with pytest.raises(DeviceError, match="unplugged"):
            grabbed(source, 60, 0.5)


class SlowHand:
    """A virtual hand whose frames take their time to draw, by the clock that a test moves."""

    def __init__(self) -> None:
        self.clock, self.rate_hz, self.rested = ManualClock(), 10.0, []
        self.camera = self.world = self
        self.force, self.drawn, self.presses, self.size_px = None, 0, (), (2, 2)

    @property
    def now_s(self) -> float:
        return self.clock.ns / 1e9

    def _frame(self, number: int) -> tuple[int, Frame]:
        self.drawn = max(self.drawn, number)
        return round(number * 1e8), Frame(np.zeros((2, 2), np.uint8), number / 10)

    def grab(self, timeout_s: float):
        self.clock.sleep(0.1)
        return self._frame(int(self.now_s * 10))

    def drain(self, at_most: int | None = None):
        due = range(self.drawn + 1, int(self.now_s * 10) + 1)
        return [self._frame(number) for number in due[:at_most]]

    def draw_ahead(self) -> None:
        self.clock.sleep(5.0)  # which no frame is lost by

    def rest(self) -> None:
        self.rested.append(True)

    def press(self) -> None:
        self.rested.append(False)

    def close(self) -> None:
        self.rested.append(None)


def test_what_a_virtual_hand_could_not_draw_in_time_is_lost_and_counted() -> None:
    hand = SlowHand()
    with HandFrames(hand, "virtual:slow") as source:
        hand.clock.sleep(3.0)  # until somebody asks for frames
        first = source.grab(0.1)
        hand.clock.sleep(0.2)
        before = hand.drawn
        found = [source.grab(0.1)]
        assert hand.drawn == before + 1  # and not until the frame after it is drawn too
        found.append(source.grab(0.1))
        hand.clock.sleep(1.0)  # drawing fell behind
        late = source.grab(0.1)
        source.let_rest(True)
        source.let_rest(False)
    assert first.time_s > 8.0
    assert [round(10 * (one.time_s - first.time_s)) for one in found] == [1, 2]
    assert [one.lost for one in (first, *found)] == [0, 0, 0]
    assert late.time_s == pytest.approx(hand.now_s, abs=0.1)
    assert late.lost == round(10 * (late.time_s - found[-1].time_s)) - 1 == 10
    assert [one.index for one in (first, *found, late)] == [0, 1, 2, 3]
    assert hand.rested == [True, False, None]


def test_a_picamera_needs_its_library_and_gives_frames_with_it(monkeypatch) -> None:
    with pytest.raises(MissingExtraError, match="picamera2"):
        open_live_source("picamera2")

    class Request:
        def make_array(self, name):
            return np.dstack([np.full((48, 64), value, np.uint8) for value in (200, 100, 50)])

        def get_metadata(self):
            return {"ExposureTime": 8000, "SensorTimestamp": time.monotonic_ns() - 20_000_000}

        def release(self):
            pass

    class Picamera2:
        def __init__(self, number):
            self.stopped = False

        def create_video_configuration(self, main, controls):
            assert controls["AeEnable"] is False
            assert controls["FrameDurationLimits"] == (20000, 20000)
            return {"main": main}

        def configure(self, configuration):
            assert configuration["main"]["size"] == (64, 48)

        def start(self):
            pass

        def capture_request(self):
            time.sleep(0.01)
            return Request()

        def stop(self):
            self.stopped = True

        def close(self):
            pass

    monkeypatch.setitem(sys.modules, "picamera2", types.SimpleNamespace(Picamera2=Picamera2))
    settings = UvcSettings(size_px=(64, 48), rate_hz=50.0, exposure_s=8e-3)
    with open_live_source("picamera2", settings=settings) as source:
        frame = source.grab(1.0)
    assert frame.image[0, 0].tolist() == [200, 100, 50]
    assert frame.exposure_s == pytest.approx(8e-3)
    behind_s = frame.arrived_ns / 1e9 - frame.time_s
    assert behind_s == pytest.approx(0.0, abs=1e-6)


def test_an_address_of_nothing_says_what_could_be_given(tmp_path) -> None:
    with refused("source-missing", ImageError):
        open_live_source(tmp_path / "nothing.avi")
    with pytest.raises(DeviceError, match="serial number"):
        open_live_source("NOSUCHSERIAL")
    with pytest.raises(InputError, match="paced"):
        open_live_source("virtual:palm", paced=True)
    with pytest.raises(InputError, match="for ever"):
        open_live_source(tmp_path, repeat=True)


def test_a_virtual_sensor_is_pressed_by_another_hand_each_time_unless_one_is_asked_for() -> None:
    """Else what is read live would be the presses that a calibration of the same hand was learnt from."""
    seeds = []
    for seed in (None, None, 7, 7):
        with open_live_source("virtual:tactip", seed=seed) as source:
            seeds.append(source.hand.world.seed)
    assert len({0, *seeds[:2]}) == 3
    assert seeds[2:] == [7, 7]
