"""The words of the house: what a name and the first word of a docstring must be, over all of `src`."""

from __future__ import annotations

import ast
import importlib
import re
import types
from collections import defaultdict
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCES = (REPOSITORY / "src", REPOSITORY / "reproductions" / "src")
PATHS = {path: path.relative_to(source) for source in SOURCES for path in sorted(source.rglob("*.py"))}
"""Modules of every distribution, and the place of each in its own."""
PACKAGES = {".".join(place.parent.parts): path for path, place in PATHS.items() if path.name == "__init__.py"}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)

# A sentence that begins so has no noun: of what, as what, where what?
NOUNLESS = re.compile(r"(Of|Likewise|As|Where it|What it)\b")
# Such a word anywhere in a constant bounds something; what begins with MAX_ or MIN_ may go on as it likes.
EXTREMES = "MOST|LEAST|GREATEST|LARGEST|LONGEST|SHORTEST|HIGHEST|LOWEST|SMALLEST|STEEPEST|FEWEST|TRIES"
BOUND = re.compile(rf"(?!_?(?:MAX|MIN)_)_?(?:[A-Z0-9]+_)*(?:{EXTREMES})(?:_[A-Z0-9_]+)?")


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    return {str(place): ast.parse(path.read_text(encoding="utf-8")) for path, place in PATHS.items()}


def nounless(tree: ast.Module) -> list[str]:
    """Functions and classes whose docstring drops the noun."""
    return [
        f"{node.lineno} {node.name}"
        for node in ast.walk(tree)
        if isinstance(node, DEFINITIONS) and NOUNLESS.match(ast.get_docstring(node) or "")
    ]


def bounds(tree: ast.Module) -> list[str]:
    """Constants that name a bound otherwise than by MAX_ or MIN_."""
    targets = [
        target
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    ]
    names = [name for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    return [f"{name.lineno} {name.id}" for name in names if BOUND.fullmatch(name.id)]


def shared(places: dict[str, list[str]]) -> dict[str, list[str]]:
    return {name: where for name, where in places.items() if len(where) > 1}


def test_a_docstring_begins_with_its_noun_or_its_verb(trees) -> None:
    assert not {path: found for path, tree in trees.items() if (found := nounless(tree))}


def test_a_bound_is_a_maximum_or_a_minimum(trees) -> None:
    assert not {path: found for path, tree in trees.items() if (found := bounds(tree))}


def test_no_two_classes_share_a_name(trees) -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path}:{node.lineno}")
    assert not shared(places)


def test_no_two_modules_share_a_name() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for path, place in PATHS.items():
        if path.stem not in ("__init__", "__main__"):
            places[path.stem].append(str(place))
    assert not shared(places)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_offers_just_its_public_names(package: str) -> None:
    module = importlib.import_module(package)
    path = PACKAGES[package]
    public = public_names(ast.parse(path.read_text(encoding="utf-8")), package)
    assert public - set(module.__all__) == set(), "named in __all__, or by an underscore"
    modules = [name for name in module.__all__ if isinstance(getattr(module, name), types.ModuleType)]
    assert not modules, "a module is reached by its path"


def public_names(tree: ast.Module, package: str) -> set[str]:
    """Names that a package's file defines, or imports from its own modules, at its top."""
    names: set[str] = set()
    for node in tree.body:
        match node:
            case ast.ImportFrom(module=str(source), names=aliases) if source.startswith(f"{package}."):
                names |= {alias.asname or alias.name for alias in aliases}
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names.add(name)
            case ast.Assign(targets=targets):
                names |= {t.id for t in targets if isinstance(t, ast.Name)}
            case ast.AnnAssign(target=ast.Name(id=name)):
                names.add(name)
    # type checkers know TYPE_CHECKING by this name only; it offers nothing
    return {name for name in names if not name.startswith("_")} - {"TYPE_CHECKING"}


@pytest.mark.parametrize(
    "text", ["Of the stage.", "Likewise [Nm].", "As the device says.", "Where it is.", "What it can do."]
)
def test_a_docstring_without_a_noun_is_seen(text: str) -> None:
    assert nounless(ast.parse(f'def f():\n    """{text}"""'))
    assert not nounless(ast.parse('def f():\n    """Offset of the stage [m]."""'))


@pytest.mark.parametrize(
    "name",
    [
        "MOST_N",
        "_LEAST_PX",
        "GREATEST_DEPTH",
        "LONGEST_S",
        "MOST",
        "HAZE_MOST",
        "SPIKE_LEAST_N",
        "TRIES",
        "STOP_TRIES",
    ],
)
def test_a_bound_by_another_word_is_seen(name: str) -> None:
    assert bounds(ast.parse(f"{name}, other = 3, 4"))
    assert not bounds(ast.parse("MAX_N = MIN_LEAST = _MAX_TRIES = ALMOST = ENTRIES = least = 3"))
