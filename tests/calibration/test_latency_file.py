"""The latency of a camera as a file, of presses that agree and of such that do not."""

import json
from dataclasses import replace

import pytest

from palpate.calibration.compliance.latency_file import CameraLatency, latency_record
from palpate.core import InputError, RangeError
from palpate.estimators.compliance.press_latency import PressLatency

PRESS = PressLatency(0.04, 0.038, 0.042, 1e-3, 40.0, 0.99, 0.999, 5.0)


def written(tmp_path, *seconds):
    used = {f"{k}": replace(PRESS, seconds=one) for k, one in enumerate(seconds)}
    path = tmp_path / "latency.json"
    path.write_text(json.dumps(latency_record(used, {}), allow_nan=False))
    return path


def test_the_file_gives_back_what_presses_agree_on(tmp_path) -> None:
    found = CameraLatency.load(written(tmp_path, 0.0398, 0.0402))
    assert found.seconds == pytest.approx(0.04)
    assert found.sd_s == pytest.approx(1e-3 / 2**0.5)


def test_presses_without_one_latency_are_not_taken_off(tmp_path) -> None:
    with pytest.raises(InputError, match=r"not valid: presses differ by"):
        CameraLatency.load(written(tmp_path, 0.02, 0.04, 0.09))


def test_a_latency_is_a_finite_time() -> None:
    with pytest.raises(RangeError, match="finite"):
        CameraLatency(float("nan"), 0.0)
