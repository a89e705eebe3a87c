"""The menu of the documentation holds every page, from the first steps to the decisions."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="mkdocs brings it; `make test` installs it")

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
CONFIGURATION = yaml.safe_load((REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8"))
TEMPLATE = "decisions/0000-template.md"


def pages_of(entry: Any) -> Iterator[str]:
    """The pages of a menu's entry, in order."""
    if isinstance(entry, str):
        yield entry
    else:
        for part in entry.values() if isinstance(entry, dict) else entry:
            yield from pages_of(part)


MENU = list(pages_of(CONFIGURATION["nav"]))


def test_every_page_but_the_decisions_template_stands_in_the_menu_once() -> None:
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")} - {TEMPLATE}
    assert sorted(MENU) == sorted(pages)


def test_the_style_sheets_that_are_named_are_there() -> None:
    assert all((DOCS / name).is_file() for name in CONFIGURATION["extra_css"])
