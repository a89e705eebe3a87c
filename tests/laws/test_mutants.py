"""Each mutant of the frozen list changes a line of today's code, and what the line does."""

import sys
from collections import Counter
from pathlib import Path
from types import CodeType

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "tools"))

from mutants.frozen import SOURCE, Mutant, frozen  # noqa: E402

MUTANTS = frozen()


def original(mutant: Mutant) -> str:
    return (SOURCE / mutant.path).read_text(encoding="utf-8")


def compiled(source: str) -> CodeType:
    """Without docstrings and asserts."""
    return compile(source, "mutant", "exec", optimize=2)


@pytest.mark.parametrize("mutant", MUTANTS, ids=[mutant.id for mutant in MUTANTS])
def test_a_mutant_changes_one_line_that_is_there_and_compiles_to_something_else(mutant: Mutant) -> None:
    source = original(mutant)
    mutated = mutant.applied(source)
    changed = [
        (a.strip(), b.strip())
        for a, b in zip(source.splitlines(), mutated.splitlines(), strict=True)
        if a != b
    ]
    assert changed == [(mutant.line, mutant.mutated)]
    assert compiled(mutated) != compiled(source)


@pytest.mark.parametrize("mutant", MUTANTS, ids=[mutant.id for mutant in MUTANTS])
def test_the_nearest_tests_of_a_mutant_are_there(mutant: Mutant) -> None:
    assert mutant.tests
    assert all((REPOSITORY / test).is_file() for test in mutant.tests)


def test_the_list_is_long_and_of_every_kind_and_area() -> None:
    assert len(MUTANTS) >= 80
    assert len({mutant.id for mutant in MUTANTS}) == len(MUTANTS)
    kinds = Counter(mutant.kind for mutant in MUTANTS)
    assert set(kinds) == {"sign", "constant", "comparison", "dropped term", "swapped axis"}
    assert min(kinds.values()) >= 10
    areas = Counter(mutant.area for mutant in MUTANTS)
    assert set(areas) == {"core mathematics", "parsers", "guards", "splits", "certificates"}
    assert min(areas.values()) >= 10


def test_at_most_one_mutant_in_twenty_is_explained_instead_of_killed() -> None:
    explained = [mutant for mutant in MUTANTS if mutant.equivalent]
    assert len(explained) <= 0.05 * len(MUTANTS)
    assert all(len(mutant.equivalent.split()) >= 8 for mutant in explained), "a reason is a sentence"


@pytest.mark.parametrize(
    ("function", "line", "occurrence"),
    [("f", "return x - 1", 0), ("f", "return x + 1", 1), ("g", "return x + 1", 0)],
)
def test_a_mutant_whose_line_is_gone_is_an_error(function: str, line: str, occurrence: int) -> None:
    source = (
        "def f(x):\n    return x + 1\n\n\ndef outer():\n    def g(x):\n        return x + 1\n\n    return g"
    )
    mutant = Mutant("m", "area", "palpate", function, line, occurrence, "return x", "sign", ())
    with pytest.raises(LookupError, match=r"function g|no line"):
        mutant.applied(source)
