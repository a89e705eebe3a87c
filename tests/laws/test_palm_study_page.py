"""The page on the palm's study says what its data say, in its tables and where its sentences quote them."""

from __future__ import annotations

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


def test_every_table_of_the_page_is_the_one_its_data_make() -> None:
    assert study.write(PAGE, study.stored()) == PAGE


def test_no_marker_is_misspelt_and_no_table_is_written_by_hand() -> None:
    assert set(BLOCKS) <= set(study.TABLES)
    assert len(re.findall(r"<!--", PAGE)) == 2 * len(BLOCKS)
    assert not [line for line in PROSE.splitlines() if line.startswith("|")]


def test_another_result_makes_another_page() -> None:
    data = study.stored()
    names = [name for name in data["found"] if name.startswith(("condition-", "mirror-", "setup-"))]
    assert len(names) > 10
    for name in names[:: len(names) // 8]:
        changed = copy.deepcopy(data)
        one = changed["found"][name]
        one.get("targets", one.get("new"))["force_N"]["mae"] *= 1.1
        assert study.write(PAGE, changed) != PAGE, name
