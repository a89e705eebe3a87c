"""The frozen list of mutants, and where each one's line is.

A mutant is kept as the text of its line within a named function, so that it outlives a move of the code; one
whose line is not found is an error.
"""

from __future__ import annotations

import ast
import difflib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCE = REPOSITORY / "src"
FROZEN = Path(__file__).with_name("frozen.json")

TOP = "<module>"  # stands for a function's name where a line lies in none


@dataclass(frozen=True)
class Mutant:
    """One changed line.

    Attributes:
        id: m00 and on; n0 and on for those found by hand.
        area: of the code, such as `parsers`.
        function: qualified name of the function, or `TOP`.
        line: text of the line, without its indentation.
        occurrence: which of the equal lines within the function it is, from 0.
        kind: sign, constant, comparison, dropped term or swapped axis.
        tests: the nearest tests, paths from the repository's root.
        equivalent: why no test can tell it from the original; empty where one must.
    """

    id: str
    area: str
    module: str
    function: str
    line: str
    occurrence: int
    mutated: str
    kind: str
    tests: tuple[str, ...]
    equivalent: str = ""

    @property
    def path(self) -> Path:
        """The module's file, from the folder of sources."""
        return path_of(self.module)

    def applied(self, source: str) -> str:
        """The module's source with the line changed."""
        lines = source.splitlines(keepends=True)
        number = _found(source, self.function, self.line, self.occurrence)
        lines[number] = lines[number].replace(self.line, self.mutated, 1)
        return "".join(lines)


def frozen() -> list[Mutant]:
    """The list of `frozen.json`."""
    entries = json.loads(FROZEN.read_text(encoding="utf-8"))["mutants"]
    return [Mutant(**{**entry, "tests": tuple(entry["tests"])}) for entry in entries]


def path_of(module: str) -> Path:
    """A module's file, from the folder of sources."""
    stem = Path(*module.split("."))
    package = stem / "__init__.py"
    return package if (SOURCE / package).is_file() else stem.with_suffix(".py")


def functions_of(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Qualified names and nodes of all functions, inner ones after their outer ones."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = f"{prefix}{node.name}"
            if not isinstance(node, ast.ClassDef):
                yield name, node
            yield from functions_of(node, f"{name}.")


def lines_of(source: str, function: str) -> list[int]:
    """Numbers, from 0, of the lines of a function, without those of functions inside it."""
    tree = ast.parse(source)
    if function == TOP:
        taken = [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        lines = set(range(len(source.splitlines())))
    else:
        found = [node for name, node in functions_of(tree) if name == function]
        if not found:
            raise LookupError(f"there is no function {function}")
        taken = [inner for _, inner in functions_of(found[0])]
        lines = set(range(found[0].lineno - 1, found[0].end_lineno))
    for inner in taken:
        lines -= set(range(inner.lineno - 1, inner.end_lineno))
    return sorted(lines)


def _found(source: str, function: str, line: str, occurrence: int) -> int:
    text = {number: source.splitlines()[number].strip() for number in lines_of(source, function)}
    equal = [number for number in text if text[number] == line]
    if occurrence >= len(equal):
        near = difflib.get_close_matches(line, text.values(), 1, 0.5)
        hint = f"; the nearest is `{near[0]}`" if near else ""
        raise LookupError(f"{function} has no line `{line}`, occurrence {occurrence}{hint}")
    return equal[occurrence]


def write(mutants: Sequence[Mutant], seed: int) -> None:
    """Write the list."""
    _save({"seed": seed, "mutants": [asdict(mutant) for mutant in mutants]})


def retarget(renames: Sequence[str]) -> None:
    """Replace whole words, dotted ones too, in all that names code: OLD=NEW, one after another."""
    content = json.loads(FROZEN.read_text(encoding="utf-8"))
    for rename in renames:
        old, _, new = rename.partition("=")
        word = re.compile(rf"(?<!\w){re.escape(old)}(?!\w)")
        for entry in content["mutants"]:
            for name in ("module", "function", "line", "mutated"):
                entry[name] = word.sub(lambda _, new=new: new, entry[name])
            entry["tests"] = [word.sub(lambda _, new=new: new, test) for test in entry["tests"]]
    _save(content)


def _save(content: object) -> None:
    FROZEN.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
