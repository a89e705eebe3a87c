"""What palpate is verified against, and what is measured with it: small functions, run by `verification`.

An oracle computes something twice, once by the library and once by another way, and returns how far the two
lie apart. A measurement returns a table for the page that asks for it by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray


@dataclass(frozen=True)
class Oracle:
    """One comparison.

    Attributes:
        name: what is verified, in the page's words.
        allowed: the greatest error that passes; relative where the name gives no unit.
        needs: a package that the comparison needs and palpate does not.
    """

    name: str
    against: str
    allowed: float
    error: Callable[[], float]
    needs: str | None = None


def relative(found: ndarray | float, wanted: ndarray | float) -> float:
    """Greatest difference over the greatest wanted value."""
    return float(np.max(np.abs(np.asarray(found) - wanted)) / np.max(np.abs(wanted)))


def each_relative(found: ndarray | float, wanted: ndarray | float) -> float:
    """Greatest relative difference, each value by itself."""
    return float(np.max(np.abs(np.asarray(found) / wanted - 1)))


def table(head: str, rows: Iterable[str]) -> str:
    """Markdown, from lines of cells with ` | ` between them."""
    rule = " | ".join("---" for _ in head.split(" | "))
    return "\n".join(f"| {line} |" for line in (head, rule, *rows))
