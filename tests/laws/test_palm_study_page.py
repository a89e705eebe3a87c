"""The page on the palm's study says what its data say, in its tables and where its sentences quote them."""

import copy
import re
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "reproductions" / "studies"))

import palm_study_page as study  # noqa: E402

PAGE = study.PAGE.read_text(encoding="utf-8")
BLOCKS = dict(study.BLOCK.findall(PAGE))
PROSE = re.sub(r"```.*?```", "", study.BLOCK.sub("", PAGE), flags=re.DOTALL)
FIGURE = re.compile(r"(?<![\w.])(?:\d+\.\d+|\d+(?:\.\d+)?(?= %))")
TOKEN = re.compile(r"\d+(?:\.\d+)?")

SET = {
    *("7", "0.4", "4.8"),  # of the protocol: the grid's step, and depths [mm]
    "0.3",  # by which Adam's step falls
    *("15", "10", "20", "30", "5"),  # conditions, by how many per cent something was changed
    *("90", "95"),  # what intervals promise
}
"""Figures that sentences may name without a table: what was set, and not found."""


def figures(text: str) -> set[str]:
    return set(FIGURE.findall(text))


def quoted() -> set[str]:
    return {token for body in BLOCKS.values() for token in TOKEN.findall(body)}


def test_every_table_of_the_page_is_the_one_its_data_make() -> None:
    assert study.write(PAGE, study.stored()) == PAGE


def test_no_marker_is_misspelt_and_no_table_is_written_by_hand() -> None:
    assert set(BLOCKS) <= set(study.TABLES)
    assert len(re.findall(r"<!--", PAGE)) == 2 * len(BLOCKS)
    assert not [line for line in PROSE.splitlines() if line.startswith("|")]


def test_a_figure_of_a_sentence_stands_in_a_table_or_was_set() -> None:
    assert figures(PROSE) - quoted() - SET == set()


def test_another_result_makes_another_page() -> None:
    data = study.stored()
    names = [name for name in data["found"] if name.startswith(("condition-", "mirror-", "setup-"))]
    assert len(names) > 10
    for name in names[:: len(names) // 8]:
        changed = copy.deepcopy(data)
        one = changed["found"][name]
        one.get("targets", one.get("new"))["force_N"]["mae"] *= 1.1
        assert study.write(PAGE, changed) != PAGE, name


def test_a_figure_that_no_table_has_would_be_found() -> None:
    assert figures("off by 0.0123 N in 3.7 % of 12 frames, 96 px") == {"0.0123", "3.7"}
    assert "0.0123" not in quoted() | SET
