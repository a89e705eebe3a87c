"""The page on where code lives is short, names every room, and draws the layers that imports keep."""

import re
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = (REPOSITORY / "docs" / "explanations" / "where-code-lives.md").read_text(encoding="utf-8")
PYPROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGE = REPOSITORY / "src" / "palpate"

Layers = list[set[str]]


def layers_in(lines: list[str]) -> Layers:
    """Rooms of each layer, the highest first."""
    return [{room.strip() for room in line.split("|")} for line in lines]


def drawn(page: str) -> Layers:
    """Layers of the first block without a language on a page."""
    block = re.search(r"^```\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert block, "the page draws the layers in a block of its own"
    return layers_in(block[1].splitlines())


def kept() -> Layers:
    """Layers of the contract that the imports are checked against."""
    contracts = PYPROJECT["tool"]["importlinter"]["contracts"]
    (layers,) = [contract["layers"] for contract in contracts if contract.get("containers") == ["palpate"]]
    return layers_in(layers)


def rooms() -> set[str]:
    """Packages and modules that lie directly in palpate, but what holds its version."""
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    return folders | {path.stem for path in PACKAGE.glob("*.py")} - {"__init__", "version"}


def test_the_diagram_is_that_of_the_import_contract() -> None:
    assert drawn(PAGE) == kept()


@pytest.mark.parametrize("change", [("cli\n", ""), ("sensors\nestimators", "estimators\nsensors")])
def test_a_diagram_with_a_room_left_out_or_moved_is_another(change: tuple[str, str]) -> None:
    assert drawn(PAGE.replace(*change, 1)) != kept()


def test_every_room_stands_once_in_the_diagram_and_once_in_the_table() -> None:
    table = re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE)
    assert sorted(room for layer in drawn(PAGE) for room in layer) == sorted(rooms())
    assert sorted(table) == sorted(rooms())
