"""Names that packages import on first use; type checkers see only names that exist."""

import ast
from importlib import import_module

import pytest
from tests.laws.sources import containing

import palpate
import palpate.check


def module_hooks(tree: ast.Module) -> list[ast.stmt]:
    """Module-level definitions of `__getattr__` that a type checker sees."""
    functions = [one for one in tree.body if isinstance(one, ast.FunctionDef) and one.name == "__getattr__"]
    assigned = [
        one
        for one in tree.body
        if isinstance(one, ast.Assign)
        and any(getattr(name, "id", "") == "__getattr__" for name in ast.walk(one))
    ]
    return [*functions, *assigned]


def test_no_module_shows_a_type_checker_a_getattr_that_accepts_any_name() -> None:
    for text in ("def __getattr__(name): ...", "__getattr__, __dir__ = made()"):
        assert module_hooks(ast.parse(text))  # the search finds what it looks for
    assert not [name for name, tree in containing("__getattr__") if module_hooks(tree)]


LAZY = (palpate, palpate.check, *map(import_module, ("palpate.rig", "palpate.recordings", "palpate.sensing")))


@pytest.mark.parametrize("module", LAZY, ids=lambda module: module.__name__)
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
    used = {name for _, tree in containing(r"import\b.*\bpalpate\b") for name in used_names(tree)}
    assert "PalpateError" in used  # the search finds what is there
    assert used <= set(palpate.__all__)
