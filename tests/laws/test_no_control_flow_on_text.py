"""No program decision depends on free text: origins, reasons, and verdicts are compared by code only."""

import ast
import re
from collections.abc import Iterator

from tests.laws.sources import PACKAGES, containing

TEXTS = {"origin", "why", "reason", "verdict"}
METHODS = {"startswith", "endswith", "partition", "rpartition", "find", "index", "removeprefix"}
SEARCHES = {"match", "search", "fullmatch", "findall", "finditer"}
ALLOWED = {
    "core/provenance.py": "runs and cards from before a provenance was stated",
    "recordings/run_reader.py": "a text shortened for display",
}

_TEXT = rf"\b(?:{'|'.join(TEXTS)})\b"
_METHOD, _SEARCH = (rf"(?:{'|'.join(words)})" for words in (METHODS, SEARCHES))
CANDIDATE = rf"\bin\b[^:]{{0,200}}?{_TEXT}|{_TEXT}\s*\.\s*{_METHOD}\b|\.{_SEARCH}\("
"""What a file contains that may search one of these texts."""


def _name(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def _decisions(tree: ast.AST) -> Iterator[int]:
    """Lines at which text is searched for what it says."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            contained = any(isinstance(one, ast.In | ast.NotIn) for one in node.ops)
            if contained and any(_name(one) in TEXTS for one in node.comparators):
                yield node.lineno
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            of_text = node.func.attr in METHODS and _name(node.func.value) in TEXTS
            if of_text or (node.func.attr in SEARCHES and any(_name(one) in TEXTS for one in node.args)):
                yield node.lineno


def test_no_program_decision_depends_on_an_origin_a_reason_or_a_verdict() -> None:
    found = {
        name: lines
        for package in PACKAGES
        for name, tree in containing(CANDIDATE, package)
        if (lines := list(_decisions(tree)))
    }
    assert set(found) <= set(ALLOWED), found
    assert set(ALLOWED) <= set(found), "the candidates include what the search finds"


def test_the_search_finds_what_it_forbids() -> None:
    forbidden = (
        "'not measured' in self.origin",
        "one.reason.startswith('every')",
        "re.match('blocks of', card.split.reason)",
        "'x' not in verdict",
    )
    assert all(list(_decisions(ast.parse(text))) and re.search(CANDIDATE, text) for text in forbidden)
    assert not list(_decisions(ast.parse("one.code in CODES and why == ''")))
