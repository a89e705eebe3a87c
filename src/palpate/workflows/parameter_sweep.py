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
    """Call a function for every item, with a source of chance that belongs to the item's place.

    Results depend on the items and the seed, not on how many processes worked; the first items of a longer
    sweep get the same chance as those of a shorter one.

    Args:
        function: of an item and a generator, from which all of its chance comes.
        items: settings, one a call.
        seed: 0 or more.
        processes: how many work on this machine; 1 works in this process.
        scheduler: address of a Dask scheduler whose workers shall do it instead.
        progress: called with how many items are done of how many.

    Returns:
        What the function returned, in the order of the items.

    Raises:
        InputError: a negative seed, no process, processes as well as a scheduler, or none answers there.
        MissingExtraError: a scheduler is given and Dask is not installed.
        PalpateError: the function refused an item; of its own kind, and the message names the item.
        RuntimeError: the function failed otherwise; the message names the item.

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
