"""Commissioning verbs: what ends them, what they refuse, and what a camera's rate is."""

import os
import signal
from typing import Any

import numpy as np
import pytest
from tests.rig.lab_files import lab_file

from palpate.cli.record.rig_hand_verbs import stopped_by_signals
from palpate.core import NS_PER_S, DeviceError, Frame, InputError, ManualClock, PalpateError, Wrench
from palpate.devices import Mounting
from palpate.devices.device_proxies import driver_errors
from palpate.rig.commissioning.bench import Bench, frame_times
from palpate.rig.commissioning.hand_motion import discard
from palpate.rig.rig_file import MarlinPart, open_rig


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_process_that_is_told_to_end_stops_as_by_ctrl_c(name: str) -> None:
    number = getattr(signal, name)
    kept = signal.signal(number, signal.SIG_DFL)  # nohup, under which tests may run, has one ignored
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), stopped_by_signals():
        os.kill(os.getpid(), number)
    assert signal.getsignal(number) is before
    signal.signal(number, kept)


BOX = {"least_mm": [-1, -1, -1], "greatest_mm": [1, 1, 1]}


@pytest.mark.parametrize("homes", [False, True])
def test_a_marlin_stage_homes_only_where_its_file_says_that_it_may(homes: bool) -> None:
    fields = {"kind": "marlin", "port": "p", "home": homes} | BOX
    part = MarlinPart.model_validate(fields if homes else fields | {"reference": [0, 0, 0]})
    bench = Bench("printer", ManualClock(), Mounting(), None, (0.0, 0.0, 0.0), stage_part=part)
    if homes:
        bench.check_may_home()
    else:
        with pytest.raises(InputError, match="nothing moved"):
            bench.check_may_home()


class ClockedCamera:
    """A camera whose frames end at whole periods; `grab` waits for a whole exposure, as all do."""

    size_px = (4, 4)

    def __init__(self, clock: ManualClock, rate_hz: float, stated_hz: float) -> None:
        self._clock, self._period_ns, self.rate_hz = clock, round(NS_PER_S / rate_hz), stated_hz
        self._given = 0

    def _frame(self, index: int) -> tuple[int, Frame]:
        self._given = index
        return index * self._period_ns, Frame(np.zeros((4, 4), np.uint8))

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        index = self._clock.now_ns() // self._period_ns + 2
        self._clock.sleep((index * self._period_ns - self._clock.now_ns()) / NS_PER_S)
        return self._frame(index)

    def drain(self) -> list[tuple[int, Frame]]:
        newest = self._clock.now_ns() // self._period_ns
        return [self._frame(index) for index in range(self._given + 1, newest + 1)]

    def close(self) -> None: ...


@pytest.mark.parametrize("rate_hz", [12.0, 20.0, 30.0, 100.0])
def test_the_rate_of_a_camera_is_that_of_all_its_frames(rate_hz: float) -> None:
    clock = ManualClock(NS_PER_S)
    times = frame_times(ClockedCamera(clock, rate_hz, 30.0), clock, 1.0)
    assert (len(times) - 1) * NS_PER_S / (times[-1] - times[0]) == pytest.approx(rate_hz, rel=1e-6)


class ForeignExit(BaseException):
    """What no `except Exception` catches, as a cancelled task or a panic of another language."""


def test_whatever_a_driver_raises_is_an_error_of_the_device() -> None:
    with pytest.raises(PalpateError, match="ForeignExit"), driver_errors("the driver failed"):
        raise ForeignExit
    with pytest.raises(KeyboardInterrupt), driver_errors("the driver failed"):
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"greatest_mm": [-10, 90, 900]}, "travel"),
        ({"least_mm": [-90, 10, 36]}, "must be"),
        ({"force_N": 50.0}, "force_N"),
    ],
)
def test_a_file_that_homes_is_judged_before_it_does(tmp_path, limits: dict[str, Any], said: str) -> None:
    with lab_file(tmp_path) as lab:
        page = {"stage": {"home": True, "reference": None}, "limits": limits}
        lab.fields["stage"].pop("reference")
        page["stage"].pop("reference")
        if "force_N" in limits:
            page["force"] = {"axes": ["z", "y", "-x"]}  # along which it measures 30 N at most
        with pytest.raises(PalpateError, match=said):
            open_rig(lab.write(**page), supervised=False)
        assert not lab.jogged


class Overflowing:
    """A force sensor whose samples nobody fetched for long; it says so once, as drivers do."""

    rate_hz, range_n = 100.0, (10.0, 10.0, 10.0)

    def __init__(self, times: int) -> None:
        self._left = times

    def drain(self) -> list[Any]:
        if self._left:
            self._left -= 1
            raise DeviceError("12078 samples were overwritten")
        return []

    def latest(self) -> Wrench:
        return Wrench(0, (0.0, 0.0, 0.0))

    def close(self) -> None: ...


def test_what_came_while_a_person_read_is_dropped_and_a_failed_sensor_is_told() -> None:
    discard(Overflowing(1))
    with pytest.raises(DeviceError):
        discard(Overflowing(2))
