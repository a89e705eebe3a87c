"""Names that packages import on first use; type checkers see only names that exist."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import palpate
import palpate.check

SOURCES = Path(palpate.__file__).parent


def module_hooks(tree: ast.Module) -> list[ast.FunctionDef]:
    """Module-level `__getattr__` functions that a type checker sees."""
    return [one for one in tree.body if isinstance(one, ast.FunctionDef) and one.name == "__getattr__"]


def test_no_module_shows_a_type_checker_a_getattr_that_accepts_any_name() -> None:
    assert module_hooks(ast.parse("def __getattr__(name): ..."))  # the search finds what it looks for
    shown = [path for path in SOURCES.rglob("*.py") if module_hooks(ast.parse(path.read_text()))]
    assert not shown


@pytest.mark.parametrize("module", [palpate, palpate.check], ids=lambda module: module.__name__)
def test_every_public_name_resolves_and_no_other(module) -> None:
    assert all(getattr(module, name) is not None for name in module.__all__)
    assert not hasattr(module, "InputError_")


def used_names(tree: ast.Module) -> set[str]:
    """Attributes of `palpate` that a module uses after `import palpate`."""
    imported = any(
        isinstance(node, ast.Import) and any(one.name == "palpate" for one in node.names)
        for node in ast.walk(tree)
    )
    return {
        node.attr
        for node in ast.walk(tree)
        if imported and isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "palpate"
    }


def test_palpate_uses_only_names_that_it_exports() -> None:
    used = {name for path in SOURCES.rglob("*.py") for name in used_names(ast.parse(path.read_text()))}
    assert "PalpateError" in used  # the search finds what is there
    assert used <= set(palpate.__all__)
