"""Reading a Net F/T box's page, which is anybody's text."""

import math

import pytest
from hypothesis import example, given, strategies as st
from tests.refusals import refused

from palpate.core import ProtocolError
from palpate.rig.real.netft.netft_calibration import calibration


def page(**fields: str) -> bytes:
    told = {"prodname": "Net F/T", "cfgcpf": "1000000", "cfgcpt": "1000000", "scfgfu": "N", "scfgtu": "Nm"}
    told |= fields
    body = "".join(f"<{name}>{value}</{name}>" for name, value in told.items())
    return f'<?xml version="1.0"?><netft>{body}</netft>'.encode()


def test_a_page_says_counts_units_range_rate_and_what_the_box_subtracts() -> None:
    found = calibration(
        page(
            cfgcalsn="FT12345", cfgmr="330;330;990;30;30;30", comrdtrate="7000", setbias="745;17;0;184;-596;0"
        )
    )
    assert (found.product, found.serial) == ("Net F/T", "FT12345")
    assert (found.counts_per_n, found.counts_per_nm, found.rate_hz) == (1e6, 1e6, 7000)
    assert found.range_n == (330, 330, 990)
    assert found.device_bias == "745;17;0;184;-596;0"
    assert found.force_n((1_000_000, -2_000_000, 500_000, 0, 0, 0)) == (1.0, -2.0, 0.5)
    assert found.torque_nm((0, 0, 0, 1, -2, 3)) == (1e-6, -2e-6, 3e-6)


# Newtons and newton metres of one unit, typed from the definitions: 1 lb = 0.45359237 kg, g = 9.80665 m/s2,
# 1 in = 25.4 mm.
@pytest.mark.parametrize(
    ("unit", "newtons"),
    [
        ("lbf", 4.4482216152605), ("N", 1.0), ("klbf", 4448.2216152605), ("kN", 1000.0), ("kgf", 9.80665),
        ("gf", 9.80665e-3),
    ],
)  # fmt: skip
def test_every_force_unit_becomes_newtons(unit: str, newtons: float) -> None:
    found = calibration(page(cfgcpf="4000", scfgfu=unit, cfgmr="2;2;4;1;1;1"))
    assert found.force_n((4000, 8000, -4000, 0, 0, 0)) == pytest.approx((newtons, 2 * newtons, -newtons))
    assert found.range_n == pytest.approx((2 * newtons, 2 * newtons, 4 * newtons))


@pytest.mark.parametrize(
    ("unit", "newton_metres"),
    [
        ("lbf-in", 0.1129848290276167), ("lbf-ft", 1.3558179483314004), ("N-m", 1.0), ("Nm", 1.0),
        ("N-mm", 1e-3), ("Nmm", 1e-3), ("kgf-cm", 0.0980665), ("kg-cm", 0.0980665), ("kN-m", 1000.0),
        ("kNm", 1000.0),
    ],
)  # fmt: skip
def test_every_torque_unit_in_either_spelling_becomes_newton_metres(unit: str, newton_metres: float) -> None:
    found = calibration(page(cfgcpt="999.999", scfgtu=unit))
    assert found.torque_nm((0, 0, 0, 999999, 0, 0))[0] == pytest.approx(1000 * newton_metres)


def test_what_a_page_does_not_say_is_not_known() -> None:
    found = calibration(page())
    assert found.rate_hz is None
    assert found.range_n is None
    assert calibration(page(cfgmr="0;0;0;0;0;0")).range_n is None


@pytest.mark.parametrize("name", ["prodname", "cfgcpf", "cfgcpt", "scfgfu", "scfgtu"])
def test_a_field_that_is_missing_empty_double_nested_or_too_long_is_refused(name: str) -> None:
    whole = page()
    start, end = whole.index(f"<{name}>".encode()), whole.index(f"</{name}>".encode()) + len(name) + 3
    field = whole[start:end]
    for wrong in (b"", f"<{name}/>".encode(), f"<{name}>  </{name}>".encode(), field + field):
        with pytest.raises(ProtocolError, match=name):
            calibration(whole.replace(field, wrong))
    with refused("field-nested", ProtocolError):
        calibration(page(**{name: "<b>1</b>"}))
    with pytest.raises(ProtocolError, match="128 characters"):
        calibration(page(**{name: "1" * 129}))


@pytest.mark.parametrize("name", ["cfgcpf", "cfgcpt", "comrdtrate"])
@pytest.mark.parametrize(
    "number", ["nan", "inf", "-1", "0", "-0.0", "1e999", "1_000", "0x10", "1,5", "١٢", "1 2", "1e", "N"]
)
def test_a_number_that_is_not_plain_finite_and_positive_is_refused(name: str, number: str) -> None:
    with pytest.raises(ProtocolError, match=name):
        calibration(page(**{name: number}))


@pytest.mark.parametrize("counts", ["1e-320", "1e-300", "5e-324"])
def test_counts_that_would_overflow_a_force_are_refused(counts: str) -> None:
    with pytest.raises(ProtocolError, match="cfgcpf"):
        calibration(page(cfgcpf=counts))


@pytest.mark.parametrize("ranges", ["", "1;2;3", "1;2;3;4;5;x", "1;2;-3;4;5;6", "1;2;3;4;5;nan"])
def test_a_range_that_is_not_six_numbers_is_refused(ranges: str) -> None:
    with pytest.raises(ProtocolError, match="cfgmr"):
        calibration(page(cfgmr=ranges))


@pytest.mark.parametrize(
    ("name", "unit"), [("scfgfu", "n"), ("scfgfu", "newton"), ("scfgfu", "Nm"), ("scfgtu", "mN-m")]
)
def test_a_unit_that_is_not_known_is_refused_with_those_that_are(name: str, unit: str) -> None:
    with refused("unit-unknown", ProtocolError):
        calibration(page(**{name: unit}))


@pytest.mark.parametrize(
    "doctype",
    [
        b"<!DOCTYPE netft>",
        b'<!DOCTYPE netft SYSTEM "file:///etc/passwd">',
        b'<!DOCTYPE netft [<!ENTITY a "1000000">]>',
        b'<!DOCTYPE netft [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>',
    ],
)
def test_document_types_and_entities_are_refused(doctype: bytes) -> None:
    with refused("xml-entity", ProtocolError):
        calibration(page().replace(b"<netft>", doctype + b"<netft>"))


def test_a_page_that_is_too_long_is_refused_unread() -> None:
    with pytest.raises(ProtocolError, match="65536 bytes"):
        calibration(b" " * 65537)


@pytest.mark.parametrize(
    "junk", [b"", b"<html>", b"\xff\xfe", page()[:-4], b'<?xml version="1.0" encoding="x"?><a/>']
)
def test_what_is_not_xml_is_refused(junk: bytes) -> None:
    with pytest.raises(ProtocolError, match="Net F/T"):
        calibration(junk)


@given(st.binary(max_size=300))
@example(b'<?xml version="1.0" encoding="utf-7"?><a/>')
@example(b'<?xml version="1.0" encoding="hex"?><a/>')
@example(b'<?xml version="1.0" encoding="idna"?><a/>')
@example(b"<a>" * 20000)
def test_any_bytes_are_a_page_or_a_protocol_error(junk: bytes) -> None:
    with pytest.raises(ProtocolError):
        calibration(junk)  # no 300 bytes at random have all five fields


@given(st.data())
def test_a_page_with_changed_bytes_gives_finite_positive_numbers_or_a_protocol_error(data):
    raw = bytearray(page(cfgmr="330;330;990;30;30;30", comrdtrate="500"))
    for _ in range(data.draw(st.integers(1, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    try:
        found = calibration(bytes(raw))
    except ProtocolError:
        return
    for number in (found.counts_per_n, found.counts_per_nm, found.rate_hz or 1.0, *(found.range_n or ())):
        assert 0 < number < math.inf
    assert all(map(math.isfinite, found.force_n((-(2**31), 2**31 - 1, 0, 0, 0, 0))))
