"""Drawing of mutants, by a seeded generator, from the code whose errors would cost most: one a line.

What is no semantics is left out: annotations, messages, guards against rounding, counts of points, and
arguments whose swap only raises a TypeError.
"""

from __future__ import annotations

import ast
import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

from mutants.frozen import SOURCE, TOP, Mutant, frozen, functions_of, lines_of, path_of

SEED = 20261122
KINDS = ("sign", "constant", "comparison", "dropped term", "swapped axis")

_COMPARISONS = {
    ast.Lt: (ast.Gt, ast.LtE),
    ast.LtE: (ast.GtE, ast.Lt),
    ast.Gt: (ast.Lt, ast.GtE),
    ast.GtE: (ast.LtE, ast.Gt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
}
_TWO_ALIKE = {"arctan2", "atan2", "cross", "outer", "divide", "subtract", "linspace", "geomspace", "dist"}
_MIN_CONSTANT = 1e-5  # a smaller one guards against rounding
_MAX_COUNT = 10  # a greater one, outside of parsers, counts points or steps: one more changes nothing


def changes(node: ast.AST, alike: set[str]) -> Iterator[tuple[str, ast.AST]]:
    """What a node may be changed to, each with its kind; `alike` are functions whose arguments may swap."""
    match node:
        case ast.BinOp(left, ast.Add() | ast.Sub() as op, right) if not _text(left) and not _text(right):
            yield "sign", ast.BinOp(left, ast.Sub() if isinstance(op, ast.Add) else ast.Add(), right)
            yield "dropped term", left
            yield "dropped term", right
        case ast.BinOp(left, ast.Mult() | ast.BitAnd() | ast.BitOr(), right) | ast.BoolOp(_, [left, right]):
            yield "dropped term", left
            yield "dropped term", right
        case ast.BinOp(left, ast.Div() as op, right) if not _text(left) and not _text(right):
            yield "dropped term", left
            yield "swapped axis", ast.BinOp(right, op, left)
        case ast.UnaryOp(ast.USub(), operand) if not isinstance(operand, ast.Constant):
            yield "sign", operand
        case ast.Constant(bool()):
            pass
        case ast.Constant(int() as value):
            yield "constant", ast.Constant(value + 1)
        case ast.Constant(float() as value) if value == 0.0 or abs(value) >= _MIN_CONSTANT:
            yield "constant", ast.Constant(2 * value if value else 1.0)
        case ast.Compare(left, operators, others):
            for i, operator in enumerate(operators):
                # Which side of a boundary it falls on matters where the boundary is a number of the code.
                exact = isinstance(others[i], ast.Constant)
                for other in _COMPARISONS.get(type(operator), ())[: 2 if exact else 1]:
                    changed = [*operators[:i], other(), *operators[i + 1 :]]
                    yield "comparison", ast.Compare(left, changed, others)
        case ast.Call(ast.Attribute(value, ("sin" | "cos") as name), arguments, keywords):
            other = "cos" if name == "sin" else "sin"
            yield "swapped axis", ast.Call(ast.Attribute(value, other, ast.Load()), arguments, keywords)
        case ast.Call(ast.Attribute(_, "abs") | ast.Name("abs"), [value], []):
            yield "dropped term", value
        case ast.Call(function, [first, second, *rest], keywords) if _name(function) in alike:
            yield "swapped axis", ast.Call(function, [second, first, *rest], keywords)
        case ast.BinOp(left, ast.MatMult() as op, right):
            yield "swapped axis", ast.BinOp(right, op, left)
        case ast.Attribute(value, "T" | "mT"):
            yield "swapped axis", value
        case ast.keyword("axis", ast.Constant((0 | 1) as axis)):
            yield "swapped axis", ast.keyword("axis", ast.Constant(1 - axis))
        case ast.Tuple([first, second], ast.Load()) if _may_swap(first, second):
            yield "swapped axis", ast.Tuple([second, first], ast.Load())


def _text(node: ast.expr) -> bool:
    """Whether it is a text or a path, as far as its names say."""
    names = {getattr(part, "id", getattr(part, "attr", "")).lower() for part in ast.walk(node)}
    constant = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return constant or any(name.endswith(("path", "folder", "name", "file", "building")) for name in names)


def _may_swap(first: ast.expr, second: ast.expr) -> bool:
    alike = type(first) is type(second) and not _text(first)
    return alike and ast.dump(first) != ast.dump(second)


def _name(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _alike(tree: ast.Module) -> set[str]:
    """Functions whose first two arguments are of one type, so that swapped ones are believed."""
    found = set(_TWO_ALIKE)
    for name, node in functions_of(tree):
        types = [ast.unparse(arg.annotation) for arg in node.args.args if arg.annotation]
        if len(types) > 1 and types[0] == types[1]:
            found.add(name.rpartition(".")[2])
    return found


def _nodes(place: ast.AST) -> Iterator[ast.AST]:
    """Nodes that make a value: none of an annotation, a message, a kind of error or a function inside."""
    stack: list[ast.AST] = list(getattr(place, "body", [place]))
    while stack:
        node = stack.pop()
        if isinstance(node, ast.keyword) and node.arg in ("indent", "strict", "dtype"):
            continue
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.LShift):  # a bound on bytes
            continue
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.FunctionDef | ast.ClassDef | ast.Assert):
            continue
        yield node
        skipped = {"annotation", "returns"}
        match node:
            case ast.ExceptHandler():
                skipped.add("type")
            case ast.keyword(arg="axis"):  # the next axis is seldom there
                skipped.add("value")
            case ast.Compare(ops=[ast.In() | ast.NotIn()]):
                skipped.add("comparators")
        for name, value in ast.iter_fields(node):
            parts = value if isinstance(value, list) else [value]
            stack += [part for part in parts if isinstance(part, ast.AST) and name not in skipped]


def _candidates(module: str, area: str) -> list[Mutant]:
    """All mutants of a module's lines, those that compile to what is meant and those that do not."""
    source = (SOURCE / path_of(module)).read_text(encoding="utf-8")
    tree, text = ast.parse(source), source.splitlines()
    alike = _alike(tree)
    places = [(TOP, node) for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign)]
    found = []
    for function, place in [*places, *functions_of(tree)]:
        own = lines_of(source, function)
        for node in _nodes(place):
            if getattr(node, "lineno", -1) != getattr(node, "end_lineno", None):
                continue
            number, line = node.lineno - 1, text[node.lineno - 1].strip()
            occurrence = [n for n in own if text[n].strip() == line].index(number)
            for kind, other in changes(node, alike):
                counts = kind == "constant" and isinstance(other.value, int) and other.value > _MAX_COUNT
                if (function == TOP and kind != "constant") or (counts and area != "parsers"):
                    continue
                mutated = _rewritten(source, tree, node, other)
                if mutated:
                    found.append(Mutant("", area, module, function, line, occurrence, mutated, kind, ()))
    return found


def _rewritten(source: str, tree: ast.Module, node: ast.AST, other: ast.AST) -> str:
    """The node's line with the other's text in its place; empty where that says something else."""
    lines = source.splitlines()
    raw = lines[node.lineno - 1].encode()
    before, after = raw[: node.col_offset].decode(), raw[node.end_col_offset :].decode()
    said, wanted = ast.unparse(other), _with(tree, node, other)
    for text in (said, f"({said})"):
        changed = [*lines[: node.lineno - 1], before + text + after, *lines[node.lineno :]]
        try:
            if ast.dump(ast.parse("\n".join(changed))) == wanted:
                return (before + text + after).strip()
        except SyntaxError:
            continue
    return ""


def _with(tree: ast.Module, node: ast.AST, other: ast.AST) -> str:
    """The tree's content with one node replaced."""
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is node:
                setattr(parent, name, other)
                content = ast.dump(tree)
                setattr(parent, name, value)
                return content
            if isinstance(value, list) and any(part is node for part in value):
                setattr(parent, name, [other if part is node else part for part in value])
                content = ast.dump(tree)
                setattr(parent, name, value)
                return content
    raise LookupError("the node is not of this tree")


def draw(seed: int) -> list[Mutant]:
    """A list like the frozen one: those found by hand, and as many drawn of every area.

    Kinds are drawn in turn and modules evenly, from the modules that the list has of an area and with all
    tests that it names as theirs.
    """
    rng = random.Random(seed)  # noqa: S311
    listed = frozen()
    drawn = [mutant for mutant in listed if mutant.id.startswith("n")]
    taken = {(mutant.module, mutant.function, mutant.line) for mutant in drawn}
    for area, count in Counter(mutant.area for mutant in listed if mutant not in drawn).items():
        modules = {mutant.module for mutant in listed if mutant.area == area}
        candidates = {module: _candidates(module, area) for module in sorted(modules)}
        times = Counter(dict.fromkeys(candidates, 0))
        for i in range(count):
            kind = KINDS[i % len(KINDS)]
            usable = {
                module: [m for m in mutants if m.kind == kind and (m.module, m.function, m.line) not in taken]
                for module, mutants in candidates.items()
            }
            module = min((m for m in usable if usable[m]), key=lambda m: (times[m], rng.random()))
            mutant = rng.choice(usable[module])
            times[module] += 1
            taken.add((mutant.module, mutant.function, mutant.line))
            tests = dict.fromkeys(test for one in listed if one.module == module for test in one.tests)
            number = sum(one.id.startswith("m") for one in drawn)
            drawn.append(replace(mutant, id=f"m{number:02d}", tests=tuple(tests)))
    return drawn
