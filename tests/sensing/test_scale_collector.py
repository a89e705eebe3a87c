"""Presses that a live sensor's process collects are labelled by a scale on a serial port, in its own unit."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from tests.rig.hand_scale import G0, HandScale
from tests.sensing.live_stand_ins import until

from palpate.core import DeviceError, Frame, InputError, Wrench
from palpate.recordings import Run
from palpate.sensing.collection.press_collector import PressCollector, ScaleCollector
from palpate.sensing.live_service import LiveOptions, LiveService


class Collector(PressCollector):
    """Stands for a `PressCollector`: keeps what it is given."""

    def __init__(self) -> None:
        self.told: list[object] = []

    def on_force(self, samples) -> None:
        self.told += [one.force_n[2] for one in samples]

    def on_frame(self, frame, readings=None) -> None:
        self.told.append(frame)

    def close(self) -> None:
        self.told.append("closed")


class Scale:
    """Says two samples each time, and is closed."""

    rate_hz, range_n = 10.0, (50.0, 50.0, 50.0)

    def latest(self) -> Wrench:
        return Wrench(0, (0.0, 0.0, self.count))

    def __init__(self) -> None:
        self.closed, self.count = False, 0.0

    def drain(self):
        self.count += 2
        return [Wrench(0, (0.0, 0.0, self.count + k)) for k in (-1.0, 0.0)]

    def close(self) -> None:
        self.closed = True


def test_the_scale_is_heard_before_each_frame_and_the_sensor_beside_never() -> None:
    collector, scale = Collector(), Scale()
    first, second = (Frame(np.zeros((2, 2), np.uint8), k) for k in (0, 1))
    with ScaleCollector(collector, scale) as both:
        both.on_frame(first)
        both.on_force([Wrench(0, (0.0, 0.0, 99.0))])
        both.on_frame(second)
    assert collector.told == [1.0, 2.0, first, 3.0, 4.0, second, "closed"]
    assert scale.closed


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX")
def test_bare_numbers_are_not_taken_for_grams_and_the_reason_is_told(tmp_path) -> None:
    from tests.rig.serial_terminal import FakeTerminal

    service = LiveService("live bare", LiveOptions(camera="virtual:tactip", runs=str(tmp_path), seed=0))
    service.start()
    try:
        until(lambda: not service.loop.zeroing and service.loop.untouched is not None, 60.0)
        with FakeTerminal(HandScale(lambda _: 1.0)) as terminal:
            service.collect({"run": "bare", "scale": terminal.path})
            until(lambda: any("carries no unit" in one for one in service.status()["faults"]), 60.0)
            assert service.status()["collect"]["force_N"] is None
            assert service.status()["collect"]["presses"] == 0
    finally:
        service.close()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX")
def test_presses_of_a_live_sensor_are_labelled_by_a_scale_in_the_unit_that_was_said(tmp_path) -> None:
    from tests.rig.serial_terminal import FakeTerminal

    service = LiveService("live scale", LiveOptions(camera="virtual:tactip", runs=str(tmp_path), seed=0))
    service.start()
    try:
        until(lambda: service.loop.source is not None, 60.0)
        with pytest.raises(InputError, match="unit"):
            service.collect({"run": "bad", "scale": str(tmp_path / "none"), "unit": "stone"})
        with pytest.raises(DeviceError):
            service.collect({"run": "bad", "scale": str(tmp_path / "none")})
        until(lambda: not service.loop.zeroing and service.loop.untouched is not None, 60.0)
        hand = service.loop.source.hand
        begun = hand.clock.now_ns() / 1e9
        kg = HandScale(lambda at_s: hand.force_at(at_s) if at_s > begun else 0.0, newtons=G0, tare_n=2.0)
        with FakeTerminal(kg, hand.clock) as terminal:
            service.collect({"run": "presses", "scale": terminal.path, "unit": "kg", "asked": 3})
            until(lambda: service.status()["collect"]["presses"] >= 3, 120.0)
            service.collect_stop()
        table = Run.open(tmp_path / "presses").labels
        held = table[table["force_N"] > 0.2]
        assert len(held) >= 6
        error = held["force_N"] - held["true_force_N"]
        assert np.abs(error).max() < 0.03 * held["true_force_N"].max() + 0.1
        assert np.abs(held["force_N"] / G0 - held["true_force_N"]).max() > 0.3  # in another unit it is wrong
    finally:
        service.close()
