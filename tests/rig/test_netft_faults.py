"""Every fault of a Net F/T box: injected over real sockets, and told for what it is."""

import math
import socket
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import pytest
from tests.fakes.netft_box import START, STOP, FakeNetFT, FakePage
from tests.refusals import refused
from tests.rig.conftest import until

from palpate.core.errors import DeviceError, ProtocolError
from palpate.rig.real.netft.netft_calibration import MAX_PAGE_BYTES
from palpate.rig.real.netft.netft_sensor import NetFT, NetFTSettings
from palpate.rig.real.netft.netft_stream import RdtCommand, request

FORCE = (1.0, -2.0, -12.5)


def patient(box: FakeNetFT) -> NetFTSettings:
    return NetFTSettings(rdt_port=box.rdt_port, http_port=box.http_port, silence_s=20.0, start_wait_s=2.0)


def watchful(box: FakeNetFT) -> NetFTSettings:
    """For faults that show as silence: as short as a busy computer allows."""
    return replace(patient(box), silence_s=0.5)


@pytest.fixture
def box() -> Iterator[FakeNetFT]:
    with FakeNetFT(force=lambda t: FORCE) as made:
        yield made
        assert not made.was_biased, "whatever happens, the box's own zero is never touched"


def more(sensor: NetFT, n: int = 10) -> None:
    """Wait for n more good samples."""
    least = sensor.counts.received + n
    until(lambda: sensor.counts.received >= least)


def failure(sensor: NetFT) -> str:
    """Wait until the sensor fails, and why."""
    said: list[str] = []

    def failed() -> bool:
        try:
            sensor.latest()
        except DeviceError as error:
            said.append(str(error))
        return bool(said)

    until(failed)
    with pytest.raises(DeviceError):
        sensor.drain()
    return said[0]


def is_fit(sensor: NetFT) -> None:
    """It goes on measuring."""
    more(sensor)
    assert sensor.latest().force_n == FORCE


# F1: the request to start is lost


def test_a_box_that_did_not_hear_is_asked_again_to_start(box: FakeNetFT) -> None:
    box.lost_starts = 3
    with NetFT(box.host, replace(patient(box), start_tries=100, start_wait_s=0.1)) as sensor:
        is_fit(sensor)
    starts = [asked for asked in box.requests if asked.command == START]
    assert len(starts) >= 4
    assert all(a.source != b.source for a, b in pairwise(starts))  # late answers cannot mix


def test_a_box_that_never_sends_is_given_up(box: FakeNetFT) -> None:
    box.silent = True
    with refused("no-records", DeviceError):
        NetFT(box.host, replace(patient(box), start_tries=3, start_wait_s=0.02))


def test_a_port_where_nothing_listens_is_told(box: FakeNetFT) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind((box.host, 0))
        port = unused.getsockname()[1]
    with pytest.raises(DeviceError, match=r"RDT|cable"):
        NetFT(box.host, replace(patient(box), rdt_port=port, start_tries=2, start_wait_s=0.05))


# F2: datagrams that are no records


def test_datagrams_that_are_no_records_are_dropped_and_counted_and_a_storm_of_them_ends_it(box) -> None:
    with NetFT(box.host, patient(box)) as sensor:
        box.send_instead(*[bytes(size) for size in (0, 1, 35, 37, 1441, 1441, 7, 7, 7)])
        until(lambda: sensor.counts.malformed == 9)
        is_fit(sensor)
        assert (sensor.counts.lost, sensor.counts.faulty) == (0, 0)
        box.send_instead(*[b"storm"] * 10)
        assert "10 datagrams" in failure(sensor)
    assert box.streams_to is None


# F3: duplicate, out of order, lost


def test_duplicate_stale_and_lost_records_are_told_apart(box: FakeNetFT) -> None:
    with NetFT(box.host, patient(box)) as sensor:
        box.repeat(2)
        until(lambda: sensor.counts.duplicate == 2)
        box.lose(5)
        until(lambda: sensor.counts.lost == 5)
        box.swap()  # one comes early, so one seems lost and then comes late
        until(lambda: sensor.counts.out_of_order == 1)
        is_fit(sensor)
        counts = sensor.counts
        assert (counts.lost, counts.duplicate, counts.out_of_order, counts.malformed) == (6, 2, 1, 0)
        box.lose(150)  # 0.3 s of them, for as long as time passed
        until(lambda: sensor.counts.lost >= 150)
        is_fit(sensor)


# F4, F5, F8, F11: the measurement stands still, the device restarts or is silent, the computer slept


def stands_still(box: FakeNetFT) -> None:
    box.ft_step = 0


def restarts(box: FakeNetFT) -> None:
    box.ft_sequence = 0


def begins_anew(box: FakeNetFT) -> None:
    box.rdt_sequence = box.ft_sequence = 0


def is_silent(box: FakeNetFT) -> None:
    box.silent = True


def runs_on(box: FakeNetFT) -> None:
    box.rdt_sequence += 5000  # ten seconds of records, as after the computer slept


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (stands_still, "stands still"),
        (restarts, "restarted"),
        (begins_anew, "old numbers"),
        (is_silent, "0.5 s"),
        (runs_on, "by 5001"),
    ],
)
def test_what_makes_the_stream_worthless_ends_it_by_its_name(box: FakeNetFT, spoil, said: str) -> None:
    box.first_sequence, box.ft_sequence = 1_000_000, 3_000_000_000
    with NetFT(box.host, watchful(box)) as sensor:
        more(sensor)
        spoil(box)
        if spoil is stands_still:
            until(lambda: sensor.latest().fault == "stalled")
            assert all(map(math.isnan, sensor.latest().force_n))
        assert said in failure(sensor)


# F6, F14: status, and counts or forces at the ends of their range


def test_a_saturated_sample_is_a_fault_without_numbers_and_ends_with_the_load(box: FakeNetFT) -> None:
    with NetFT(box.host, patient(box)) as sensor:
        box.status = 0x80020000
        until(lambda: sensor.latest().fault == "saturated")
        wrench = sensor.latest()
        assert all(map(math.isnan, (*wrench.force_n, *wrench.torque_nm)))
        box.status = 0
        until(lambda: sensor.latest().fault == "")
        is_fit(sensor)
        assert sensor.counts.faulty >= 1


@pytest.mark.parametrize("bit", [2, 16, 31])
def test_every_other_status_bit_ends_the_stream_and_is_named(box: FakeNetFT, bit: int) -> None:
    with NetFT(box.host, patient(box)) as sensor:
        box.status = 1 << bit  # bit 16 without the summary bit is not the healthy warning
        told = failure(sensor)
    assert f"{1 << bit:#010x}" in told
    assert "it reports: " in told


@pytest.mark.parametrize(("axis", "rail"), [(2, -(2**31)), (5, 2**31 - 1)])
def test_counts_at_their_rail_are_a_fault_without_numbers(box: FakeNetFT, axis: int, rail: int) -> None:
    with NetFT(box.host, replace(patient(box), range_n=(1e9, 1e9, 1e9))) as sensor:
        box.counts = tuple(rail if i == axis else 0 for i in range(6))
        until(lambda: sensor.latest().fault == "counts-saturated")
        assert all(map(math.isnan, sensor.latest().force_n))


# F7: the box comes back as another instrument


@pytest.mark.parametrize(
    "changed",
    [
        {"counts_per_force": 2_000_000},
        {"torque_unit": "Nmm"},
        {"serial": "FT00001"},
        {"bias": "1;0;0;0;0;0"},
    ],
)
def test_a_box_that_comes_back_with_another_calibration_is_refused_for_good(box, changed):
    quick = replace(watchful(box), recovery="reconnect", retry_s=(0.01, 0.02))
    with NetFT(box.host, quick) as sensor:
        box.page = replace(box.page, **changed)
        box.status = 1 << 2
        until(lambda: "changed" in failure(sensor))
        box.status, box.page = 0, FakePage()
        until(lambda: not any(t.name.startswith("Net F/T") for t in threading.enumerate()))  # tries no more
        told = failure(sensor)
        assert "changed" in told
        assert "trying again" not in told


def test_a_run_that_goes_on_refuses_a_box_that_is_another_by_now(box: FakeNetFT) -> None:
    with NetFT(box.host, patient(box)) as sensor:
        expected = sensor.calibration
    with NetFT(box.host, replace(patient(box), calibration=expected)) as sensor:
        is_fit(sensor)
    box.page = replace(box.page, counts_per_force=2_000_000)
    with refused("sensor-changed", DeviceError):
        NetFT(box.host, replace(patient(box), calibration=expected))


def test_a_box_that_comes_back_unchanged_is_taken_up_again_where_that_is_asked_for(box: FakeNetFT) -> None:
    quick = replace(watchful(box), recovery="reconnect", retry_s=(0.01, 0.02), start_tries=100)
    with NetFT(box.host, quick) as sensor:
        box.status = 1 << 2
        assert "temperature" in failure(sensor)
        box.http_status = 503
        until(lambda: "503" in failure(sensor) and box.pages_read > 4)  # tries on and on
        box.http_status, box.status = 200, 0
        until(lambda: sensor.counts.reconnected == 1)
        is_fit(sensor)


def test_by_default_a_failure_is_for_good(box: FakeNetFT) -> None:
    with NetFT(box.host, patient(box)) as sensor:
        read = box.pages_read
        box.status = 1 << 2
        first = failure(sensor)
        box.status = 0
        until(lambda: box.streams_to is None)
        assert failure(sensor) == first
        assert box.pages_read == read
    assert failure(sensor) == first  # closing does not hide why


# F8: another client takes the stream


def test_a_stolen_stream_is_told_and_the_other_client_is_not_cut_off(box: FakeNetFT) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        with NetFT(box.host, watchful(box)) as sensor:
            more(sensor)
            thief.sendto(request(RdtCommand.START), (box.host, box.rdt_port))
            assert "another client" in failure(sensor)
        assert box.streams_to is not None
        assert box.streams_to[1] == thief.getsockname()[1]
        assert STOP not in [asked.command for asked in box.requests]


# F9: datagrams from elsewhere


def test_records_from_another_address_are_never_seen(box: FakeNetFT) -> None:
    with NetFT(box.host, patient(box)) as sensor, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign:
        client = box.streams_to
        assert client is not None
        forged = struct.pack(">III6i", box.rdt_sequence + 1000, box.ft_sequence + 1000, 0, 0, 0, 9, 9, 9, 9)
        for _ in range(20):
            foreign.sendto(forged, client)
            foreign.sendto(b"junk", client)
        is_fit(sensor)
        assert {w.force_n for w in sensor.drain()} == {FORCE}
        counts = sensor.counts
    assert (counts.lost, counts.out_of_order, counts.malformed) == (0, 0, 0)


# F10: the page


def test_a_web_server_that_answers_with_an_error_is_told(box: FakeNetFT) -> None:
    box.http_status = 503
    with pytest.raises(DeviceError, match="503"):
        NetFT(box.host, patient(box))
    assert box.requests == []


def test_a_page_without_end_is_refused_after_64_kib(box: FakeNetFT) -> None:
    box.http_body = b"<netft>" + b" " * (4 * MAX_PAGE_BYTES)
    with pytest.raises(ProtocolError, match="65536 bytes"):
        NetFT(box.host, patient(box))


def test_a_page_that_drips_is_given_up_in_time(box: FakeNetFT) -> None:
    box.http_drip_s = 0.01  # hundreds of bytes: seconds in all, though each comes soon
    with refused("page-timeout", DeviceError, match=r"0\.3 s"):
        NetFT(box.host, replace(patient(box), http_timeout_s=0.3))


def test_a_page_that_ends_early_is_refused(box: FakeNetFT) -> None:
    box.http_missing = 10  # all that has to be known came, and yet
    with refused("page-truncated", DeviceError, match="10"):
        NetFT(box.host, patient(box))


def test_an_address_without_a_web_server_is_told(box: FakeNetFT) -> None:
    with socket.socket() as unused:
        unused.bind((box.host, 0))
        port = unused.getsockname()[1]
    with refused("page-unreachable", DeviceError):
        NetFT(box.host, replace(patient(box), http_port=port))


# F11: an old sample


def test_the_age_of_the_newest_sample_shows(box: FakeNetFT) -> None:
    with NetFT(box.host, patient(box)) as sensor:
        box.silent = True
        sent = box.sent
        until(lambda: sensor.counts.received >= sent)
        old = sensor.latest()
        until(lambda: time.monotonic_ns() - old.time_ns > 200_000_000)
        assert sensor.latest() == old  # nothing makes it younger
        assert sensor.drain()[-1] == old
        assert sensor.drain() == []


def test_a_force_beyond_the_range_is_a_fault_without_numbers(box: FakeNetFT) -> None:
    box.force = lambda t: (0.0, 0.0, -990.5)
    with NetFT(box.host, patient(box)) as sensor:
        assert sensor.latest().fault == "force-range"
        assert all(map(math.isnan, sensor.latest().force_n))
        box.force = lambda t: (330.0, -330.0, -990.0)
        until(lambda: sensor.latest().fault == "")
        assert sensor.latest().force_n == (330.0, -330.0, -990.0)


# F13: bias, and a receiving thread that ends


def test_nothing_but_start_and_stop_is_ever_asked(box: FakeNetFT) -> None:
    with NetFT(box.host, patient(box)) as sensor:
        is_fit(sensor)
    assert {(a.header, a.command, a.records) for a in box.requests} == {(0x1234, START, 0), (0x1234, STOP, 0)}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_receiving_thread_that_ends_by_a_mistake_does_not_leave_an_old_sample_as_the_newest(
    box, monkeypatch
):
    with NetFT(box.host, patient(box)) as sensor:

        def mistake(*_: object) -> None:
            raise ZeroDivisionError

        monkeypatch.setattr(sensor, "_step", mistake)
        assert "receiving thread" in failure(sensor)
