"""Source files of both distributions, each read and parsed once for all laws."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = (REPOSITORY / "src" / "palpate", REPOSITORY / "reproductions" / "src" / "palpate_reproductions")
MODULES = {
    ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for package in PACKAGES
    for path in sorted(package.rglob("*.py"))
}


@cache
def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(text(path))


def containing(pattern: str, package: Path = PACKAGES[0]) -> Iterator[tuple[str, ast.Module]]:
    """Files of a package in whose text a pattern occurs, by their place in it: the others need no parsing."""
    for path in MODULES.values():
        if path.is_relative_to(package) and re.search(pattern, text(path)):
            yield path.relative_to(package).as_posix(), tree(path)
