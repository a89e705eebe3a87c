"""The parser takes any bytes, in any pieces, and what firmware was seen to say comes out as it was meant."""

from contextlib import suppress
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from palpate.core.errors import ProtocolError
from palpate.rig.real.grbl.grbl_parser import (
    MAX_LINE,
    Alarm,
    Banner,
    Failed,
    GrblMessage,
    GrblState,
    GrblStatus,
    Ok,
    Setting,
    Splitter,
    parse_line,
)

SAID = {
    b"ok": Ok(),
    b"error:20": Failed(20),
    b"ALARM:5": Alarm(5),
    b"Grbl 1.1h ['$' for help]": Banner("Grbl", "1.1h"),
    b"GrblHAL 1.1f ['$' or '$HELP' for help]": Banner("GrblHAL", "1.1f"),
    b"$110=500.000": Setting(110, "500.000"),
    b"[MSG:Caution: Unlocked]": GrblMessage("MSG", "Caution: Unlocked"),
    b"[PRB:0.000,0.000,-0.872:1]": GrblMessage("PRB", "0.000,0.000,-0.872:1"),
    b"<Idle|MPos:1.000,-2.500,0.000|Bf:15,128|FS:0,0|Pn:PX|WCO:1.000,0.000,0.000|Ov:100,100,100>": GrblStatus(
        GrblState.IDLE, machine_mm=(1.0, -2.5, 0.0), offset_mm=(1.0, 0.0, 0.0), feed_mm_min=0.0,
        free_blocks=15, pins="PX",
    ),
    b"<Hold:1|WPos:0.000,0.000,0.000|F:120|H:0|New:7>": GrblStatus(
        GrblState.HOLD, substate=1, work_mm=(0.0, 0.0, 0.0), feed_mm_min=120.0, homed=False
    ),
    b"<Dance|MPos:0.000,0.000,0.000>": GrblStatus(GrblState.UNKNOWN, machine_mm=(0.0, 0.0, 0.0)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("said", "meant"), SAID.items(), ids=lambda x: x.decode() if isinstance(x, bytes) else ""
)
def test_what_firmware_says_is_what_is_read(said, meant):
    assert parse_line(said) == meant
    assert parse_line(said + b"\r") == meant


@pytest.mark.parametrize(
    "line",
    [
        b"", b"okk", b"error:", b"error:1e3", b"ALARM:-1", b"<Idle|MPos:0.000,nan,0.000>",
        b"<Idle|MPos:1e3,0.000,0.000>", b"<Idle|MPos:inf,0.000,0.000>", b"<Idle|MPos:0.000,0.0",
        b"<|MPos:0.000,0.000,0.000>", b"[MSG:cut", b"Gr\xffbl 1.1h", b"x" * (MAX_LINE + 1),
    ],
)  # fmt: skip
def test_what_is_damaged_is_refused(line):
    with pytest.raises(ProtocolError):
        parse_line(line)


@given(st.binary(max_size=2 * MAX_LINE))
def test_any_bytes_are_a_line_or_a_protocol_error(data):
    with suppress(ProtocolError):
        parse_line(data)


NEAR = [b"<", b">", b"Idle", b"Hold:", b"|", b"MPos:", b"FS:", b"1.5", b"-", b",", b":", b"[", b"]", b"PRB:"]
NEAR += [b"error:", b"ALARM:", b"$", b"=", b"9", b"\r", b"\n", b"\xff", b"\0", b"Grbl ", b"nan", b"H:", b"ok"]


@given(st.lists(st.sampled_from(NEAR), max_size=40).map(b"".join))
def test_nearly_right_bytes_are_lines_or_protocol_errors(data):
    for line in Splitter().feed(data + b"\n"):
        with suppress(ProtocolError):
            parse_line(line)


@given(st.lists(st.sampled_from(sorted(SAID)), max_size=8), st.lists(st.integers(0, 400), max_size=6))
def test_lines_are_the_same_however_the_stream_is_broken_up(lines, cuts):
    stream = b"".join(line + b"\r\n" for line in lines)
    edges = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    splitter = Splitter()
    got = [line for a, b in pairwise(edges) for line in splitter.feed(stream[a:b])]
    assert got == lines


@given(st.lists(st.binary(max_size=300), max_size=20))
def test_the_splitter_never_keeps_more_than_a_line(pieces):
    splitter = Splitter()
    for piece in pieces:
        for line in splitter.feed(piece.replace(b"\n", b"<").replace(b"\r", b"[")):
            assert len(line) <= MAX_LINE + 1
        assert len(splitter._line) <= MAX_LINE + 1
        assert len(splitter._around) <= len(b"error:123")


def test_a_long_line_costs_itself_and_not_the_next():
    lines = list(Splitter().feed(b"y" * 10_000 + b"\nok\n"))
    with pytest.raises(ProtocolError):
        parse_line(lines[0])
    assert [parse_line(line) for line in lines[1:]] == [Ok()]


@pytest.mark.parametrize(
    "stream",
    [b"o<Idle|F:0>\r\nk\r\n", b"<Idle|F:0>\r\nok\r\n", b"ok<Idle|F:0>\r\n", b"\xfe<Idle|F:0>\r\nok\r\n"],
)
def test_a_report_in_the_midst_of_a_reply_costs_neither(stream):
    heard = []
    for line in Splitter().feed(stream):
        try:
            heard.append(parse_line(line))
        except ProtocolError:
            assert line == b"\xfe"
    assert sorted(type(line).__name__ for line in heard) == ["GrblStatus", "Ok"]
