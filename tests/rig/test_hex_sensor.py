"""HEX six-axis sensors: where a sample begins is never guessed, and what goes wrong is told."""

import math
import struct
import time
from contextlib import ExitStack

import pytest
from hypothesis import given, strategies as st
from tests.fakes.hex_box import HexBox, HexFaults
from tests.refusals import refused
from tests.rig.serial_terminal import FakeTerminal

from palpate.core import DeviceError, MonotonicClock, RangeError
from palpate.devices.check import check_force_sensor
from palpate.rig.real.resense import HexSensor, HexSpec
from palpate.rig.real.resense.hex_sensor import SAMPLE_BYTES, TRIED, HexFrames
from palpate.rig.rig_file import RigFile

LOAD = (1.5, -0.25, 6.0, 0.020, -0.010, 0.003)


def bytes_of(box: HexBox, until_s: float) -> bytes:
    box.run_to(until_s)
    return box.take()


def frames() -> HexFrames:
    return HexFrames(1000.0, 50.0, 1.0)


def read(box: HexBox, seconds: float, stream: HexFrames | None = None, piece_bytes: int = 0) -> list:
    """Samples of a box whose host looks every 2 ms, or is given pieces of so many bytes."""
    stream, samples, kept = stream or frames(), [], b""
    for k in range(1, round(seconds / 0.002)):
        data = kept + bytes_of(box, k * 0.002)
        whole = len(data) // piece_bytes * piece_bytes if piece_bytes else len(data)
        kept = data[whole:]
        samples += stream.take(data[:whole], 10**9 + k * 2_000_000)
    return samples


def sample_of(fx: float, fy: float, fz: float, celsius: float) -> bytes:
    return struct.pack("<7f", fx, fy, fz, 1.0, 2.0, 3.0, celsius)


class TestWhereASampleBegins:
    @pytest.mark.parametrize("cut", range(0, SAMPLE_BYTES, 5))
    def test_it_is_found_wherever_the_port_was_opened(self, cut):
        samples = read(HexBox(lambda t: LOAD, cut=cut), 0.2)
        assert len(samples) >= 150
        for one in samples:
            assert one.force_n == pytest.approx(LOAD[:3], abs=0.05)
            assert one.torque_nm == pytest.approx(LOAD[3:], abs=5e-4)

    @pytest.mark.parametrize("axis", [2, 5])
    def test_a_load_that_could_be_a_temperature_is_told_apart_by_pauses_alone(self, axis):
        load = [0.0] * 6
        load[axis] = 26.0 if axis < 3 else 26e-3
        samples = read(HexBox(lambda t: tuple(load)), 0.2)
        assert len(samples) >= 150
        assert all(one.force_n == pytest.approx(load[:3], abs=0.05) for one in samples)
        # An adapter that cuts the stream where it likes leaves no pauses before beginnings.
        assert read(HexBox(lambda t: tuple(load)), 1.5, stream := frames(), piece_bytes=62) == []
        assert "tare button" in str(stream.failure)

    @given(data=st.lists(st.integers(0, 255), max_size=400))
    def test_no_bytes_whatever_break_it(self, data):
        stream = frames()
        for one in stream.take(bytes(data), 10**9):
            assert all(map(math.isfinite, one.force_n)) or one.fault

    @pytest.mark.parametrize("every", [997])
    def test_a_lost_byte_costs_samples_and_gives_no_wrong_one(self, every):
        box, stream = HexBox(lambda t: LOAD, faults=HexFaults(lose_every=every)), frames()
        samples = read(box, 4.0, stream)
        assert len(samples) > 1500
        assert stream.counts.resets >= 4 * 28_000 // every // 2
        for one in samples:
            assert one.force_n == pytest.approx(LOAD[:3], abs=0.05)

    def test_bytes_without_any_sample_are_another_device(self):
        stream = frames()
        for k in range(200):
            stream.take(b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n", k)
        assert "HEX sensor's" in str(stream.failure)

    def test_raw_signals_are_not_taken_for_newtons(self):
        stream = frames()
        assert read(HexBox(lambda t: LOAD, faults=HexFaults(raw=True)), 0.5, stream) == []
        assert "matrix light" in str(stream.failure)


class TestSamples:
    def test_those_that_arrive_together_lie_a_period_apart_and_end_now(self):
        stream = frames()
        stream.take(bytes_of(box := HexBox(), 0.1), 10**9)
        samples = stream.take(bytes_of(box, 0.11), 2 * 10**9)
        assert [2 * 10**9 - one.time_ns for one in samples] == [
            (len(samples) - 1 - k) * 1_000_000 for k in range(len(samples))
        ]

    @pytest.mark.parametrize(("fz", "fault"), [(math.nan, "not-a-number"), (-50.1, "force-range")])
    def test_what_is_no_force_is_a_fault_and_no_number(self, fz, fault):
        stream = frames()
        stream.take(sample_of(0.0, 0.0, 0.0, 25.0) * (TRIED + 2), 1)
        (one,) = stream.take(sample_of(0.0, 0.0, fz, 25.0), 2)
        assert one.fault == fault
        assert all(map(math.isnan, one.force_n))


@pytest.mark.skipif(not hasattr(__import__("os"), "openpty"), reason="the fake's port is a pseudo-terminal")
class TestOpened:
    @pytest.fixture
    def bench(self):
        with ExitStack() as stack:

            def make(box_of, **spec):
                clock = MonotonicClock()
                box = box_of(clock.now_ns() / 1e9)
                terminal = stack.enter_context(FakeTerminal(box, clock))
                fields = {"range_n": 50.0, "range_nm": 1.0} | spec
                sensor = HexSensor.open(HexSpec(terminal.path, **fields), clock)
                stack.callback(sensor.close)
                return terminal, box, sensor

            yield make

    def test_it_keeps_the_promises_of_a_force_sensor(self, bench):
        _, _, sensor = bench(lambda now: HexBox(lambda t: LOAD, now_s=now))
        assert sensor.latest().force_n == pytest.approx(LOAD[:3], abs=0.05)
        found = check_force_sensor(sensor, clock=MonotonicClock(), seconds=1.0, age_s=3.0)
        assert [one for one in found if not one.ok and one.code != "call-time"] == []

    def test_in_trigger_mode_it_is_silent_and_the_lights_are_named(self, bench):
        with refused("no-samples", DeviceError):
            bench(lambda now: HexBox(now_s=now, faults=HexFaults(trigger=True)))

    def test_one_that_falls_silent_has_failed(self, bench):
        terminal, box, sensor = bench(lambda now: HexBox(now_s=now))
        with terminal.lock:
            box.faults = HexFaults(trigger=True)
        time.sleep(0.5)
        with refused("no-samples", DeviceError):
            sensor.drain()

    def test_a_rigs_file_opens_it(self, bench):
        terminal, _, sensor = bench(lambda now: HexBox(lambda t: LOAD, now_s=now))
        sensor.close()
        part = {"kind": "resense-hex", "port": terminal.path, "range_N": 50.0, "range_Nm": 1.0}
        force = RigFile.model_validate({"name": "arm", "force": part}).force
        with force.open(MonotonicClock()) as opened:
            assert opened.range_n == (50.0, 50.0, 50.0)
            assert opened.latest().force_n == pytest.approx(LOAD[:3], abs=0.05)


@pytest.mark.parametrize(
    ("field", "value"), [("range_n", 0.0), ("range_n", math.nan), ("range_nm", 1e3), ("rate_hz", 125.0)]
)
def test_what_its_box_has_not_is_refused(field, value):
    with pytest.raises(RangeError, match=field):
        HexSpec("p", **({"range_n": 50.0, "range_nm": 1.0} | {field: value}))
