"""The pages say of what is verified what the comparisons themselves say, and their pictures are there."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mpmath", reason="the comparisons need mpmath; `make test` installs it")

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
PAGES = [DOCS / "explanations" / "palm.md", DOCS / "explanations" / "verification.md"]
QUICK_ROOMS = ("contact", "tables")
QUICK_TABLES = ("spread", "assumptions", "off-centre")
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")
MAX_A_PICTURE, MAX_ALL = 250_000, 1_800_000  # bytes

sys.path.insert(0, str(REPOSITORY / "tools"))

import verification  # noqa: E402

ROOMS, MEASURED = verification.ORACLES, verification.MEASURED


def blocks(kind: str) -> dict[str, str]:
    return {name: body for _, found, name, body in verification.blocks() if found == kind}


def stood(room: str) -> Iterator[tuple[verification.Oracle, float]]:
    """Each oracle of a room, and what its page says was found."""
    rows = verification.rows_of(blocks("verified")[room])
    return ((o, verification.error_of(rows[o.name, o.against])) for o in ROOMS[room])


def test_every_marker_names_what_there_is_and_all_there_is_has_a_marker() -> None:
    assert set(blocks("verified")) == set(ROOMS)
    assert set(blocks("measured")) == set(MEASURED)


def test_no_marker_is_misspelt() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        ends = len(re.findall(r"<!--", text))
        assert ends == 2 * len(verification.BLOCK.findall(text)), f"{page.name}: a comment that is no marker"


@pytest.mark.parametrize("room", ROOMS)
def test_the_rows_of_a_room_are_its_oracles(room: str) -> None:
    body = blocks("verified")[room].strip()
    found = verification.rows_of(body)
    texts = [found.get((o.name, o.against), "no such row") for o in ROOMS[room]]
    assert verification.checks(room, texts) == body


@pytest.mark.parametrize("room", ROOMS)
def test_nothing_found_is_more_than_allowed(room: str) -> None:
    for oracle, error in stood(room):
        # A page holds two digits, so what it rounds down by is at most 5 in 100.
        assert 0 <= error <= oracle.allowed, f"{oracle.name} against {oracle.against}"


def test_an_error_is_written_to_two_digits_and_read_back() -> None:
    for error in (0.0, 3.2e-14, 1.049e-2, 0.5, 2.0):
        assert verification.error_of(verification.text_of(error)) == pytest.approx(error, rel=0.05)
    assert verification.error_of(verification.text_of(1e-16)) == verification.ROUNDING


def test_an_error_that_two_digits_would_round_down_still_fails() -> None:
    oracle = verification.Oracle("what", "other", 1e-2, lambda: 1.04e-2)
    assert verification.found(oracle, {}) == ("1.0e-2", False)
    assert not verification.found(verification.Oracle("what", "other", 1e-2, lambda: float("nan")), {})[1]


def test_what_could_not_be_run_does_not_pass_unseen() -> None:
    oracle = verification.Oracle("what", "other", 1e-2, lambda: 1.0, needs="a_package_that_is_not")
    assert verification.found(oracle, {}) == (verification.NOT_RUN, False)
    assert verification.found(oracle, {("what", "other"): "2.0e-3"}) == ("2.0e-3", True)
    assert verification.found(oracle, {("what", "other"): "2.0e-2"}) == ("2.0e-2", False)


def test_the_palm_s_pages_show_every_picture_and_all_are_small() -> None:
    drawn = {path.name: path.stat().st_size for path in (DOCS / "images").glob("palm-*.png")}
    shown = {
        name for page in DOCS.rglob("*.md") for name in re.findall(r"palm-[\w-]+\.png", page.read_text())
    }
    assert shown == set(drawn)
    assert max(drawn.values()) <= MAX_A_PICTURE
    assert sum(drawn.values()) <= MAX_ALL


def run_anew(room: str) -> None:
    for oracle, before in stood(room):
        _, passes = verification.found(oracle, {(oracle.name, oracle.against): verification.text_of(before)})
        assert passes, f"{oracle.name} against {oracle.against}"


def measure_anew(name: str) -> None:
    """The same words, and numbers alike but for their last digit, which may differ between machines."""
    then, now = blocks("measured")[name].strip(), MEASURED[name]()
    assert NUMBER.sub("#", then) == NUMBER.sub("#", now)
    for one, other in zip(NUMBER.findall(then), NUMBER.findall(now), strict=True):
        digits = len(one.partition(".")[2]) if "e" not in one else 12
        assert np.isclose(float(one), float(other), rtol=0.02, atol=1.01 * 10.0**-digits), f"{one}, {other}"


@pytest.mark.parametrize("room", QUICK_ROOMS)
def test_quick_oracles_still_pass(room: str) -> None:
    run_anew(room)


@pytest.mark.parametrize("name", QUICK_TABLES)
def test_quick_tables_still_hold(name: str) -> None:
    measure_anew(name)


@pytest.mark.slow
@pytest.mark.parametrize("room", sorted(set(ROOMS) - set(QUICK_ROOMS)))
def test_all_other_oracles_still_pass(room: str) -> None:
    run_anew(room)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(MEASURED) - set(QUICK_TABLES)))
def test_all_other_tables_still_hold(name: str) -> None:
    measure_anew(name)


@pytest.mark.slow
def test_the_how_to_s_python_runs() -> None:
    page = (DOCS / "how-to" / "render-a-palm.md").read_text(encoding="utf-8")
    [code] = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    scope: dict[str, object] = {}
    exec(code, scope)
    assert {"frame", "pulled", "carried", "yours"} <= set(scope)
