"""A missing optional package always names its extra; each extra is blocked alone and all at once."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from tests.laws.sources import containing
from tests.refusals import refused

from palpate.core.errors import InputError, MissingExtraError
from palpate.core.optional_imports import EXTRAS, check_installed, optional_imports, require

PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"


@pytest.fixture
def block(monkeypatch: pytest.MonkeyPatch):
    """Blocks an optional module, as if it were not installed."""

    class Blocked:
        def __init__(self, name: str) -> None:
            self.name = name

        def find_spec(self, name: str, path: object = None, target: object = None) -> None:
            if name.partition(".")[0] == self.name:
                raise ModuleNotFoundError(f"No module named {name!r}", name=self.name)

    def begin(name: str) -> None:
        for loaded in [one for one in sys.modules if one.partition(".")[0] == name]:
            monkeypatch.delitem(sys.modules, loaded)
        monkeypatch.setattr(sys, "meta_path", [Blocked(name), *sys.meta_path])

    return begin


@pytest.mark.parametrize("module", EXTRAS)
def test_each_missing_module_names_its_extra(block, module: str) -> None:
    block(module)
    _, extra = EXTRAS[module]
    with pytest.raises(MissingExtraError) as required:
        require(module, "A test")
    with pytest.raises(MissingExtraError) as checked:
        check_installed(module, "A test")
    with pytest.raises(MissingExtraError) as imported, optional_imports("A test"):
        __import__(module)
    for raised in (required, checked, imported):
        assert raised.value.code == "missing-extra"
        assert f"'palpate[{extra}]'" in str(raised.value)
        assert "does not load" not in str(raised.value)


def test_a_package_that_is_there_and_does_not_load_is_told_apart(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "rtde_control.py").write_text("import a_library_that_is_gone\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with refused("missing-extra", MissingExtraError):
        require("rtde_control", "A test")


def test_other_import_errors_pass() -> None:
    with pytest.raises(ModuleNotFoundError) as raised, optional_imports("A test"):
        __import__("no_such_module_at_all")
    assert not isinstance(raised.value, MissingExtraError)
    with pytest.raises(InputError):
        require("numpy", "A test")


def test_every_extra_exists_in_the_project() -> None:
    extras = tomllib.loads(PROJECT.read_text())["project"]["optional-dependencies"]
    assert {extra for _, extra in EXTRAS.values()} == set(extras)


def unguarded(tree: ast.Module) -> list[str]:
    """Optional modules that a module outside the studio imports without naming the extra."""
    found = []
    guarded = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.With) and "optional_imports" in ast.unparse(block.items[0])
        for node in ast.walk(block)
    }
    for node in tree.body:  # at the top of a module: functions are called after it has loaded
        names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        found += [name for name in names if name.partition(".")[0] in EXTRAS and id(node) not in guarded]
    return found


def test_no_module_outside_the_studio_imports_an_optional_package_unguarded() -> None:
    assert unguarded(ast.parse("import torch")) == ["torch"]  # the search finds what it looks for
    modules = containing(rf"(?m)^\s*(?:import|from)\b.*\b(?:{'|'.join(EXTRAS)})\b")
    found = {name: unguarded(tree) for name, tree in modules if not name.startswith("studio/")}
    assert found
    assert not {name: names for name, names in found.items() if names}


def test_the_studio_names_its_extra_whatever_is_imported_of_it() -> None:
    code = (
        "import sys\n"
        "for name in ('nicegui', 'fastapi', 'starlette', 'uvicorn'): sys.modules[name] = None\n"
        "for name in ('palpate.studio.page_server', 'palpate.studio.live.live_desk'):\n"
        "    try: __import__(name)\n"
        "    except ImportError as e: print(e)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert [line.count("'palpate[studio]'") for line in done.stdout.splitlines()] == [1, 1]
