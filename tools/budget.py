"""Measure the size of palpate against the limits in pyproject.toml: python tools/budget.py [--json].

Each limit is the value reached when it was set; the exit status is 1 where a number is above its limit. Code
lines are those without docstrings, comments, blank lines, and imports. A test compares text where its
function, or what parametrizes it, holds a string of three or more words that is matched or looked for.

    python tools/budget.py --list text_tests   # the places behind one number
"""

from __future__ import annotations

import argparse
import ast
import collections
import io
import json
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path

from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).resolve().parent.parent
SOURCES = (ROOT / "src", ROOT / "reproductions" / "src")
LONG_LINES, COMPLEX, SMALL_LINES, WORDS = 60, 15, 150, 3
BRANCHES = (ast.If, ast.For, ast.While, ast.ExceptHandler, ast.IfExp, ast.comprehension, ast.match_case)
Function = ast.FunctionDef | ast.AsyncFunctionDef
LAYOUT = {
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.COMMENT,
    tokenize.ENDMARKER,
}


def python_files(folder: Path) -> dict[Path, ast.Module]:
    """Parsed modules below a folder."""
    return {path: ast.parse(path.read_bytes()) for path in sorted(folder.rglob("*.py"))}


def lines(files: dict[Path, ast.Module]) -> int:
    """Lines of text, of any kind."""
    return sum(path.read_bytes().count(b"\n") for path in files)


def code_lines(path: Path, tree: ast.Module) -> int:
    """Lines that hold code other than imports and docstrings."""
    left_out: set[int] = set()
    for node in ast.walk(tree):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.Import | ast.ImportFrom) or (is_text and isinstance(node.value.value, str)):
            left_out |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(path.read_text()).readline):
        if token.type not in LAYOUT:
            found |= set(range(token.start[0], token.end[0] + 1))
    return len(found - left_out)


def functions(tree: ast.AST) -> Iterator[Function]:
    """Functions and methods, nested ones as well."""
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def complexity(function: Function) -> int:
    """Cyclomatic complexity (McCabe 1976, doi:10.1109/TSE.1976.233837)."""
    nodes = list(ast.walk(function))
    operators = sum(len(node.values) - 1 for node in nodes if isinstance(node, ast.BoolOp))
    return 1 + operators + sum(isinstance(node, BRANCHES) for node in nodes)


def module_name(path: Path) -> str:
    """Dotted name of a module of one of the distributions."""
    (source,) = [one for one in SOURCES if path.is_relative_to(one)]
    parts = path.relative_to(source).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(files: dict[Path, ast.Module]) -> dict[str, set[str]]:
    """Modules of the package that each module imports, wherever in the module."""
    names = {module_name(path) for path in files}
    graph: dict[str, set[str]] = {name: set() for name in names}
    for path, tree in files.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                wanted = {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                deeper = {f"{node.module}.{alias.name}" for alias in node.names}
                wanted = {one if one in names else node.module for one in deeper}
            else:
                continue
            graph[module_name(path)] |= (wanted & names) - {module_name(path)}
    return graph


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other (strongly connected components)."""
    names = list(graph)
    matrix = csr_array([[two in graph[one] for two in names] for one in names])
    count, group = connected_components(matrix, connection="strong")
    groups = [sorted(name for name, at in zip(names, group, strict=True) if at == i) for i in range(count)]
    return [one for one in groups if len(one) > 1]


def is_text(node: ast.AST) -> bool:
    """Whether a node is a string of three or more words."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value.split()) >= WORDS


def outside_calls(node: ast.AST) -> Iterator[ast.AST]:
    """A node and those below it, but not what is given to a call."""
    yield node
    if not isinstance(node, ast.Call):
        for one in ast.iter_child_nodes(node):
            yield from outside_calls(one)


def compared(function: Function) -> Iterator[ast.AST]:
    """Nodes that a test matches or compares."""
    for node in ast.walk(function):
        if isinstance(node, ast.keyword) and node.arg == "match":
            yield from ast.walk(node.value)
        elif isinstance(node, ast.Assert):
            for one in ast.walk(node.test):
                if isinstance(one, ast.Compare):
                    for side in (one.left, *one.comparators):
                        yield from outside_calls(side)


def compares_text(function: Function) -> bool:
    """Whether a test holds text against text: by `match=`, `in`, or `==`, in its body or its parameters."""
    nodes = list(compared(function))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return any(map(is_text, nodes)) or any(
        _names_of(one) & names and any(map(is_text, ast.walk(one.args[1]))) for one in parametrized(function)
    )


def parametrized(function: Function) -> Iterator[ast.Call]:
    """Calls of `parametrize` that decorate a test."""
    for one in function.decorator_list:
        if isinstance(one, ast.Call) and ast.unparse(one.func).endswith("parametrize") and len(one.args) > 1:
            yield one


def _names_of(call: ast.Call) -> set[str]:
    named = [one.value for one in ast.walk(call.args[0]) if isinstance(one, ast.Constant)]
    return {word.strip() for one in named for word in str(one).split(",")}


def commands() -> tuple[list[str], list[str]]:
    """Commands of the command line, and their options with the command before each.

    A command of several kinds counts once, with each option that any kind takes.
    """
    from typer.main import get_command

    from palpate.cli import app

    def walk(command: object, path: str) -> Iterator[tuple[str, object]]:
        inner = getattr(command, "commands", None)
        if not inner:
            yield path, command
        for name, one in (inner or {}).items():
            yield from walk(one, f"{path} {name}".strip())

    def options_of(command: object) -> set[str]:
        parameters = [one for _, kind in getattr(command, "kinds", [("", command)]) for one in kind.params]
        return {one.opts[0] for one in parameters if type(one).__name__.endswith("Option")}

    root = get_command(app)
    found = list(walk(root, ""))
    options = [
        f"{path} {one}" for path, command in [("", root), *found] for one in sorted(options_of(command))
    ]
    return [path for path, _ in found], options


def place(path: Path, node: ast.AST) -> str:
    """Where a definition begins."""
    return f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)} {getattr(node, 'name', '')}"


def measured() -> tuple[dict[str, float], dict[str, list[str]]]:
    """Numbers by name, and the places behind those that have some."""
    source, reproductions = map(python_files, SOURCES)
    tests, tools, benchmarks, every_reproduction = (
        python_files(ROOT / name) for name in ("tests", "tools", "benchmarks", "reproductions")
    )
    modules = source | reproductions
    graph = imports(modules)
    importers = collections.Counter(one for wanted in graph.values() for one in wanted)
    packages = collections.Counter(path.parent for path in modules if path.name != "__init__.py")
    all_functions = [(path, one) for path, tree in modules.items() for one in functions(tree)]
    all_tests = [(p, f) for p, tree in tests.items() for f in functions(tree) if f.name.startswith("test_")]
    named, options = commands()
    places = {
        "commands": named,
        "options": options,
        "long_functions": [
            place(p, f) for p, f in all_functions if (f.end_lineno or 0) - f.lineno + 1 > LONG_LINES
        ],
        "complex_functions": [place(p, f) for p, f in all_functions if complexity(f) > COMPLEX],
        "import_cycles": [" ".join(group) for group in cycles(graph)],
        "small_modules_with_one_importer": [
            module_name(path)
            for path in modules
            if path.name != "__init__.py"
            and importers[module_name(path)] == 1
            and path.read_bytes().count(b"\n") < SMALL_LINES
        ],
        "text_tests": [place(p, f) for p, f in all_tests if compares_text(f)],
    }
    numbers: dict[str, float] = {
        "source_files": len(source),
        "source_lines": lines(source),
        "code_lines": sum(code_lines(*one) for one in source.items()),
        "reproduction_lines": lines(every_reproduction),
        "benchmark_lines": lines(benchmarks),
        "test_lines": lines(tests),
        "tool_lines": lines(tools),
        "modules_of_the_largest_package": max(packages.values()),
        **{name: len(found) for name, found in places.items()},
        "text_tests_percent": round(100 * len(places["text_tests"]) / len(all_tests), 1),
    }
    return numbers, places


def main() -> None:
    """Print the numbers beside their limits, or the places behind one."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--json", action="store_true", help="numbers and limits as JSON")
    words.add_argument("--list", metavar="NAME", help="the places behind one number")
    given = words.parse_args()
    limits = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["palpate"]["budget"]
    numbers, places = measured()
    if given.list:
        print("\n".join(places[given.list]))
        return
    above = [name for name, limit in limits.items() if numbers[name] > limit]
    if given.json:
        print(json.dumps({"numbers": numbers, "limits": limits, "above": above}))
    else:
        for name, number in numbers.items():
            mark = "  above its limit" if name in above else ""
            print(f"{name:34}{number:>10g}{limits.get(name, float('nan')):>10g}{mark}")
    sys.exit(bool(above))


if __name__ == "__main__":
    main()
