"""Parameters of which some run in every test run, and all with the slow ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest


def mostly_slow(values: Sequence[Any], usual: Callable[[int], bool]) -> list[Any]:
    """Parameters, each marked `slow` but those whose number is usual."""
    return [
        value
        if usual(i)
        else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.slow)
        for i, value in enumerate(values)
    ]
