"""The live loop: a camera's old frames are dropped and counted, a file's wait, and nothing ends it."""

from __future__ import annotations

import asyncio
import threading
import time

import numpy as np
import pytest
from tests.sensing.live_stand_ins import HandedFrames, MeanReader, numbered, until

from palpate.calibration.calibration_plan import ReferenceRule
from palpate.core import DeviceError, Drift, Frame
from palpate.core.device_protocols import Wrench
from palpate.estimators import Estimator
from palpate.recordings import export_folder
from palpate.sensing import live_loop, open_source, sense
from palpate.sensing.live_loop import LiveLoop, LiveReading, LiveState
from palpate.sensing.sensing_loop import Live, live
from palpate.sensing.streaming import live_slots, live_statistics
from palpate.sensing.streaming.live_image import ImageWatch
from palpate.sensing.streaming.live_slots import NewestSlot
from palpate.sensing.streaming.live_statistics import StatisticsKeeper
from palpate.sensors.owned import sensor_preset
from palpate.sensors.owned.sensor_preset import SkinInFrame


class Kept:
    """A subscriber that keeps what it is told."""

    def __init__(self, takes_s: float = 0.0) -> None:
        self.frames, self.values, self.forces, self.takes_s = [], [], [], takes_s

    def on_frame(self, frame, readings) -> None:
        time.sleep(self.takes_s)
        self.frames.append(frame.index)
        self.values.append(None if readings is None else readings["force_N"].value)

    def on_force(self, samples) -> None:
        self.forces += samples


class Raising(Kept):
    def on_frame(self, frame, readings) -> None:
        raise ValueError("of no use")


class Blocking(Kept):
    def __init__(self) -> None:
        super().__init__()
        self.release = threading.Event()

    def on_frame(self, frame, readings) -> None:
        self.release.wait(30)


class Steps:
    """A force sensor that gives what a test says."""

    rate_hz, range_n = 100.0, (10.0, 10.0, 10.0)

    def __init__(self) -> None:
        self.samples, self.gone = [], ""

    def latest(self):
        return self.samples[-1]

    def drain(self):
        if self.gone:
            raise DeviceError(self.gone)
        samples, self.samples = self.samples, []
        return samples

    def close(self) -> None:
        pass


def ran(source, reader=None, **options) -> LiveLoop:
    loop = LiveLoop(lambda: source, reader, source=source, **options)
    loop.start()
    return loop


def test_nothing_of_a_file_is_lost_however_slow_the_reading() -> None:
    source, kept = HandedFrames(waits=True), Kept(takes_s=0.002)
    source.give(*(numbered(i) for i in range(60)), None)
    with ran(source, MeanReader(0.003), subscribers=[kept]) as loop:
        assert loop.wait(5.0)
        assert loop.state is LiveState.ENDED
        assert (loop.stats.frames, loop.stats.dropped) == (60, 0)
    assert kept.frames == list(range(60))
    assert kept.values == [float(i) for i in range(60)]


def test_a_camera_s_old_frames_are_dropped_and_counted_and_the_newest_read() -> None:
    source, reader = HandedFrames(waits=False), MeanReader()
    reader.may_end.clear()
    with ran(source, reader) as loop:
        source.give(numbered(0))
        until(reader.started.is_set)
        source.give(*(numbered(i) for i in range(1, 8)))
        reader.may_end.set()
        until(lambda: loop.stats.frames == 2)
        assert reader.read_numbers == [0, 7]
        assert loop.stats.dropped == 6


def test_a_rate_is_of_the_last_five_seconds_also_when_nothing_comes_any_more() -> None:
    now_ns = time.monotonic_ns()
    for silent_s, told_hz in ((0.02, 50.0), (0.9, 50.0), (2.0, 30.0), (4.0, 10.0), (6.0, None)):
        kept = StatisticsKeeper()
        for i in range(500):
            kept.arrived(now_ns - round(1e9 * (silent_s + (499 - i) / 50)), 0, 0)
        found = kept.now().rate_hz
        assert found == (told_hz if told_hz is None else pytest.approx(told_hz, rel=0.05)), silent_s


def test_a_camera_that_comes_back_is_opened_again(monkeypatch) -> None:
    monkeypatch.setattr(live_loop, "REOPEN_S", 0.02)
    first, second = HandedFrames(waits=False), HandedFrames(waits=False)
    tries = []

    def opener():
        tries.append(1)
        if len(tries) < 3:
            raise DeviceError("0 cameras have the serial number 'A1'")
        return second

    with LiveLoop(opener, MeanReader(), source=first) as loop:
        loop.start()
        first.give(numbered(0))
        until(lambda: loop.stats.frames == 1)
        first.gone = "it gives no frame: it was unplugged"
        first.give()
        until(lambda: loop.state is LiveState.LOST)
        assert "unplugged" in loop.why or "serial number" in loop.why
        until(lambda: len(tries) == 3)
        second.give(numbered(0))
        until(lambda: loop.state is LiveState.LIVE)
        until(lambda: loop.stats.frames == 2)
        assert (loop.why, first.closed) == ("", 1)
        assert loop.status()["outages"] == 1


def test_a_silent_camera_is_lost_and_a_silent_file_is_waited_for(monkeypatch) -> None:
    monkeypatch.setattr(live_loop, "SILENT_S", 0.1)
    monkeypatch.setattr(live_loop, "GRAB_S", 0.02)
    camera, file = HandedFrames(waits=False), HandedFrames(waits=True)
    with ran(camera) as lost, ran(file) as waiting:
        until(lambda: lost.state is LiveState.LOST)
        assert waiting.state is LiveState.OPENING
        assert "nothing yet" in lost.why


def test_a_subscriber_that_raises_is_dropped_and_named_and_the_rest_are_told() -> None:
    source, kept = HandedFrames(waits=True), Kept()
    source.give(*(numbered(i) for i in range(5)), None)
    with ran(source, subscribers=[Raising(), kept]) as loop:
        assert loop.wait(5.0)
        until(lambda: loop.faults)
        (fault,) = loop.faults
    assert fault.startswith("Raising raised ValueError: of no use")
    assert kept.frames == list(range(5))


def test_a_subscriber_that_blocks_is_dropped_and_named_and_the_loop_goes_on(monkeypatch) -> None:
    monkeypatch.setattr(live_slots, "BLOCKED_S", 0.1)
    source, kept, blocking = HandedFrames(waits=True), Kept(), Blocking()
    source.give(*(numbered(i) for i in range(80)), None)
    with ran(source, subscribers=[blocking, kept]) as loop:
        assert loop.wait(5.0)
        (fault,) = loop.faults
        assert "Blocking did" in fault
        assert loop.stats.frames == 80
    assert kept.frames == list(range(80))
    blocking.release.set()


def test_a_reader_that_fails_is_a_named_state() -> None:
    class Failing(MeanReader):
        def read(self, live):
            raise RuntimeError("no such tensor")

    source = HandedFrames(waits=True)
    source.give(numbered(0), numbered(1), None)
    with ran(source, Failing()) as loop:
        assert loop.wait(5.0)
        assert loop.state is LiveState.FAILED
        assert "tensor [internal]" in loop.why


def test_the_untouched_image_is_the_mean_of_frames_and_is_taken_off() -> None:
    source, reader = HandedFrames(waits=True), MeanReader()
    source.give(*(numbered(i, level=level) for i, level in enumerate([10, 12, 14, 50])), None)
    with ran(source, reader, zero_at_start=True, zero_frames=3) as loop:
        assert loop.wait(5.0)
        assert [float(zero.mean()) for zero in reader.zeros] == [12.0]
        assert loop.latest.readings["force_N"].value == pytest.approx(38.0)
        assert not loop.zeroing


def frame_of(image: np.ndarray, number: int) -> Frame:
    grey = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return Frame(grey, number / 30, index=number, arrived_ns=time.monotonic_ns())


def test_a_picture_without_a_calibration_is_watched_where_the_preset_says_that_the_skin_lies() -> None:
    rng, source = np.random.default_rng(0), HandedFrames(waits=True)
    part = SkinInFrame(region_share=(0.5, 0.0, 0.5, 1.0), region_mm=(6.0, 9.0), assumed=True)
    half = sensor_preset("own").model_copy(update={"skin": part})
    frames = [frame_of(rng.normal(100, 1, (96, 128)), i) for i in range(8)]
    source.give(*frames, None)
    with ran(source, zero_at_start=True, zero_frames=8) as loop:
        whole, known = ImageWatch(loop), ImageWatch(loop, half)
        assert loop.wait(5.0)
        beside, within = rng.normal(100, 1, (2, 96, 128))
        beside[20:50, 10:40] += 40
        within[20:50, 90:120] += 40
        for image, verdict in ((beside, "untouched"), (within, "touched")):
            for watch in (whole, known):
                watch._next_s = 0.0
                watch.on_frame(frame_of(image, 9), None)
            assert whole.status()["verdict"] == "touched"
            assert known.status()["verdict"] == verdict
        assert known.status()["centre_mm"] == pytest.approx([(104.5 - 95.5) * 6 / 64, -13 * 6 / 64], abs=0.1)
        assert known.overlay["lines"][0]["points"] == [[64, 0], [128, 0], [128, 96], [64, 96]]
        assert [line["role"] for line in known.overlay["lines"]] == ["skin", "region"]


@pytest.mark.parametrize("rate_hz", [10.0, 1000.0])
def test_bias_of_force_is_of_the_moment_of_the_zero_at_any_rate_of_samples(rate_hz: float) -> None:
    force = Steps()
    source = HandedFrames(waits=True, force=force)
    at_s = np.arange(0, 12, 1 / rate_hz)
    raw_n = np.where(at_s < 11, 5.25, 0.25)  # pressed for long, let go of for a second, then zeroed
    with ran(source, MeanReader(), zero_frames=1) as loop:
        force.samples = [
            Wrench(round(1e9 * t), (0.0, 0.0, f)) for t, f in zip(at_s, raw_n.tolist(), strict=True)
        ]
        until(lambda: loop.status()["force_N"] == 0.25)
        loop.zero()
        source.give(numbered(0))
        until(lambda: loop.status()["force_N"] == 0.0)


def test_no_force_is_told_while_its_first_zero_is_being_taken() -> None:
    """Its bias would stand as newtons beside an untouched sensor."""
    force, kept = Steps(), Kept()
    source = HandedFrames(waits=True, force=force)
    with ran(source, MeanReader(), subscribers=[kept], zero_at_start=True, zero_frames=2) as loop:
        force.samples = [Wrench(i, (0.0, 0.0, 1.7)) for i in range(5)]
        until(lambda: len(kept.forces) == 5)
        assert loop.zeroing
        assert loop.status()["force_N"] is None
        source.give(numbered(0), numbered(1))
        until(lambda: loop.status()["force_N"] == 0.0)
        loop.zero()  # and again: what was zeroed once is told all the while
        force.samples = [Wrench(9, (0.0, 0.0, 2.7))]
        until(lambda: loop.status()["force_N"] == pytest.approx(1.0))
        assert loop.zeroing


def test_force_beside_the_camera_is_told_and_its_bias_leaves_with_the_zero() -> None:
    force, kept = Steps(), Kept()
    source = HandedFrames(waits=True, force=force)
    with ran(source, MeanReader(), subscribers=[kept], zero_frames=1) as loop:
        force.samples = [Wrench(i, (0.0, 0.0, 2.0)) for i in range(5)]
        until(lambda: loop.status()["force_N"] == 2.0)
        loop.zero()
        source.give(numbered(0))
        until(lambda: loop.status()["force_N"] == 0.0)
        force.samples = [Wrench(9, (0.0, 0.0, 5.5)), Wrench(10, (0.0, 0.0, 99.0), fault="saturated")]
        until(lambda: loop.status()["force_N"] == 3.5)
        force.gone = "the force sensor does not answer"
        until(lambda: loop.faults)
        source.give(numbered(1), None)
        assert loop.wait(5.0)
        assert loop.status()["force_N"] is None
        assert loop.stats.frames == 2
    assert [one.time_ns for one in kept.forces] == [0, 1, 2, 3, 4, 9, 10]


@pytest.mark.parametrize(
    ("differential", "drifted", "valid", "kind", "action"),
    [
        (True, True, True, "", "re-zero"),
        (False, True, True, "", "adapt"),
        (True, False, False, "focus", "refocus"),
        (False, False, False, "shift", "adapt"),
        (True, False, False, "shift", "re-zero"),
        (False, False, False, "exchanged channels", "exchange"),
        (True, False, False, "mirrored-x", "flip"),
    ],
)
def test_advice_follows_the_guard(monkeypatch, differential, drifted, valid, kind, action) -> None:
    monkeypatch.setattr(live_statistics, "LOOK_S", 1e-6)
    reader = MeanReader(differential=differential)
    reader.drifts = Drift(5.0 if drifted else 1.0, 3.0)
    reader.kind, reader.valid = kind, valid
    source = HandedFrames(waits=True)
    source.give(*(numbered(i) for i in range(25)), None)
    with ran(source, reader) as loop:
        assert loop.wait(5.0)
        assert loop.status()["drift"]["action"] == action
        assert loop.advice.startswith(action)
        if action == "re-zero":
            loop.zero(np.zeros((4, 6), np.uint8))
            assert loop.advice == ""


def test_a_slow_consumer_gets_the_newest_of_a_camera_and_all_of_a_file() -> None:
    for waits, expected in ((False, [0, 9]), (True, list(range(10)))):
        source, slot = HandedFrames(waits=waits), NewestSlot[LiveReading]()
        loop = LiveLoop(lambda source=source: source, MeanReader(), source=source, hand_over=slot)
        with Live(loop, slot) as readings:
            numbers = []
            source.give(numbered(0))
            for reading in readings:
                numbers.append(reading.number)
                if len(numbers) == 1:
                    source.give(*(numbered(i) for i in range(1, 10)), None)
                    time.sleep(0.15)
            assert numbers == expected


def test_readings_come_in_an_async_loop() -> None:
    source, slot = HandedFrames(waits=True), NewestSlot[LiveReading]()
    source.give(*(numbered(i) for i in range(4)), None)
    loop = LiveLoop(lambda: source, MeanReader(), source=source, hand_over=slot)

    async def read() -> list[int]:
        async with Live(loop, slot) as readings:
            return [reading.number async for reading in readings]

    assert asyncio.run(read()) == [0, 1, 2, 3]
    assert source.closed == 1


@pytest.fixture
def spots(calibrate_spots, record_spots, tmp_path):
    plan = {"presses": 9, "targets": ("x_mm",), "split": "group:press", "size_px": (24, 32)}
    return calibrate_spots(tmp_path / "cal", **plan)[1], record_spots("fresh", 2, seed=4)


def test_live_gives_the_readings_of_sense_frame_by_frame(spots, tmp_path) -> None:
    calibration, run = spots
    export_folder(run, tmp_path / "exported")
    estimator = Estimator.open(calibration, threads=1)
    for path in (run.path, tmp_path / "exported" / "images"):
        expected = [sensed.to_dict() for sensed in sense(estimator, open_source(path))]
        with live(calibration, camera=path, idle_s=0.2) as readings:
            found = [reading.to_dict() for reading in readings]
        assert len(found) == 12
        assert [{key: one[key] for key in expected[0]} for one in found] == expected


def test_a_differential_calibration_says_that_it_needs_a_zero(
    calibrate_spots, record_spots, tmp_path
) -> None:
    plan = {"presses": 9, "targets": ("x_mm",), "split": "group:press", "size_px": (24, 32), "delta": True}
    plan["reference"] = ReferenceRule.parse("reference=true", ("press",))
    calibration = calibrate_spots(tmp_path / "delta", **plan)[1]
    run = record_spots("fresh", 2, seed=4)
    export_folder(run, tmp_path / "exported")
    with live(calibration, camera=tmp_path / "exported" / "images", idle_s=0.2) as readings:
        first = next(readings)
        assert not first.readings["x_mm"].valid
        assert "zero it" in readings.advice
        readings.zero(run.frame(0).image)
        values = [reading.readings["x_mm"].valid for reading in readings]
    assert any(values)
    with live(calibration, camera=run.path) as readings:  # a run has its own
        from_run = [reading.to_dict()["readings"] for reading in readings]
    expected = [
        one.to_dict()["readings"] for one in sense(Estimator.open(calibration), open_source(run.path))
    ]
    assert from_run == expected


def test_the_force_beside_a_reading_is_that_of_its_frame_and_not_of_when_it_was_read() -> None:
    """On a ramp of 20 N/s a frame that is told a tenth of a second late would stand beside 2 N too many."""
    force = Steps()
    source = HandedFrames(waits=True, force=force)
    at_s = np.arange(0.0, 0.5, 0.005)
    with ran(source, MeanReader()) as loop:
        force.samples = [Wrench(round(1e9 * t), (0.0, 0.0, 20 * t)) for t in at_s.tolist()]
        until(lambda: loop.status()["force_N"] is not None)
        for time_s, expected in (
            (0.4, 8.0),
            (0.4025, 8.05),
            (9.0, 20 * at_s[-1]),
        ):
            source.give(numbered(0, time_s=time_s))
            until(lambda: loop.latest is not None and loop.latest.time_s == time_s)  # noqa: B023
            assert loop.latest.force_n == pytest.approx(expected)
            assert loop.status()["reading"]["force_N"] == pytest.approx(expected)
