"""Presets of sensors that people own: sourced values only, recognised cameras, and files of one's own."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.fakes.video_capture import FakeVideoCapture
from tests.refusals import refused

from palpate.core import ExistsError, InputError, RangeError
from palpate.rig.real.uvc_camera import UvcCamera, UvcSettings, device
from palpate.sensing.untouched_view import UntouchedView
from palpate.sensors.owned import (
    read_preset,
    recognised_preset,
    sensor_preset,
    write_own_preset,
)

NAMES = ("9dtact", "digit", "gelsight-mini", "own", "tactip", "tactip-127")


def changed(tmp_path: Path, name: str, was: str, becomes: str) -> Path:
    """A preset's file with one thing changed."""
    text = Path(__file__).parents[2].joinpath(f"src/palpate/sensors/owned/presets/{name}.toml").read_text()
    assert text.count(was) == 1
    path = tmp_path / f"{name}.toml"
    path.write_text(text.replace(was, becomes))
    return path


@pytest.mark.parametrize("name", NAMES)
def test_each_value_has_a_source_with_an_address_or_is_said_to_be_assumed(name: str) -> None:
    preset = sensor_preset(name)
    parts = [preset.camera, *preset.camera.modes, preset.camera.settings, preset.skin, preset.marks]
    for part in [*parts, *preset.facts]:
        assert part.assumed != (part.source is not None)
        assert part.source is None or preset.sources[part.source].what
    cited = {part.source for part in [*parts, *preset.facts]} - {None}
    in_notes = {one for one in preset.sources for part in parts if f"[{one}]" in part.note}
    assert set(preset.sources) - cited - in_notes <= {"paper"}  # a paper may stand for the whole


@pytest.mark.parametrize(
    ("told", "usb", "name"),
    [
        ("GelSight Mini R0B 2BNN-4ZE7: Ge", "", "gelsight-mini"),
        ("USB Camera", "0C45:636D", "gelsight-mini"),
        ("DIGIT: DIGIT", "", "digit"),
        ("", "2833:0209", "digit"),
        ("Integrated Webcam", "0c45:6366", None),
        ("Digital Microscope", "", None),
        ("GelSight Minimal", "", None),
        ("", "", None),
    ],
)
def test_a_camera_is_recognised_by_its_name_or_usb_numbers_and_no_other(
    told: str, usb: str, name: str | None
) -> None:
    found = recognised_preset(told, usb)
    assert (found and found.name) == name


def test_the_mini_s_scale_is_the_same_length_at_every_size_of_frame() -> None:
    mini = sensor_preset("gelsight-mini")
    assert mini.skin.region_mm == pytest.approx((0.0634 * 320, 0.0634 * 240))
    for size in ((3280, 2464), (640, 480)):
        x, y, width, height = mini.region_px(size)
        assert x == pytest.approx(size[0] / 7, abs=1)
        assert y == pytest.approx(size[1] / 7, abs=1)
        scale = mini.mm_per_px(size)
        assert scale is not None
        assert scale * width == pytest.approx(20.288, rel=2e-3)
        assert scale * height == pytest.approx(15.216, rel=2e-3)
    with pytest.raises(RangeError, match="not squeezed"):
        mini.mm_per_px((480, 480))


def test_a_region_lies_inside_its_frame_and_without_one_is_the_whole() -> None:
    for name in NAMES:
        for width, height in ((640, 480), (321, 239), (3280, 2464)):
            x, y, wide, high = sensor_preset(name).region_px((width, height))
            assert 0 <= x < x + wide <= width
            assert 0 <= y < y + high <= height
    assert sensor_preset("9dtact").region_px((640, 480)) == (90, 68, 460, 345)
    assert sensor_preset("digit").region_px((320, 240)) == (0, 0, 320, 240)
    assert sensor_preset("digit").mm_per_px((320, 240)) is None


@pytest.mark.parametrize(
    ("name", "was", "becomes", "says"),
    [
        ("digit", 'source = "paper"', "", "source"),
        ("digit", 'source = "paper"', 'source = "paper"\nassumed = true', "give one of"),
        ("digit", '"2833:0209"', '"2833-0209"', "camera.usb"),
        ("gelsight-mini", "region_mm = [20.288, 15.216]", "region_mm = [inf, 15.2]", "region_mm"),
        ("gelsight-mini", "[0.142857, 0.142857, 0.714286, 0.714286]", "[0.5, 0.1, 0.7, 0.7]", "inside"),
        ("gelsight-mini", "gain = 0.0", "gian = 0.0", "gian"),
        ("gelsight-mini", 'name = "gelsight-mini"', 'name = "../mini"', "name"),
    ],
)
def test_a_file_that_is_wrong_is_refused_and_the_field_named(
    tmp_path: Path, name: str, was: str, becomes: str, says: str
) -> None:
    with refused("file-field", InputError, match=says):
        read_preset(changed(tmp_path, name, was, becomes))


def test_a_file_of_one_s_own_begins_with_all_fields_and_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "My gel.toml"
    write_own_preset(path)
    assert read_preset(path).name == "my-gel"
    with pytest.raises(ExistsError):
        write_own_preset(path)
    with pytest.raises(InputError, match="toml"):
        write_own_preset(tmp_path / "gel.json")
    filled = path.read_text().replace("# region_", "region_")
    path.write_text(filled)
    assert read_preset(path).mm_per_px((640, 480)) == pytest.approx(20 / 512)
    with pytest.raises(InputError, match="gelsight-mini"):
        read_preset("gelsight")


def test_a_digit_is_opened_by_the_serial_number_on_its_back_and_shows_touch_without_a_calibration(
    tmp_path: Path,
) -> None:
    """Its video node among those of others; frames from a camera that is not there."""
    folder = tmp_path / "by-id"
    folder.mkdir()
    for i, name in enumerate(("DIGIT_D12345", "DIGIT_D12346")):
        (tmp_path / f"video{i}").touch()
        (folder / f"usb-Facebook_{name}-video-index0").symlink_to(tmp_path / f"video{i}")
    where = device("D12346", folder)
    assert where == str(tmp_path / "video1")
    digit = sensor_preset("digit")
    mode = digit.camera.modes[1]
    settings = UvcSettings(size_px=mode.size_px, rate_hz=mode.rates_hz[0], exposure_s=5e-3)
    source = FakeVideoCapture(mode.size_px, rate_hz=mode.rates_hz[0])
    with UvcCamera(where, settings, opener=lambda _: source) as camera:
        still = [camera.grab(timeout_s=10.0)[1].image for _ in range(6)]
        view = UntouchedView(still, region=digit.region_px(mode.size_px), false_alarm_rate=1e-6)
        frame = camera.grab(timeout_s=10.0)[1].image
    assert view.seen(frame).verdict == "untouched"
    pressed = frame.copy()
    rows, columns = np.mgrid[:240, :320]
    pressed[np.hypot(rows - 100, columns - 200) < 30, 0] += 40
    seen = view.seen(pressed)
    assert seen.verdict == "touched"
    assert seen.region is not None
    assert seen.region.centre_px == pytest.approx((200, 100), abs=1)
    assert json.loads(json.dumps(seen.to_dict()))["region"]["centre_px"] == list(seen.region.centre_px)


def gel(seed: int, tilt: float = 0.0) -> np.ndarray:
    """A gel lit from three sides in three colours, 640 x 480; a print of 2 mm radius may tilt its skin.

    A skin of slope s facing a lamp at an angle is brighter by the slope along the lamp's direction.
    """
    rows, columns = np.mgrid[:480, :640].astype(float)
    x, y, radius = columns - 380, rows - 200, 2.0 / 0.0444
    inside = np.hypot(x, y) < radius
    lamps = [(1.0, 0.0), (-0.5, 0.87), (-0.5, -0.87)]
    light = [110 + 20 * (a * columns / 640 + b * rows / 480) for a, b in lamps]
    slope = [-tilt * inside * (a * x + b * y) / radius for a, b in lamps]
    image = np.stack([one + 60 * s for one, s in zip(light, slope, strict=True)], axis=2)
    noisy = image + np.random.default_rng(seed).normal(0, 2, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def test_a_made_gel_like_the_mini_s_shows_a_ball_s_print_in_millimetres() -> None:
    mini = sensor_preset("gelsight-mini")
    view = UntouchedView.of_preset(mini, [gel(i) for i in range(8)])
    assert view.seen(gel(20)).verdict == "untouched"
    seen = view.seen(gel(21, tilt=1.0))
    assert seen.verdict == "touched"
    assert seen.region is not None
    scale = mini.mm_per_px((640, 480))
    assert scale is not None
    left, top, width, height = mini.region_px((640, 480))
    middle = (scale * (380 - left - (width - 1) / 2), scale * (200 - top - (height - 1) / 2))
    assert seen.region.centre_mm == pytest.approx(middle, abs=0.1)
    assert seen.region.area_mm2 == pytest.approx(np.pi * 2.0**2, rel=0.15)  # its slope fades to the middle
    assert (seen.region.strength > 5) == (view.seen(gel(22, tilt=0.3)).region is not None)
