"""The size of the package is measured as stated."""

import ast
import importlib.util
from pathlib import Path

import pytest

SPEC = importlib.util.spec_from_file_location(
    "budget", Path(__file__).resolve().parents[2] / "tools" / "budget.py"
)
assert SPEC is not None
assert SPEC.loader is not None
budget = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(budget)


def function(text: str) -> ast.FunctionDef:
    found = ast.parse(text).body[0]
    assert isinstance(found, ast.FunctionDef)
    return found


def test_code_lines_leave_out_docstrings_comments_blanks_and_imports(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text('"""Text\nof two lines."""\n\nimport os\n\n# why\nx = """a\nb"""\nprint(os, x)\n')
    assert budget.code_lines(path, ast.parse(path.read_text())) == 3


def test_complexity_counts_each_branch_and_each_operator() -> None:
    assert budget.complexity(function("def f(x):\n    return x")) == 1
    assert budget.complexity(function("def f(x):\n    if x and x > 1 or not x:\n        return 1")) == 4
    assert budget.complexity(function("def f(x):\n    return [a for a in x if a]")) == 2


def test_a_cycle_is_found_once_and_a_chain_is_none() -> None:
    assert budget.cycles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert budget.cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]


@pytest.mark.parametrize(
    ("text", "compares"),
    [
        ("def f():\n    with raises(E, match='of three words'):\n        g()", True),
        ("def f():\n    assert 'of three words' in g()", True),
        ("def f():\n    assert 'two words' in g()", False),
        ("def f():\n    assert g('of three words').code == 'file-hash'", False),
        ("@mark.parametrize('a', ['of three words'])\ndef f(a):\n    assert a in g()", True),
        ("@mark.parametrize('a', ['of three words'])\ndef f(a):\n    assert g(a) == 1", False),
        ("@mark.parametrize('a', ['of three words'])\ndef f(a):\n    g(a)", False),
    ],
)
def test_a_test_that_compares_text_is_told(text: str, compares: bool) -> None:
    assert budget.compares_text(function(text)) is compares
