"""The USB camera driver against a camera that is not there, and its faults told for what they are."""

import errno
import os
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.fakes.video_capture import BLUE, FakeVideoCapture, frame_number
from tests.refusals import refused
from tests.rig.conftest import PATIENCE_S, until

from palpate.core.errors import DeviceError, RangeError
from palpate.devices.rpc import path_of
from palpate.rig.real import camera_listing
from palpate.rig.real.camera_listing import VideoSystem, list_cameras
from palpate.rig.real.device_hold import camera_named, hold_device
from palpate.rig.real.uvc_camera import FrameWatch, UvcCamera, UvcSettings, device, refuse_absent

SETTINGS = UvcSettings(size_px=(64, 48), rate_hz=100.0, exposure_s=5e-3, freeze_s=0.2)


@pytest.fixture
def source() -> FakeVideoCapture:
    return FakeVideoCapture()


def opened(source: FakeVideoCapture, settings: UvcSettings = SETTINGS) -> UvcCamera:
    return UvcCamera("/dev/video7", settings, opener=lambda where: source)


@pytest.fixture
def camera(source: FakeVideoCapture) -> Iterator[UvcCamera]:
    with opened(source) as made:
        yield made
    assert source.released.is_set()


def number(image: np.ndarray) -> int:
    return frame_number(np.ascontiguousarray(image[..., ::-1]))


def refused_open(source: FakeVideoCapture, settings: UvcSettings = SETTINGS) -> str:
    with pytest.raises(DeviceError) as told:
        opened(source, settings)
    assert source.released.is_set()
    assert "/dev/video7" in str(told.value)
    return str(told.value)


def failure(camera: UvcCamera) -> str:
    """Wait until the camera fails, and why."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        try:
            camera.grab(PATIENCE_S)
        except DeviceError as error:
            return str(error)
    pytest.fail("waited in vain")


def test_a_frame_is_rgb_and_says_exposure_camera_and_time(camera: UvcCamera) -> None:
    time_ns, frame = camera.grab(PATIENCE_S)
    assert frame.image.shape == (48, 64, 3)
    assert (frame.image[..., 2] == BLUE).mean() > 0.99  # all but the pixels with the number
    assert frame.exposure_s == pytest.approx(5e-3)
    assert frame.sensor == "/dev/video7"
    assert frame.time_s == time_ns / 1e9


def test_a_frame_comes_so_much_later_as_the_delay_says(source: FakeVideoCapture) -> None:
    settings = replace(SETTINGS, delay_s=0.2)
    with opened(source, settings) as camera:
        asked_ns = time.monotonic_ns()
        time_ns, _ = camera.grab(PATIENCE_S)
        assert asked_ns + 5_000_000 <= time_ns <= time.monotonic_ns() - 200_000_000


def test_everything_that_was_set_is_read_back(source: FakeVideoCapture) -> None:
    settings = replace(SETTINGS, white_balance_k=5200, controls={cv2.CAP_PROP_GAIN: 3.0}, pixels="YUYV")
    with opened(source, settings):
        held = {
            cv2.CAP_PROP_AUTO_EXPOSURE: 1,
            cv2.CAP_PROP_EXPOSURE: 50,  # of 0.1 ms
            cv2.CAP_PROP_AUTO_WB: 0,
            cv2.CAP_PROP_WB_TEMPERATURE: 5200,
            cv2.CAP_PROP_GAIN: 3,
            cv2.CAP_PROP_FRAME_WIDTH: 64,
            cv2.CAP_PROP_FRAME_HEIGHT: 48,
            cv2.CAP_PROP_FPS: 100,
            cv2.CAP_PROP_FOURCC: int.from_bytes(b"YUYV", "little"),
        }
        assert {control: source.get(control) for control in held} == held


LOCKED = [
    (cv2.CAP_PROP_FOURCC, int.from_bytes(b"H264", "little"), "MJPG and is H264"),
    (cv2.CAP_PROP_FRAME_WIDTH, 640, "width"), (cv2.CAP_PROP_FRAME_HEIGHT, 480, "height"),
    (cv2.CAP_PROP_FPS, 90, "frames a second"), (cv2.CAP_PROP_AUTO_EXPOSURE, 3, "automatic exposure"),
    (cv2.CAP_PROP_EXPOSURE, 51, "exposure"), (cv2.CAP_PROP_AUTO_WB, 1, "automatic white balance"),
    (cv2.CAP_PROP_WB_TEMPERATURE, 4000, "white balance"), (cv2.CAP_PROP_GAIN, 1, "control"),
]  # fmt: skip


@pytest.mark.parametrize(("control", "kept", "name"), LOCKED)
def test_a_camera_that_refuses_a_setting_or_keeps_or_gets_another_is_refused(
    source, control, kept, name
) -> None:
    settings = replace(SETTINGS, controls={cv2.CAP_PROP_GAIN: 3.0})
    for another in (FakeVideoCapture(), source):
        if another is source:
            another.kept[control] = kept
        else:
            another.refused.add(control)
        assert name.split(" and is ")[0] in refused_open(another, settings)
    later = FakeVideoCapture()
    if control in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_EXPOSURE):  # as another program changes it
        with opened(later, settings) as camera:
            later.kept[control] = kept
            assert name in failure(camera)


def test_a_camera_without_white_balance_is_used_and_one_that_balances_by_itself_is_not(source):
    source.refused |= {cv2.CAP_PROP_AUTO_WB, cv2.CAP_PROP_WB_TEMPERATURE}
    settings = replace(SETTINGS, white_balance_k=None)
    with opened(source, settings) as camera:
        camera.grab(PATIENCE_S)
    another = FakeVideoCapture()
    another.kept[cv2.CAP_PROP_AUTO_WB] = 1
    assert "give white_balance_k" in refused_open(another, settings)


def test_a_camera_that_cannot_be_opened_is_told(source: FakeVideoCapture) -> None:
    source.opens = False
    assert "cannot be" in refused_open(source)
    another = FakeVideoCapture()
    another.error = cv2.error("VIDIOC_STREAMON: No space left on device")
    assert "VIDIOC_STREAMON" in refused_open(another)


# C1: dropped, duplicate, frozen, undecodable


def test_dropped_and_duplicate_frames_are_counted_and_duplicates_never_handed_out(camera, source) -> None:
    source.drop(4)
    until(lambda: camera.counts.dropped == 4)
    source.repeat(2)
    until(lambda: camera.counts.duplicate == 2)
    numbers = [number(camera.grab(PATIENCE_S)[1].image) for _ in range(3)]
    assert numbers == sorted(set(numbers))
    assert camera.counts.dropped == 4


def test_a_camera_that_froze_is_told(camera: UvcCamera, source: FakeVideoCapture) -> None:
    source.frozen = True
    assert "0.2 s" in failure(camera)
    assert camera.counts.duplicate >= 3


def test_frames_that_cannot_be_decoded_are_passed_over_until_there_are_ten_in_a_row(camera, source):
    source.tear(9)
    until(lambda: camera.counts.broken == 9)
    camera.grab(PATIENCE_S)
    assert camera.counts.dropped == 0
    source.tear(10)
    assert "10 frames" in failure(camera)


# C2: clocks that go back


def test_times_never_go_back_though_the_drivers_stamps_do(camera, source):
    first, _ = camera.grab(PATIENCE_S)
    source.turn_back(0.5)
    until(lambda: camera.counts.backwards == 1)
    second, _ = camera.grab(PATIENCE_S)
    assert second > first
    assert camera.counts.dropped == 0


# C3: size and format


@pytest.mark.parametrize("shape", [(24, 32, 3), (48, 64, 1)])
def test_a_frame_of_another_size_or_format_ends_the_frames(camera, source, shape):
    source.shape = shape
    assert "format changed" in failure(camera)


# C5: unplugged, hanging


def test_an_unplugged_camera_is_told_and_stays_gone(camera: UvcCamera, source: FakeVideoCapture) -> None:
    source.unplugged = True
    assert "unplugged" in failure(camera)
    source.unplugged = False
    assert "unplugged" in failure(camera)


def test_a_camera_that_hangs_is_told_in_time_and_let_go_of_when_it_ends(source, monkeypatch):
    monkeypatch.setattr("palpate.rig.real.uvc_camera._CLOSE_S", 0.1)
    camera = opened(source)
    source.resume.clear()
    assert source.hangs.wait(PATIENCE_S)
    asked = time.monotonic()
    with refused("no-frames", DeviceError, match=r"0\.1 s"):
        camera.grab(0.1)
    assert time.monotonic() - asked < PATIENCE_S
    camera.close()
    source.resume.set()
    assert source.released.wait(PATIENCE_S)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize(
    ("error", "said"), [(cv2.error("VIDIOC_DQBUF"), "VIDIOC_DQBUF"), (ZeroDivisionError(), "reading thread")]
)
def test_an_error_of_the_library_or_of_the_reading_thread_ends_the_frames(
    camera, source, error, said
) -> None:
    source.error = error
    assert said in failure(camera)


@pytest.mark.parametrize("timeout_s", [0.0, float("nan")])
def test_a_time_out_that_means_nothing_is_refused(camera: UvcCamera, timeout_s: float) -> None:
    with pytest.raises(RangeError, match="timeout_s"):
        camera.grab(timeout_s)


# Counting, without a camera


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (4, 6, 3), dtype=np.uint8)


@given(st.lists(st.integers(1, 5), min_size=1, max_size=50))
def test_the_rate_is_measured_and_gaps_are_dropped_frames(steps: list[int]) -> None:
    watch, period_ns = FrameWatch((6, 4), 50.0, 1.0), 20_000_000
    stamp_ns = 7 * period_ns
    assert watch.is_new(noise(0), stamp_ns, stamp_ns)
    assert watch.measured_rate_hz is None
    for i, step in enumerate(steps):
        stamp_ns += step * period_ns
        assert watch.is_new(noise(i + 1), stamp_ns, stamp_ns)
    assert watch.counts.dropped == sum(steps) - len(steps)
    assert watch.measured_rate_hz == pytest.approx(50.0 * len(steps) / sum(steps))


def test_two_equal_frames_a_long_time_apart_are_a_busy_computer_and_not_a_frozen_camera() -> None:
    watch = FrameWatch((6, 4), 50.0, 1.0)
    assert watch.is_new(noise(0), 0, 0)
    assert not watch.is_new(noise(0), 1, 60_000_000_000)
    assert watch.is_new(noise(1), 2, 60_020_000_000)


# Settings and addresses


@pytest.mark.parametrize(
    "wrong",
    [
        {"exposure_s": 0.0}, {"exposure_s": 5e-5}, {"exposure_s": 0.011, "rate_hz": 100.0},
        {"size_px": (0, 480)}, {"rate_hz": float("inf")}, {"freeze_s": 0.0}, {"white_balance_k": -1},
        {"delay_s": -0.1},
    ],
)  # fmt: skip
def test_settings_that_mean_nothing_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(RangeError):
        UvcSettings(**wrong)


def test_a_camera_is_found_by_number_path_or_serial_number_or_refused_with_those_that_are(tmp_path) -> None:
    folder = tmp_path / "by-id"
    folder.mkdir()
    for i, name in enumerate(("Maker_Eye_1234", "Maker_Eye_91234", "Maker_Eye_1", "Other_Eye_1")):
        (tmp_path / f"video{i}").touch()
        (folder / f"usb-{name}-video-index0").symlink_to(tmp_path / f"video{i}")
    (folder / "usb-Maker_Eye_1234-video-index1").symlink_to(tmp_path / "video0")
    assert device(3, folder) == 3
    assert device("/dev/video2", folder) == "/dev/video2"
    assert device("1234", folder) == str(tmp_path / "video0")
    assert device("91234", folder) == str(tmp_path / "video1")
    for serial in ("5678", "234", "", "*"):
        with refused("camera-not-found", DeviceError, match="Maker_Eye_1234"):
            device(serial, folder)
    with pytest.raises(DeviceError, match="2 cameras"):
        device("1", folder)
    with pytest.raises(DeviceError, match="none"):
        device("1234", tmp_path / "nowhere")


def test_a_real_camera_gives_frames() -> None:
    found = sorted(Path("/dev").glob("video*"))
    if not found:
        pytest.skip("no camera here: there is no /dev/video*")
    try:
        camera = UvcCamera(str(found[0]))
    except DeviceError as error:
        pytest.skip(f"this camera cannot do what is asked by default: {error}")
    with camera:
        _, frame = camera.grab(PATIENCE_S)
        assert frame.image.shape == (camera.size_px[1], camera.size_px[0], 3)


# Cameras of the machine: what each tells by Video4Linux, who uses it, and what keeps palpate from it.

MJPG = int.from_bytes(b"MJPG", "little")
YUYV = int.from_bytes(b"YUYV", "little")
SIZES = {MJPG: [(1280, 720), (640, 480)], YUYV: [(640, 480)]}
INTERVALS = {(1280, 720): [(1, 30)], (640, 480): [(1, 60), (1, 30), (1001, 30000)]}


def camera_says(handle: int, number: int, data: bytearray) -> int:
    """A camera's driver, written after the kernel's own header."""
    kind, size = number & 0xFFFF, number >> 16 & 0x3FFF
    assert size == len(data)
    if kind == 0x5600:
        can = struct.pack("<II", 0x84A00001, 0x04200001)
        data[:] = (
            b"uvcvideo".ljust(16, b"\0")
            + b"Tip camera".ljust(32, b"\0")
            + bytes(32)
            + bytes(4)
            + can
            + bytes(12)
        )
        return 0
    index, code = struct.unpack_from("<II", data)
    if kind == 0x5602:
        formats = [MJPG, YUYV]
        if index >= len(formats):
            raise OSError(errno.EINVAL, "no more")
        struct.pack_into("<I", data, 44, formats[index])
    elif kind == 0x564A:
        if index >= len(SIZES[code]):
            raise OSError(errno.EINVAL, "no more")
        struct.pack_into("<III", data, 8, 1, *SIZES[code][index])
    elif kind == 0x564B:
        intervals = INTERVALS[struct.unpack_from("<II", data, 8)]
        if index >= len(intervals):
            raise OSError(errno.EINVAL, "no more")
        struct.pack_into("<III", data, 16, 1, *intervals[index])
    return 0


@pytest.fixture
def system(tmp_path, monkeypatch) -> VideoSystem:
    """One USB camera, as the system's folders show it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()
    usb = tmp_path / "usb" / "1-2"
    (usb / "1-2:1.0").mkdir(parents=True)
    for name, text in (("idVendor", "046d"), ("idProduct", "0825"), ("serial", "4B2D")):
        (usb / name).write_text(text + "\n")
    for name in ("video0", "video10", "video2"):
        folder = tmp_path / "class" / name
        folder.mkdir(parents=True)
        (folder / "name").write_text(f"the {name}\n")
        (folder / "device").symlink_to(usb / "1-2:1.0")
        (tmp_path / "dev").mkdir(exist_ok=True)
        (tmp_path / "dev" / name).touch()
    (tmp_path / "class" / "v4l-subdev0").mkdir()
    (tmp_path / "proc").mkdir()
    return VideoSystem(tmp_path / "class", tmp_path / "dev", tmp_path / "proc", camera_says)


def test_a_camera_tells_name_serial_sizes_and_rates(system) -> None:
    first, second, third = list_cameras(system)
    assert [Path(one.path).name for one in (first, second, third)] == ["video0", "video2", "video10"]
    assert (first.name, first.serial, first.usb_id) == ("Tip camera", "4B2D", "046d:0825")
    assert (first.driver, first.used_by, first.advice) == ("uvcvideo", "", "")
    assert [(mode.pixels, mode.size_px, mode.rates_hz) for mode in first.modes] == [
        ("MJPG", (1280, 720), (30.0,)),
        ("MJPG", (640, 480), (60.0, 30.0, 29.97)),
        ("YUYV", (640, 480), (60.0, 30.0, 29.97)),
    ]
    assert 'ATTRS{serial}=="4B2D"' in first.udev
    assert 'SYMLINK+="palpate-4B2D"' in first.udev


def test_the_requests_are_those_of_the_kernel_s_header() -> None:
    numbers = ("QUERY_CAPABILITIES", "LIST_FORMATS", "LIST_SIZES", "LIST_INTERVALS")
    assert [hex(getattr(camera_listing, name)) for name in numbers] == [
        "0x80685600",
        "0xc0405602",
        "0xc02c564a",
        "0xc034564b",
    ]


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone has files of cameras")
def test_a_camera_that_is_not_there_is_refused_with_those_that_are(system, tmp_path) -> None:
    with refused("camera-not-found", DeviceError, match="video0"):
        refuse_absent(7, system)
    refuse_absent(2, system)
    refuse_absent(str(system.devices / "video10"), system)
    bare = replace(system, classes=tmp_path / "none")
    with refused("camera-not-found", DeviceError):
        refuse_absent(str(tmp_path / "video2"), bare)


def test_whoever_uses_a_camera_is_named(system) -> None:
    path = system.devices / "video2"
    folder = system.processes / "4321" / "fd"
    folder.mkdir(parents=True)
    (folder / "7").symlink_to(path)
    (system.processes / "4321" / "comm").write_text("cheese\n")
    assert ["4321" in one.used_by for one in list_cameras(system)] == [False, True, False]
    held = hold_device(camera_named(str(path)))
    assert str(os.getpid()) in list_cameras(system)[1].used_by
    held.release()
    assert "4321" in list_cameras(system)[1].used_by
    assert path_of(f"held {camera_named(str(path))}", None, "lock").is_file()
