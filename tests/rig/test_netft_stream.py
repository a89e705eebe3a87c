"""The packet layer of ATI's raw data transfer, against bytes written out by hand."""

import pytest
from hypothesis import given, strategies as st

from palpate.core import ProtocolError, RangeError
from palpate.rig.real.netft.netft_stream import (
    MONITOR_WARNING,
    Advance,
    RdtCommand,
    RdtMeasurement,
    RdtRecord,
    RdtSequence,
    ahead,
    is_healthy,
    is_only_saturated,
    records,
    request,
    status_text,
)

U32 = st.integers(0, 2**32 - 1)

# Typed anew from the protocol's description, not imported.
BITS = {
    30: "processor or memory", 29: "digital board", 28: "analog board", 27: "serial link",
    26: "program memory", 25: "halted", 24: "settings", 23: "calibration", 22: "network", 21: "CAN",
    20: "RDT", 19: "EtherNet/IP", 18: "DeviceNet", 17: "saturated", 16: "monitor condition", 14: "watchdog",
    13: "stack", 12: "EEPROM", 11: "flash", 10: "analog watchdog", 9: "excitation high", 8: "excitation low",
    7: "analog ground", 6: "supply high", 5: "supply low", 4: "serial data", 3: "reference",
    2: "temperature", 1: "HTTP",
}  # fmt: skip


@pytest.mark.parametrize(
    ("command", "count", "vector"),
    [
        (RdtCommand.START, 0, "12 34 00 02 00 00 00 00"),
        (RdtCommand.STOP, 0, "12 34 00 00 00 00 00 00"),
        (RdtCommand.BIAS, 0, "12 34 00 42 00 00 00 00"),
        (RdtCommand.START, 65536, "12 34 00 02 00 01 00 00"),  # wrong where 16 bits are written twice
        (RdtCommand.START_BUFFERED, 1, "12 34 00 03 00 00 00 01"),
        (RdtCommand.RESET_LATCH, 0, "12 34 00 41 00 00 00 00"),
    ],
)
def test_a_request_is_eight_known_bytes(command: RdtCommand, count: int, vector: str) -> None:
    assert request(command, count) == bytes.fromhex(vector)


@pytest.mark.parametrize("count", [-1, 2**32])
def test_a_count_that_does_not_fit_is_refused(count: int) -> None:
    with pytest.raises(RangeError, match="4294967295"):
        request(RdtCommand.START, count)


def test_a_record_is_thirty_six_known_bytes() -> None:
    datagram = bytes.fromhex(
        "00000001 00000047 80010000 000f4240 fff0bdc0 7fffffff 80000000 00000000 ffffffff"
    )
    counts = (1_000_000, -1_000_000, 2**31 - 1, -(2**31), 0, -1)  # the rails too come through unharmed
    assert records(datagram) == [RdtRecord(1, 71, MONITOR_WARNING, counts)]


@given(st.binary(max_size=200))
def test_any_bytes_are_records_or_a_protocol_error(datagram: bytes) -> None:
    try:
        found = records(datagram)
    except ProtocolError:
        assert len(datagram) % 36 or not datagram
    else:
        assert len(found) * 36 == len(datagram) > 0


@pytest.mark.parametrize("size", [0, 1, 35, 37, 71, 73, 41 * 36, 65507])
def test_what_is_not_whole_records_is_refused(size: int) -> None:
    with pytest.raises(ProtocolError, match=f"{size} bytes"):
        records(bytes(size))


@pytest.mark.parametrize(("bit", "name"), BITS.items())
def test_every_status_bit_is_named_and_none_but_the_users_own_threshold_is_healthy(bit, name):
    for status in (1 << bit, 1 << 31 | 1 << bit):
        assert name in status_text(status)
        assert is_healthy(status) == (status == 0x80010000)
        assert is_only_saturated(status) == (bit == 17)


@pytest.mark.parametrize("status", [0x80000000, 0x8000, 1, 0x80010001, 0x80030000 | 1 << 2])
def test_a_status_that_is_not_known_is_an_error_in_words(status: int) -> None:
    assert status_text(status)
    assert not is_healthy(status)
    assert not is_only_saturated(status)


@given(U32, st.integers(-(2**31), 2**31 - 1))
def test_how_far_a_number_is_ahead_survives_the_wrap(previous: int, step: int) -> None:
    assert ahead((previous + step) % 2**32, previous) == step


def test_a_gap_across_the_wrap_is_counted_and_duplicates_and_stale_records_are_dropped() -> None:
    sequence = RdtSequence()
    came = [0xFFFFFFFD, 0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFE, 0, 3]
    assert [sequence.accept(n) for n in came] == [True, True, False, False, True, True]
    assert (sequence.lost, sequence.duplicate, sequence.out_of_order) == (3, 1, 1)


def test_a_stale_record_does_not_make_the_next_one_a_loss() -> None:
    sequence = RdtSequence()
    for n in (1000, 1001, 5, 1002):
        sequence.accept(n)
    assert (sequence.last, sequence.lost, sequence.out_of_order) == (1002, 0, 1)


@given(U32, st.lists(st.integers(0, 1000), min_size=1, max_size=60))
def test_every_record_is_accepted_duplicate_or_out_of_order_and_the_rest_of_the_span_is_lost(first, steps):
    sequence, accepted = RdtSequence(), []
    for step in steps:
        if sequence.accept((first + step) % 2**32):
            accepted.append(step)
    assert accepted == sorted(set(accepted))
    assert len(steps) == len(accepted) + sequence.duplicate + sequence.out_of_order
    assert len(accepted) + sequence.lost == max(steps) - steps[0] + 1


def test_a_measurement_that_does_not_count_on_stands_still() -> None:
    measurement = RdtMeasurement()
    came = [measurement.progress(n) for n in (0xFFFFFFFF, 0, 0, 0, 70)]
    assert came == [Advance.NEW, Advance.NEW, Advance.STALLED, Advance.STALLED, Advance.NEW]


@pytest.mark.parametrize("last", [10_000, 3_000_000_000])  # the second restarts by a step that seems forward
def test_a_second_record_confirms_a_restart_and_a_single_one_does_not(last: int) -> None:
    measurement = RdtMeasurement(last=last)
    assert measurement.progress(1) is Advance.BACK
    assert measurement.progress(last + 1) is Advance.NEW
    assert measurement.progress(1) is Advance.BACK
    assert measurement.progress(2) is Advance.RESTARTED
