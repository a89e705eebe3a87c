"""Identifiers in backticks name what exists: all docstrings, comments and messages of `src`, read as text."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache

import pytest
from tests.laws.sources import REPOSITORY, text, tree

SOURCES = (REPOSITORY / "src", REPOSITORY / "reproductions" / "src")
PATHS = {path: path.relative_to(source) for source in SOURCES for path in sorted(source.rglob("*.py"))}
"""Modules of every distribution, and the place of each in its own."""

QUOTED = re.compile(r"(?<!`)`([A-Za-z_]\w*(?:\.\w+)*)(?:\(\))?`(?!`)")
CAMEL_CASE = re.compile(r"_?[A-Z]+[a-z]\w*")
LIBRARIES = {"cv2", "numpy", "serial"}
FILES = {"csv", "css", "html", "json", "npz", "onnx", "toml"}

Names = dict[str, set[str]]


def identifiers(text: str) -> list[tuple[int, str]]:
    """Quoted identifiers that claim to be of the package: dotted, or of a class."""
    return [
        (number, name)
        for number, line in enumerate(text.splitlines(), start=1)
        for name in QUOTED.findall(line)
        if "." in name or CAMEL_CASE.fullmatch(name)
    ]


def names_in(body: list[ast.stmt]) -> set[str]:
    """Names that statements define or import, also under a condition."""
    names: set[str] = set()
    for node in body:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                names.add(name)
            case ast.Import(names=aliases) | ast.ImportFrom(names=aliases):
                names |= {(alias.asname or alias.name).partition(".")[0] for alias in aliases}
            case ast.Assign() | ast.AnnAssign():
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names |= {one.id for t in targets for one in ast.walk(t) if isinstance(one, ast.Name)}
            case ast.If(body=first, orelse=second) | ast.Try(body=first, orelse=second):
                names |= names_in(first) | names_in(second)
    return names


def classes_in(body: list[ast.stmt]) -> Iterator[ast.ClassDef]:
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield node
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            yield from classes_in(getattr(node, name, []))


def members_of(node: ast.ClassDef, lines: list[str]) -> set[str]:
    """Fields, methods and attributes that a class sets on itself."""
    own = re.findall(r"\bself\.(\w+)", "\n".join(lines[node.lineno - 1 : node.end_lineno]))
    return names_in(node.body) | set(own)


@cache
def package() -> tuple[Names, Names]:
    """Names of every module, by its dotted path; members of every class, inherited ones too, by its name."""
    modules: Names = {}
    members: Names = defaultdict(set)
    bases: dict[str, list[str]] = {}
    for path, place in PATHS.items():
        parts = place.with_suffix("").parts
        dotted = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        modules[dotted] = names_in(tree(path).body)
        lines = text(path).splitlines()
        for node in classes_in(tree(path).body):
            members[node.name] |= members_of(node, lines)
            bases[node.name] = [base.id for base in node.bases if isinstance(base, ast.Name)]
    for name in members:
        above = list(bases[name])
        while above:
            base = above.pop()
            members[name] |= members.get(base, set())
            above += bases.get(base, [])
    for dotted in list(modules):  # a package offers its modules
        above_it, _, stem = dotted.rpartition(".")
        modules.get(above_it, set()).add(stem)
    return modules, dict(members)


@cache
def exists(name: str) -> bool:
    """Tell whether an identifier is of the package, or a listed library's or a file's name."""
    modules, members = package()
    parts = name.split(".")
    if len(parts) == 1:
        return name in members or any(name in names for names in modules.values())
    if parts[0] in LIBRARIES or parts[-1] in FILES:
        return True
    if parts[-1] == "py":
        return any(dotted.endswith(f".{parts[-2]}") for dotted in modules)
    if parts[0] in members:
        return len(parts) == 2 and parts[1] in members[parts[0]]
    return any(_leads(f".{dotted}", names, parts) for dotted, names in modules.items())


def _leads(module: str, names: set[str], parts: list[str]) -> bool:
    """Tell whether the first parts end a module's path, and the rest is what it offers."""
    _, members = package()
    for split in range(len(parts), 0, -1):
        if module.endswith(f".{'.'.join(parts[:split])}"):
            match parts[split:]:
                case []:
                    return True
                case [one]:
                    return one in names
                case [kind, member]:
                    return kind in names and member in members.get(kind, set())
    return False


def test_what_stands_in_backticks_exists() -> None:
    assert PATHS
    dead = [
        (str(place), line, name)
        for path, place in PATHS.items()
        for line, name in identifiers(text(path))
        if not exists(name)
    ]
    assert dead == []


@pytest.mark.parametrize(
    "name",
    ["core.sensor.Sensor", "palpate.core", "Unit.to_si", "march.py", "numpy.load", "card.json", "Frame"],
)
def test_a_living_name_is_known(name: str) -> None:
    assert identifiers(f"# see `{name}`") == [(1, name)]
    assert exists(name)


@pytest.mark.parametrize(
    "name", ["core.sensor.Sensors", "palpate.studies", "mechanics.pairs", "Unit.in_si", "walk.py", "Descent"]
)
def test_a_dead_name_is_seen(name: str) -> None:
    assert identifiers(f'"""See `{name}`."""') == [(1, name)]
    assert not exists(name)
