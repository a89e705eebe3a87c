"""One study at many settings, by as many processes or machines as there are, with the same results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from palpate.core import InputError, ProgressCount, in_parallel

T = TypeVar("T")
R = TypeVar("R")


def sweep(
    function: Callable[[T, np.random.Generator], R],
    items: Sequence[T],
    *,
    seed: int = 0,
    processes: int = 1,
    scheduler: str | None = None,
    progress: ProgressCount = lambda done, total: None,
) -> list[R]:
    """Call a function for every item, with a generator that depends on the seed and the item's index alone.

    Args:
        function: of an item and a generator.
        items: settings, one per call.
        processes: number on this machine; 1 works in this process.
        scheduler: address of a Dask scheduler instead.

    Returns:
        Results in the order of the items.

    Raises:
        InputError, MissingExtraError: invalid arguments, no scheduler there, or Dask is not installed.
        PalpateError, RuntimeError: the function failed; the message names the item.

    Example:
        >>> from palpate.workflows.parameter_sweep import sweep
        >>> sweep(lambda side, rng: int(rng.integers(side)), [1, 1, 1])
        [0, 0, 0]
    """
    if seed < 0:
        raise InputError(f"seed {seed}; it is 0 or more", code="settings-range")
    chance = np.random.SeedSequence(seed).spawn(len(items))

    jobs = [_Seeded(item, own) for item, own in zip(items, chance, strict=True)]
    return list(
        in_parallel(
            partial(_run, function), jobs, processes=processes, scheduler=scheduler, progress=progress
        )
    )


@dataclass(frozen=True, slots=True)
class _Seeded(Generic[T]):
    """An item and its chance; in an error it is shown as the item."""

    item: T
    chance: np.random.SeedSequence

    def __repr__(self) -> str:
        return repr(self.item)


def _run(function: Callable[[T, np.random.Generator], R], job: _Seeded[T]) -> R:
    return function(job.item, np.random.default_rng(job.chance))
