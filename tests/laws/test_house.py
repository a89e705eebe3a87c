"""The house rules that a machine can check. Rooms are found, not listed: a new one needs no edit here."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
from tests.laws.sources import MODULES, PACKAGES, REPOSITORY, containing, text, tree

import palpate
import palpate.core.shapes
from palpate.core import Contact, ManualClock, Pose, Probe
from palpate.core.units import UNITS
from palpate.version import __version__

ROOMS = [name for name, path in MODULES.items() if path.name == "__init__.py"]

# Only what trains may need torch; everything else runs where it is not installed.
NEEDS_TORCH = ("palpate.estimators.networks", "palpate.sensors.palm.networks")
CAN_NEED_TORCH = r"\b(?:torch|jaxtyping|networks)\b"
"""What a module's text contains that imports one of them, or what may import them."""


def run_python(code: str, folder: Path) -> str:
    """Run code in a fresh interpreter, warnings as errors, and return what it printed."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def imports(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Modules that a node imports, and the name taken from each ("" for the module itself)."""
    match tree:
        case ast.Import(names=aliases):
            yield from ((alias.name, "") for alias in aliases)
        case ast.ImportFrom(module=str(module), names=aliases):
            yield from ((module, alias.name) for alias in aliases)


def when_loaded(body: list[ast.stmt]) -> Iterator[tuple[str, str]]:
    """Imports that a module makes when it loads."""
    for node in body:
        yield from imports(node)
        match node:
            case ast.If(test=test, body=then, orelse=other):
                yield from when_loaded(other if "TYPE_CHECKING" in ast.unparse(test) else then + other)
            case ast.With(body=then) | ast.ClassDef(body=then):
                yield from when_loaded(then)
            case ast.Try(body=then, orelse=other):
                yield from when_loaded(then + other)


@cache
def words_of(module: str) -> set[str]:
    return (
        set(re.findall(r"\w+", MODULES[module].read_text(encoding="utf-8"))) if module in MODULES else set()
    )


def test_scripts_that_seldom_run_import_only_what_exists() -> None:
    missing = [
        f"{path.relative_to(REPOSITORY)}: {module}.{name}"
        for folder in ("tools", "benchmarks", "examples", "reproductions")
        for path in sorted((REPOSITORY / folder).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for module, name in imports(node)
        if module.split(".")[0] in {package.name for package in PACKAGES}
        and name not in words_of(module)
        and f"{module}.{name}".rstrip(".") not in MODULES
    ]
    assert not missing


def test_every_package_offers_exactly_its_public_names() -> None:
    for room in ROOMS:
        package = tree(MODULES[room])
        bound = {
            alias.asname or alias.name for node in ast.walk(package) for alias in getattr(node, "names", ())
        }
        (names,) = [
            ast.literal_eval(node.value)
            for node in package.body
            if isinstance(node, ast.Assign | ast.AnnAssign) and ast.unparse(node).startswith("__all__")
        ]
        assert ast.get_docstring(package), room
        assert len(names) == len(set(names)), room
        assert set(names) <= bound | public_names(package, room) | {"__version__"}, room
        assert public_names(package, room) <= set(names), room


def public_names(tree: ast.Module, package: str) -> set[str]:
    """Names that the file of a package defines, or imports from its own modules, at its top."""
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


CLASS = re.compile(r"^ *class (\w+)", re.MULTILINE)


def test_no_two_classes_and_no_two_modules_share_a_name() -> None:
    classes = [name for path in MODULES.values() for name in CLASS.findall(text(path))]
    modules = [path.stem for path in MODULES.values() if path.stem not in ("__init__", "__main__")]
    assert not [name for names in (classes, modules) for name, n in Counter(names).items() if n > 1]


def test_palpate_offers_a_short_list_of_names() -> None:
    assert 1 <= len(palpate.__all__) <= 40
    scope: dict[str, object] = {}
    exec("from palpate import *", scope)
    assert set(palpate.__all__) <= set(scope)


def test_shapes_and_types_are_checked_in_tests() -> None:
    clock = ManualClock()
    clock.sleep(1)  # an int may stand for a float
    with pytest.raises(jaxtyping.TypeCheckError):
        clock.sleep("1")
    grid = np.zeros((2, 3))
    rest = (grid > 0, 0.0, 0.0, Probe("sphere", 5e-3), Pose(0.0, 0.0, 0.0), "none")
    Contact(np.zeros(3), np.zeros(2), grid, grid, *rest)
    with pytest.raises(jaxtyping.TypeCheckError):
        Contact(np.zeros(3), np.zeros(2), grid, grid.T, *rest)


def test_importing_palpate_and_its_verbs_loads_nothing_heavy(tmp_path: Path) -> None:
    code = "import sys, palpate, palpate.cli; print(*{'torch', 'matplotlib', 'sklearn'} & set(sys.modules))"
    assert run_python(code, tmp_path) == ""


def test_only_what_trains_needs_torch_and_nothing_needs_jaxtyping() -> None:
    needs = {
        name: {part for source, one in when_loaded(module.body) for part in (source, f"{source}.{one}")}
        for name, path in MODULES.items()
        if re.search(CAN_NEED_TORCH, text(path))
        for module in [tree(path)]
    }
    heavy = {
        name for name, parts in needs.items() if {"torch", "jaxtyping"} & {p.split(".")[0] for p in parts}
    }
    while more := {
        name
        for name, parts in needs.items()
        if name not in heavy
        and (heavy & parts or any(part.startswith(f"{one}.") for one in heavy for part in parts))
    }:
        heavy |= more
    assert set(NEEDS_TORCH) <= set(MODULES)
    assert any(name.startswith(NEEDS_TORCH) for name in heavy)
    assert not [name for name in heavy if not name.startswith(NEEDS_TORCH)]


PICKLERS = {"pickle", "cPickle", "_pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}


def test_no_module_pickles() -> None:
    words = "|".join([*PICKLERS, "torch", "allow_pickle", "read_pickle", "to_pickle"])
    found = {name: pickling(tree) for package in PACKAGES for name, tree in containing(words, package)}
    assert found
    assert not {name: calls for name, calls in found.items() if calls}


def pickling(tree: ast.AST) -> list[str]:
    """Imports and calls through which a pickle could be written or read."""
    found = []
    for node in ast.walk(tree):
        match node:
            case ast.Import(names):
                found += [alias.name for alias in names if alias.name.split(".")[0] in PICKLERS]
            case ast.ImportFrom(module=str(module)) if module.split(".")[0] in PICKLERS:
                found.append(module)
            case ast.Attribute(value=ast.Name(id="torch"), attr="save" | "load" as verb):
                found.append(f"torch.{verb}")
            case ast.keyword(arg="allow_pickle", value=ast.Constant(value=True)):
                found.append("allow_pickle=True")
            case ast.Attribute(attr="read_pickle" | "to_pickle" as verb):
                found.append(verb)
    return found


@pytest.mark.parametrize(
    "code",
    [
        "import pickle",
        "import os, joblib.externals",
        "from pickle import loads",
        "torch.save(model, path)",
        "np.load(path, allow_pickle=True)",
        "pd.read_pickle(path)",
    ],
)
def test_every_way_to_pickle_is_seen(code: str) -> None:
    assert pickling(ast.parse(code))


# A folder that only one machine has. In pieces, so that this line does not match itself.
MACHINE_PATH = re.compile(
    r"(?<![\w.~$})/-])/(?:" + "|".join(["home", "root", "work", "tmp", "Users"]) + r")/\w"
)


def text_files() -> list[Path]:
    """Everything a person wrote, in the folders that hold such files and beside them."""
    names = ("src", "reproductions", "tests", "docs", "examples", "benchmarks", "tools", ".ci")
    folders = [REPOSITORY / name for name in names]
    kinds = {".py", ".md", ".toml", ".yml", ".txt", ".html", ".css", ".cff", ".csv", ".json", ""}
    inside = [path for folder in folders for path in folder.rglob("*")]
    return sorted(
        path
        for path in [*inside, *REPOSITORY.iterdir()]
        if path.is_file()
        and path.suffix in kinds
        and "egg-info" not in str(path)
        and path.name not in (".coverage", ".git")  # a worktree's .git is a file
    )


def test_no_file_names_a_folder_of_one_machine() -> None:
    found = {
        str(path.relative_to(REPOSITORY)): match.group()
        for path in text_files()
        if (match := MACHINE_PATH.search(path.read_text(encoding="utf-8", errors="replace")))
    }
    assert not found


def test_a_folder_of_one_machine_is_seen() -> None:
    assert MACHINE_PATH.search("open('" + "/home" + "/ada/run')")
    assert not MACHINE_PATH.search("https://example.org" + "/home" + "/ada")


@pytest.mark.slow
def test_the_readme_s_python_runs(tmp_path: Path) -> None:
    readme = REPOSITORY / "README.md"
    if not readme.exists():
        pytest.skip("there is no README.md")
    blocks = re.findall(
        r"^```python\n(.*?)^```", readme.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    assert blocks
    for block in blocks:
        run_python(block, tmp_path)


def test_the_citation_names_this_version() -> None:
    citation = (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", citation, re.MULTILINE) == [__version__]


def test_the_distributions_have_one_version_and_one_license() -> None:
    other = REPOSITORY / "reproductions"
    about = tomllib.loads((other / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert about["version"] == __version__
    assert (other / "LICENSE").read_bytes() == (REPOSITORY / "LICENSE").read_bytes()


def test_the_conventions_name_every_unit_and_axis() -> None:
    page = (REPOSITORY / "docs" / "explanations" / "conventions.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in page.splitlines() if line.startswith("|")]
    named = {symbol for row in rows for cell in row[1:3] for symbol in re.findall(r"`(\w+)`", cell)}
    axes = set(re.findall(r"`(\w+)`", palpate.core.shapes.__doc__ or ""))
    assert set(UNITS) | axes <= named
