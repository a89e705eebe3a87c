"""The Net F/T driver against a box that is not there, over real sockets."""

import os
import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from tests.fakes.netft_box import START, STOP, FakeNetFT, FakePage
from tests.refusals import refused
from tests.rig.conftest import PATIENCE_S, until

from palpate.core import NS_PER_S, MonotonicClock, Wrench
from palpate.core.errors import DeviceError, RangeError
from palpate.devices import ForceBias, Limits, Reason, Tripped
from palpate.devices.force_trust import ForceMonitor, Phase, name_fault
from palpate.rig.real.netft.netft_calibration import calibration
from palpate.rig.real.netft.netft_sensor import NetFT, NetFTSettings, Samples
from palpate.rig.real.netft.netft_stream import RdtStream
from palpate.rig.virtual.virtual_bench import TRAVEL

FORCE, TORQUE = (1.0, -2.0, -12.5), (0.25, 0.0, -0.125)  # whole counts, so equal and not only close


def settings(box: FakeNetFT) -> NetFTSettings:
    # Patient, so that a busy computer is not taken for a silent box.
    return NetFTSettings(rdt_port=box.rdt_port, http_port=box.http_port, silence_s=20.0, start_wait_s=2.0)


@pytest.fixture
def box() -> Iterator[FakeNetFT]:
    with FakeNetFT(force=lambda t: FORCE, torque=lambda t: TORQUE) as made:
        yield made
        assert not made.was_biased


@pytest.fixture
def sensor(box: FakeNetFT) -> Iterator[NetFT]:
    with NetFT(box.host, settings(box)) as made:
        yield made


@pytest.mark.parametrize(
    "page",
    [
        FakePage(counts_per_force=4000, force_unit="lbf", newtons=4.4482216152605),
        FakePage(counts_per_torque=999.999, torque_unit="N-mm", newton_metres=1e-3),
        FakePage(force_unit="kgf", newtons=9.80665, torque_unit="kg-cm", newton_metres=0.0980665),
    ],
)
def test_the_force_is_in_newtons_whatever_unit_the_box_is_set_to(box: FakeNetFT, page: FakePage) -> None:
    box.page = page
    with NetFT(box.host, settings(box)) as sensor:
        wrench = sensor.latest()
    half_a_count_n = 0.5 / page.counts_per_force * page.newtons
    half_a_count_nm = 0.5 / page.counts_per_torque * page.newton_metres
    assert wrench.force_n == pytest.approx(FORCE, rel=1e-12, abs=half_a_count_n)
    assert wrench.torque_nm == pytest.approx(TORQUE, rel=1e-12, abs=half_a_count_nm)


def test_what_the_page_leaves_open_has_to_be_given(box: FakeNetFT) -> None:
    box.page = FakePage(ranges="0;0;0;0;0;0")
    with pytest.raises(DeviceError, match="range_n"):
        NetFT(box.host, settings(box))
    box.http_body = FakePage().xml().replace(b"comrdtrate", b"other")
    with pytest.raises(DeviceError, match="rate_hz"):
        NetFT(box.host, settings(box))
    box.http_body = box.http_body.replace(b"cfgmr", b"another")
    given = replace(settings(box), rate_hz=250.0, range_n=(10.0, 20.0, 30.0))
    with NetFT(box.host, given) as sensor:
        assert (sensor.rate_hz, sensor.range_n) == (250.0, (10.0, 20.0, 30.0))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells when a datagram came in")
def test_a_program_that_is_late_does_not_take_an_old_sample_for_a_fresh_one() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.1", 0))
        stream = RdtStream("127.0.0.1", device.getsockname()[1], MonotonicClock())
        try:
            stream.start()
            _, client = device.recvfrom(64)

            def is_seen_to_be_old() -> bool:
                device.sendto(b"x", client)
                sent_ns = time.monotonic_ns()
                until(lambda: time.monotonic_ns() > sent_ns + 50_000_000)
                got = stream.receive(PATIENCE_S)
                return got is not None and got[1] <= sent_ns + 10_000_000  # two clocks are read in turn

            until(is_seen_to_be_old)  # the kernel begins to stamp a little after it is asked to
            assert is_seen_to_be_old()
        finally:
            stream.close()


def test_samples_that_nobody_drains_are_overwritten_counted_and_told(box: FakeNetFT) -> None:
    with NetFT(box.host, replace(settings(box), keep=10)) as sensor:
        until(lambda: sensor.counts.received > 15)
        with refused("samples-overwritten", DeviceError, match="10"):
            sensor.drain()
        assert len(sensor.drain()) == 10


def test_closing_stops_the_box_and_closing_again_does_nothing(box: FakeNetFT) -> None:
    sensor = NetFT(box.host, settings(box))
    assert box.streams_to is not None
    sensor.close()
    sensor.close()
    assert box.streams_to is None
    assert {asked.command for asked in box.requests} == {START, STOP}
    for call in (sensor.latest, sensor.drain):
        with pytest.raises(DeviceError, match="closed"):
            call()


def test_a_box_that_did_not_hear_is_asked_again_to_stop(box: FakeNetFT) -> None:
    box.lost_stops = 2
    NetFT(box.host, settings(box)).close()
    assert box.streams_to is None
    assert [asked.command for asked in box.requests].count(STOP) >= 3


@pytest.mark.parametrize(
    "wrong",
    [
        {"silence_s": 0.0}, {"silence_s": float("nan")}, {"retry_s": (0.1, -1.0)}, {"start_tries": 0},
        {"keep": 0}, {"rate_hz": 0.0}, {"range_n": (1.0, float("inf"), 1.0)},
    ],
)  # fmt: skip
def test_settings_that_mean_nothing_are_refused(wrong: dict[str, object]) -> None:
    with refused("settings-range", RangeError):
        NetFTSettings(**wrong)


def test_a_silence_shorter_than_three_records_is_refused(box: FakeNetFT) -> None:
    box.page = FakePage(rate_hz=10.0)
    with refused("silence-too-short", RangeError, match=r"0\.3 s"):
        NetFT(box.host, replace(settings(box), silence_s=0.1))
    assert box.requests == []


def test_an_independent_client_reads_the_same_force_from_the_same_box(box: FakeNetFT) -> None:
    pynetft = pytest.importorskip("pynetft", reason="the cross-check needs pynetft")
    box.page = FakePage(counts_per_force=4000, force_unit="lbf", newtons=4.4482216152605)
    with NetFT(box.host, settings(box)) as sensor:
        ours = sensor.latest()
        scale = sensor.calibration.counts_per_n
    config = pynetft.Config(
        sensor_host=box.host, rdt_port=box.rdt_port, http_port=box.http_port, receive_timeout=PATIENCE_S,
        configuration_connect_timeout=PATIENCE_S, configuration_timeout=PATIENCE_S,
    )  # fmt: skip
    with pynetft.Client(config) as client:
        theirs = next(client.samples(timeout=PATIENCE_S))
        told = client.health().sensor_configuration.calibration
    assert theirs.raw_wrench == tuple(round(f * scale) for f in ours.force_n) + tuple(
        round(m * 1e6) for m in ours.torque_nm
    )
    assert theirs.force_unit.value == "lbf"
    assert [f * 4.4482216152605 for f in theirs.force] == pytest.approx(ours.force_n, rel=1e-12)
    assert told.counts_per_force_unit / 4.4482216152605 == pytest.approx(scale, rel=1e-12)
    assert theirs.torque == pytest.approx(ours.torque_nm, rel=1e-12)


def test_a_real_box_streams_without_loss() -> None:
    host = os.environ.get("PALPATE_NETFT")
    if not host:
        pytest.skip("no Net F/T box here; name its address in PALPATE_NETFT")
    with NetFT(host) as sensor:
        until(lambda: sensor.counts.received > sensor.rate_hz)
        assert sensor.counts.lost == sensor.counts.malformed == 0
        assert sensor.latest().fault == ""


# A Net F/T box that sends slower than its page states is slow; one whose records are held back is late.

HZ = 200.0
PACE_PATIENCE_S = 30.0
TRIES = 10  # of a healthy box on a busy computer
AIR = 300  # samples of the air: some that a busy computer sends at once then change the rate by little


def noisy_box() -> FakeNetFT:
    """A box that states `HZ`; its noise is a count's rounding of a force that never stands still."""
    return FakeNetFT(
        force=lambda t: (0.3, -0.2, 1.7 + 0.01 * ((t * 7919.0) % 1.0)), page=FakePage(rate_hz=HZ)
    )


def connected(box: FakeNetFT) -> NetFT:
    ports = {"rdt_port": box.rdt_port, "http_port": box.http_port}
    return NetFT(box.host, NetFTSettings(**ports, silence_s=20.0, start_wait_s=5.0))


def samples(sensor: NetFT, count: int) -> list[Wrench]:
    """The next samples, as many as are asked for."""
    heard, end = [], time.monotonic() + PACE_PATIENCE_S
    sensor.drain()
    while len(heard) < count:
        assert time.monotonic() < end, "waited in vain"
        heard += sensor.drain()
        time.sleep(5e-3)
    return heard


def taught(sensor: NetFT, count: int = AIR) -> ForceMonitor:
    """A monitor that learnt the air from the sensor at the rate that it states."""
    bias, air = ForceBias(), samples(sensor, count)
    monitor = ForceMonitor(bias, Limits(TRAVEL.least_m, TRAVEL.greatest_m), TRAVEL)
    bias.measure(air)
    monitor.learn_air(air, sensor.rate_hz)
    return monitor


def taught_in_time(sensor: NetFT) -> ForceMonitor:
    for _ in range(TRIES):
        try:
            return taught(sensor)
        except Tripped as busy:
            last = busy
    raise last


@pytest.mark.parametrize(("sent_hz", "heard_s"), [(0.5 * HZ, 0.0), (0.2 * HZ, 3.0)])
@pytest.mark.cases(1)
def test_a_box_that_sends_slower_than_its_page_states_is_named_slow(sent_hz: float, heard_s: float) -> None:
    with noisy_box() as box:
        box.sent_hz = sent_hz
        with connected(box) as sensor:
            time.sleep(heard_s)
            with pytest.raises(Tripped, match=f"states {HZ:g}") as caught:
                taught(sensor, 30)
        assert caught.value.reason is Reason.FORCE_SLOW


def test_records_that_are_held_back_are_named_late_and_none_is_lost() -> None:
    hold_s = 0.5
    with noisy_box() as box, connected(box) as sensor:
        monitor = taught_in_time(sensor)  # the negative control of the law above
        lost = sensor.counts.lost
        monitor.begin(Phase.DOWN, 2e-3, 1e-3, *[time.monotonic_ns()] * 2)
        box.hold_s = hold_s
        end = time.monotonic() + PACE_PATIENCE_S
        age_s = 0.0
        while age_s <= monitor.oldest_s:
            assert time.monotonic() < end, "records that are held back never grew old"
            age_s = (time.monotonic_ns() - sensor.latest().time_ns) / 1e9
            time.sleep(1e-3)
        doubt = monitor.gap(age_s)
        sensor.drain()
        begun = time.monotonic()
        heard: list[Wrench] = []
        while time.monotonic() - begun < 4 * hold_s:
            heard += sensor.drain()
            time.sleep(5e-3)
        air = monitor.air
        assert air is not None
        reason, words = name_fault(doubt, heard, air, ForceBias(), time.monotonic() - begun)
        assert reason is Reason.FORCE_LATE, words
        assert sensor.counts.lost == lost


# A Net F/T's samples are as old as its own numbers say; equal counts under running numbers are no force.

DATING_HZ = 500.0
HOLD_S = 0.08


def stream(
    rng, count: int, hold_from_s: float, frozen_from: int = 1 << 30, first: int = 2**32 - 700
) -> list[Wrench]:
    """Samples of records that wrap in their numbers, held back from a time on, frozen in their counts."""
    samples = Samples(calibration(FakePage().xml()), (330.0, 330.0, 990.0), 1.0, 0, rate_hz=DATING_HZ)
    taken: list[Wrench] = []
    counts = (0,) * 6
    for i in range(count):
        sent_s = i / DATING_HZ
        arrival_s = sent_s if sent_s < hold_from_s else np.ceil(sent_s / HOLD_S) * HOLD_S
        counts = tuple(rng.integers(-9000, 9000, 6).tolist()) if i < frozen_from else counts
        record = struct.pack(">III6i", (first + i) % 2**32, 1 + i, 0, *counts)
        taken += samples.take(record, round((1.0 + arrival_s) * NS_PER_S))
    return taken


def test_records_that_were_held_back_are_dated_by_their_numbers(rng) -> None:
    taken = stream(rng, 4000, hold_from_s=4.0)
    assert len(taken) == 4000, "none is lost where the numbers wrap"
    dated = np.array([one.time_ns for one in taken]) / NS_PER_S - 1.0
    # The least delay is forgotten by 1 % of the time since it was seen: less than 1 ms from burst to burst.
    assert np.abs(dated - np.arange(4000) / DATING_HZ).max() < 2e-3
    assert (np.diff(dated) >= 0).all()


def test_equal_counts_under_running_numbers_are_not_believed(rng) -> None:
    taken = stream(rng, 400, hold_from_s=9.0, frozen_from=200)
    bias = ForceBias()
    monitor = ForceMonitor(bias, Limits(TRAVEL.least_m, TRAVEL.greatest_m), TRAVEL)
    bias.measure(taken[:150])
    monitor.learn_air(taken[:150], DATING_HZ)
    doubts = [(i, doubt) for i, one in enumerate(taken[150:], 150) if (doubt := monitor.take(one))]
    first, doubt = doubts[0]
    assert doubt.kind == "repeats"
    assert 199 < first < 199 + 12, "soon after the first that is repeated, and never before"
    with refused("force-stuck", Tripped):
        monitor.learn_air(taken[250:], DATING_HZ)
