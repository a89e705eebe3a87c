"""Load cells and balances that print lines: what a line weighs, and what goes wrong is told."""

import math
import struct
import sys
import time
from contextlib import ExitStack

import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError
from tests.fakes.hex_box import HexBox, HexFaults
from tests.fakes.printing_scale import PrintingScale, ScaleFaults
from tests.refusals import refused
from tests.rig.conftest import until
from tests.rig.serial_terminal import FakeTerminal

from palpate.core import DeviceError, ForceSensor, InputError, MonotonicClock, ProtocolError, RangeError
from palpate.devices.check import check_force_sensor
from palpate.rig.real.resense import SAMPLE_BYTES, TRIED, HexFrames, HexSensor, HexSpec
from palpate.rig.real.scale import (
    G0,
    MAX_GARBLED,
    MAX_LINE,
    STUCK_LINES,
    ScaleSpec,
    SerialScale,
    WeightStream,
    read_weight,
)
from palpate.rig.rig_file import RigFile

BUSY = ("call-time", "sample-rate")  # what a loaded machine may break although the driver keeps it


@pytest.mark.parametrize(
    ("line", "value", "unit", "stable"),
    [
        (b"-83886", -83886.0, "", None),  # a microcontroller's own
        (b"12.5 g", 12.5, "g", None),
        (b"ST,+0018.372  g", 18.372, "g", True),  # A&D
        (b"US,-0000.004 kg", -0.004, "kg", False),
        (b"ST,GS,+01234.5kg", 1234.5, "kg", True),
        (b"ST,GS 1.000KG", 1.0, "kg", True),  # Kern: the second header without a comma
        (b"S S     100.00 g", 100.0, "g", True),  # Mettler-Toledo
        (b"S D      -4.51 g", -4.51, "g", False),
        (b"+   123.56 g  ", 123.56, "g", None),  # Sartorius
        (b"-   123.56    ", -123.56, "", None),
        (b"N     +  123.56 g  ", 123.56, "g", None),
        (b"?       0.01 g", 0.01, "g", False),  # Radwag
        (b"       0.01 g ?", 0.01, "g", False),  # Ohaus
        (b"     0.5950 oz", 0.595, "oz", None),
        (b"  1.25 N", 1.25, "N", None),
    ],
)
def test_published_layouts_are_read(line: bytes, value: float, unit: str, stable: bool | None) -> None:
    weight = read_weight(line)
    assert (weight.value, weight.unit, weight.stable, weight.fault) == (value, unit, stable, "")


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        (b"OL,+999999E+19", "overload"), (b"S +", "overload"), (b"S -", "underload"), (b"S I", "busy"),
        (b"       H", "overload"), (b"       L", "underload"), (b"Err 54", "Err 54"),
        (b"^   999.9 g", "overload"),
    ],
)  # fmt: skip
def test_a_line_without_a_weight_is_a_fault_and_no_number(line: bytes, fault: str) -> None:
    weight = read_weight(line)
    assert fault in weight.fault
    assert math.isnan(weight.value)


@pytest.mark.parametrize(
    "line",
    [
        b"12.3.4", b"nan", b"inf", b"1e3 g", b"12 stones", b"ST,+0018\xf0372 g", b"", b"S S", b"S S 1.0",
        b"9" * 65,
    ],
)  # fmt: skip
def test_what_is_no_layout_weighs_nothing(line: bytes) -> None:
    with pytest.raises(ProtocolError):
        read_weight(line)


@pytest.mark.parametrize("line", [b"0,7 g", b"1,000 g", b"ST,GS,+0012,5 g"])
def test_a_comma_between_digits_is_named_and_not_guessed(line: bytes) -> None:
    with refused("decimal-comma", ProtocolError):
        read_weight(line)


@given(st.binary(max_size=2 * MAX_LINE))
def test_whatever_bytes_come_only_protocol_errors_leave(line: bytes) -> None:
    try:
        weight = read_weight(line)
    except ProtocolError:
        return
    assert weight.fault or math.isfinite(weight.value)


class TestStream:
    def samples(self, data: bytes, **spec):
        stream = WeightStream(ScaleSpec("p", **spec))
        return stream, stream.take(data, 2_000_000_000)

    def test_a_line_is_force_along_z_measured_the_delay_ago(self) -> None:
        _, (one,) = self.samples(b"ignored\r\n100.0 g\r\n", delay_s=0.4)
        assert one.force_n == pytest.approx((0.0, 0.0, 0.1 * G0))
        assert one.time_ns == 1_600_000_000

    def test_counts_become_newtons_by_the_stated_scale_and_sign(self) -> None:
        _, (one,) = self.samples(b"\n-20000\n", unit="counts", count_n=-2e-5)
        assert one.force_n[2] == pytest.approx(0.4)

    def test_a_first_line_that_may_be_cut_is_dropped(self) -> None:
        stream, samples = self.samples(b"34.5 g\r\n1234.5 g\r\n", range_n=100.0)
        assert [one.force_n[2] for one in samples] == pytest.approx([1.2345 * G0])
        assert stream.counts.garbled == 0

    def test_garbled_lines_are_counted_and_weigh_nothing(self) -> None:
        stream, samples = self.samples(b"\n1.0 g\n\xff\xfe g\n2.0 g\n" + b"7" * 100 + b"\n3.0 g\n")
        assert [one.force_n[2] / G0 * 1e3 for one in samples] == pytest.approx([1, 2, 3])
        assert (stream.counts.received, stream.counts.garbled) == (3, 2)
        assert stream.failure is None

    def test_nothing_but_garbage_is_a_failure_that_names_the_baud(self) -> None:
        stream, _ = self.samples(b"\n" + b"\x80\x81\n" * MAX_GARBLED)
        assert "baud (9600)" in str(stream.failure)

    def test_a_cut_line_of_a_fixed_width_is_garbled(self) -> None:
        stream, samples = self.samples(b"\nST,+0018.372  g\n8.372  g\n", line_bytes=15)
        assert (len(samples), stream.counts.garbled) == (1, 1)

    def test_counts_that_stand_still_are_a_failure_and_a_balance_may_rest(self) -> None:
        stream, _ = self.samples(b"\n" + b"4711\n" * (STUCK_LINES - 1), unit="counts", count_n=1e-5)
        assert stream.failure is None
        stream.take(b"4711\n", 0)
        assert "4711 counts" in str(stream.failure)
        stream, _ = self.samples(b"\n" + b"100.0 g\n" * 1000)
        assert stream.failure is None

    @pytest.mark.parametrize("rail", [8388607, -8388608])
    def test_a_cell_at_its_rail_measures_nothing(self, rail: int) -> None:
        _, (one,) = self.samples(b"\n%d\n" % rail, unit="counts", count_n=1e-7, range_n=0.8)
        assert "rail" in one.fault
        assert math.isnan(one.force_n[2])

    def test_a_force_beyond_the_range_is_a_fault(self) -> None:
        _, (one, two) = self.samples(b"\n1019 g\n1020 g\n", range_n=10.0)  # 10 N are 1019.7 g
        assert (one.fault, two.fault) == ("", "force-range")

    def test_an_unstable_line_is_a_fault_only_where_asked(self) -> None:
        stream, (one,) = self.samples(b"\nUS,+1.0 g\n")
        assert (one.fault, stream.counts.unstable) == ("", 1)
        _, (one,) = self.samples(b"\nUS,+1.0 g\n", settled_only=True)
        assert one.fault == "not stable"

    def test_a_bare_number_weighs_nothing_until_its_unit_is_known_or_stated(self) -> None:
        stream, samples = self.samples(b"\n100\n+ 200.0 g\n100\n", unit="")
        assert ["'100' carries" in one.fault for one in samples] == [True, False, False]
        assert [one.force_n[2] for one in samples[1:]] == pytest.approx([0.2 * 9.80665, 0.1 * 9.80665])
        assert stream.failure is None
        stream, _ = self.samples(b"\n" + MAX_GARBLED * b"7.5\n", unit="")
        assert "'7.5' carries" in str(stream.failure)
        _, (bare, own) = self.samples(b"\n16.0\n1 lb\n", unit="oz")  # a line with a unit wins
        assert bare.force_n[2] == pytest.approx(own.force_n[2]) == pytest.approx(0.45359237 * 9.80665)


@pytest.mark.parametrize(
    ("fields", "error"),
    [
        ({"unit": "counts"}, InputError), ({"count_n": 1e-5}, InputError),
        ({"unit": "counts", "count_n": 0.0}, RangeError), ({"unit": "stone"}, InputError),
        ({"rate_hz": 0.0}, RangeError), ({"delay_s": -0.1}, RangeError), ({"frame": "9X1"}, InputError),
        ({"range_n": math.inf}, RangeError),
    ],
)  # fmt: skip
def test_a_specification_that_makes_no_sense_is_refused(fields, error) -> None:
    with pytest.raises(error):
        ScaleSpec("p", **fields)


@pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal needs POSIX")
class TestDriver:
    @pytest.fixture
    def bench(self):
        pytest.importorskip("serial")
        with ExitStack() as stack:

            def make(scale: PrintingScale, **spec):
                clock = MonotonicClock()
                now_s = clock.now_ns() / 1e9
                scale._now_s = scale._next_s = now_s
                terminal = stack.enter_context(FakeTerminal(scale, clock))
                spec = {"rate_hz": 50.0, "delay_s": 0.1, "silence_s": 10.0} | spec
                sensor = SerialScale.open(ScaleSpec(terminal.path, **spec), clock)
                stack.callback(sensor.close)
                return terminal, sensor

            yield make

    def failure(self, sensor) -> str:
        said: list[str] = []

        def failed() -> bool:
            try:
                sensor.latest()
            except DeviceError as error:
                said.append(str(error))
            return bool(said)

        until(failed)
        return said[0]

    @pytest.mark.parametrize(
        ("layout", "spec"),
        [
            ("counts", {"unit": "counts", "count_n": 1e-5}),
            ("grams", {}),
            ("a&d", {"line_bytes": 16}),
            ("sics", {}),
            ("sbi", {"line_bytes": 14}),
        ],
    )
    def test_every_layout_weighs_the_same(self, bench, layout, spec) -> None:
        _, sensor = bench(PrintingScale(lambda t: 1.5, layout=layout, rate_hz=50.0, noise_n=1e-4), **spec)
        assert isinstance(sensor, ForceSensor)
        assert sensor.latest().force_n[2] == pytest.approx(1.5, abs=1e-3)

    def test_a_scale_that_is_asked_answers(self, bench) -> None:
        scale = PrintingScale(lambda t: 0.5, layout="sics", on_request=True)
        _, sensor = bench(scale, ask="SI")
        until(lambda: sensor.counts.received >= 5)
        assert sensor.latest().force_n[2] == pytest.approx(0.5, abs=5e-3)

    def test_a_scale_that_is_not_asked_is_told_as_silent(self, bench) -> None:
        with refused("no-samples", DeviceError):
            bench(PrintingScale(on_request=True), silence_s=0.3)

    @pytest.mark.parametrize(
        "faults", [ScaleFaults(mute=True), ScaleFaults(nonsense=True), ScaleFaults(stuck=True)]
    )
    def test_what_makes_it_worthless_ends_it(self, bench, faults) -> None:
        scale = PrintingScale(lambda t: 1.0, layout="counts", rate_hz=200.0)
        terminal, sensor = bench(scale, unit="counts", count_n=1e-5, rate_hz=200.0, silence_s=1.0)
        with terminal.lock:
            scale.faults = faults
        assert self.failure(sensor)
        with refused("no-samples", DeviceError):
            sensor.drain()

    def test_overload_is_a_fault_and_ends_nothing(self, bench) -> None:
        scale = PrintingScale(layout="a&d", rate_hz=50.0)
        terminal, sensor = bench(scale)
        with terminal.lock:
            scale.faults = ScaleFaults(overloaded=True)
        until(lambda: sensor.latest().fault == "overload")
        with terminal.lock:
            scale.faults = ScaleFaults()
        until(lambda: sensor.latest().fault == "")

    def test_an_unplugged_scale_is_gone(self, bench) -> None:
        terminal, sensor = bench(PrintingScale(rate_hz=50.0))
        terminal.unplug()
        assert "its port" in self.failure(sensor)

    def test_samples_that_nobody_drains_are_told(self, bench) -> None:
        _, sensor = bench(PrintingScale(rate_hz=200.0), keep=5)
        until(lambda: sensor.counts.received > 10)
        with pytest.raises(DeviceError, match="overwritten"):
            sensor.drain()
        assert sensor.drain()  # the newest are kept

    def test_it_keeps_every_law_of_a_sensor_that_labels(self, bench) -> None:
        _, sensor = bench(
            PrintingScale(lambda t: 1.0, layout="counts", rate_hz=80.0),
            unit="counts",
            count_n=1e-5,
            rate_hz=80.0,
        )
        found = check_force_sensor(sensor, clock=MonotonicClock(), seconds=1.0, age_s=0.1 + 3.0)
        assert [one for one in found if not one.ok and one.code not in BUSY] == []

    def test_a_rig_s_file_names_it_and_what_its_lines_mean(self, bench) -> None:
        scale = PrintingScale(lambda t: 0.5, layout="counts", rate_hz=80.0)
        terminal, first = bench(scale, unit="counts", count_n=1e-5)
        first.close()
        part = {"kind": "serial-scale", "port": terminal.path, "unit": "counts", "count_N": 1e-5}
        more = {"rate_hz": 80.0, "delay_s": 0.05, "range_N": 20.0, "axes": ["x", "y", "-z"]}
        file = RigFile.model_validate({"name": "bench", "label_force": part | more})
        with file.label_force.open(MonotonicClock()) as sensor:
            assert sensor.latest().force_n[2] == pytest.approx(0.5, abs=0.02)
            assert (sensor.rate_hz, sensor.delay_s, sensor.range_n[2]) == (80.0, 0.05, 20.0)
        with pytest.raises(ValidationError, match="counts_N"):
            RigFile.model_validate({"name": "bench", "force": part | {"counts_N": 1.0}})


# HEX six-axis sensors: where a sample begins is never guessed, and what goes wrong is told.

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
        assert [one for one in found if not one.ok and one.code not in BUSY] == []

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
