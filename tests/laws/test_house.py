"""The house rules that a machine can check. Rooms are found, not listed: a new one needs no edit here."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
import tomllib
import types
from collections import Counter
from functools import cache
from pathlib import Path

import jaxtyping
import numpy as np
import pytest

import palpate
import palpate.core.shapes
from palpate.core import Contact, ManualClock, Pose, Probe
from palpate.core.units import UNITS
from palpate.version import __version__

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = (REPOSITORY / "src" / "palpate", REPOSITORY / "reproductions" / "src" / "palpate_reproductions")
MODULES = {
    ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for package in PACKAGES
    for path in sorted(package.rglob("*.py"))
}
ROOMS = [name for name, path in MODULES.items() if path.name == "__init__.py"]

# Only what trains may need torch; everything else runs where it is not installed.
NEEDS_TORCH = ("palpate.estimators.networks", "palpate.sensors.palm.networks")


@cache
def trees() -> dict[str, ast.Module]:
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


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


def imports_of_palpate(path: Path) -> list[tuple[str, str]]:
    return [
        (node.module, alias.name)
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").split(".")[0] in {package.name for package in PACKAGES}
        for alias in node.names
    ]


@pytest.mark.parametrize("folder", ["tools", "benchmarks", "examples", "reproductions"])
def test_scripts_that_seldom_run_import_only_what_exists(folder: str) -> None:
    missing = [
        f"{path.relative_to(REPOSITORY)}: {module}.{name}"
        for path in sorted((REPOSITORY / folder).rglob("*.py"))
        for module, name in imports_of_palpate(path)
        if not hasattr(importlib.import_module(module), name) and f"{module}.{name}" not in MODULES
    ]
    assert not missing


def test_every_package_offers_exactly_its_public_names() -> None:
    for room in ROOMS:
        module = importlib.import_module(room)
        names = module.__all__
        assert module.__doc__
        assert len(names) == len(set(names)), room
        assert not [name for name in names if not hasattr(module, name)], room
        assert not [name for name in names if isinstance(getattr(module, name), types.ModuleType)], room
        assert public_names(trees()[room], room) <= set(names), room


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


def test_no_two_classes_and_no_two_modules_share_a_name() -> None:
    classes = [n.name for tree in trees().values() for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
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


def test_only_what_trains_needs_torch_and_nothing_needs_jaxtyping(tmp_path: Path) -> None:
    code = f"""
import importlib, sys

class Without:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "jaxtyping"):
            raise ModuleNotFoundError(f"no {{name}} in this test", name=name)

sys.meta_path.insert(0, Without())
for name in {list(MODULES)}:
    try:
        importlib.import_module(name)
    except ImportError as e:
        print(name, e)
"""
    assert set(NEEDS_TORCH) <= set(MODULES)
    refused = run_python(code, tmp_path).splitlines()
    assert not [line for line in refused if not line.startswith(NEEDS_TORCH)]


def test_no_module_pickles() -> None:
    found = {name: pickling(tree) for name, tree in trees().items()}
    assert found
    assert {name: calls for name, calls in found.items() if calls} == {}


def pickling(tree: ast.AST) -> list[str]:
    """Imports and calls through which a pickle could be written or read."""
    picklers = {"pickle", "cPickle", "_pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}
    found = []
    for node in ast.walk(tree):
        match node:
            case ast.Import(names):
                found += [alias.name for alias in names if alias.name.split(".")[0] in picklers]
            case ast.ImportFrom(module=str(module)) if module.split(".")[0] in picklers:
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
