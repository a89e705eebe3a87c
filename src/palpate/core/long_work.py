"""Long work: what it tells meanwhile, and the same job for many items, by processes or a Dask cluster.

Results come in the order of the items and do not depend on who worked, so a job that needs chance takes its
own generator with its item. Processes are joblib's (loky), as scikit-learn offers them; machines are Dask's.
Jobs and results are pickled on their way and never stored.
"""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from functools import partial
from importlib import import_module
from typing import Any, TypeVar

from palpate.core.errors import InputError, PalpateError
from palpate.core.optional_imports import require

T = TypeVar("T")
R = TypeVar("R")

Progress = Callable[[str, int, int], None]
"""Called with (what is being done, how much is done, how much there is)."""

ProgressCount = Callable[[int, int], None]
"""Called with (how much is done, how much there is)."""

SHOWN = 80  # characters of an item, in an error
CONNECT_WITHIN = "20s"


def silent(what: str, done: int, total: int) -> None:
    """A `Progress` that shows nothing."""


def in_parallel(
    function: Callable[[T], R],
    items: Sequence[T],
    *,
    processes: int = 1,
    scheduler: str | None = None,
    progress: ProgressCount = lambda count, total: None,
) -> Iterator[R]:
    """Results of a function for every item, in their order, each as soon as it and those before it are there.

    Args:
        function: pure: what it returns depends on its item alone.
        items: what it is called with, one at a time.
        processes: how many work on this machine; 1 works in this process.
        scheduler: address of a Dask scheduler whose workers shall do it, as in ``tcp://10.0.0.1:8786``.
        progress: told how many items are done of how many.
    """
    if processes < 1:
        raise InputError(f"{processes} processes; give 1 or more", code="processes")
    if scheduler is not None and processes > 1:
        raise InputError(
            f"{processes} processes as well as the scheduler {scheduler}; give one of them: a cluster's "
            "workers are as many as it has",
            code="processes-and-scheduler",
        )
    if scheduler is not None:
        _distributed()
    return _results(function, items, processes, scheduler, progress)


def _results(
    function: Callable[[T], R],
    items: Sequence[T],
    processes: int,
    scheduler: str | None,
    progress: ProgressCount,
) -> Iterator[R]:
    job = partial(_call, function)
    if scheduler is not None:
        results = _by_cluster(job, items, scheduler)
    elif processes > 1:
        results = _by_processes(job, items, processes)
    else:
        results = (job(i, item) for i, item in enumerate(items))
    with closing(results):
        for i, result in enumerate(results):
            progress(i + 1, len(items))
            yield result


def _call(function: Callable[[T], R], i: int, item: T) -> R:
    """One job, whose failure says which it was."""
    try:
        return function(item)
    except PalpateError as e:
        raise _kind(e)(f"item {i} ({_short(item)}): {e}", code=e.code) from e
    except Exception as e:
        # Of a plain kind: an exception that cannot be rebuilt in this process would bring all workers down.
        raise RuntimeError(f"item {i} ({_short(item)}): {type(e).__name__}: {e}") from e


def _kind(error: PalpateError) -> type[PalpateError]:
    """Its nearest kind in the tree of errors: those outside it may want more than a message."""
    return next(kind for kind in type(error).__mro__ if kind.__module__ == PalpateError.__module__)


def _short(item: object) -> str:
    text = repr(item)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def _by_processes(job: Callable[[int, T], R], items: Sequence[T], processes: int) -> Generator[R, None, None]:
    joblib_s = import_module("sklearn.utils.parallel")  # heavy, and needed here alone
    call = joblib_s.delayed(job)
    # max_nbytes: no array is written to a file for the processes to map.
    parallel = joblib_s.Parallel(n_jobs=processes, backend="loky", return_as="generator", max_nbytes=None)
    with warnings.catch_warnings(), closing(parallel(call(i, it) for i, it in enumerate(items))) as results:
        # A worker that was idle for minutes stops as new jobs come; joblib starts another and says so.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given")
        yield from results


def _by_cluster(job: Callable[[int, T], R], items: Sequence[T], scheduler: str) -> Generator[R, None, None]:
    with _client(scheduler) as client:
        waited_for = deque(client.map(job, range(len(items)), list(items), pure=False))
        try:
            while waited_for:
                yield waited_for[0].result()
                waited_for.popleft()  # so that the worker may forget it
        finally:
            client.cancel(list(waited_for))


def _client(scheduler: str) -> Any:
    try:
        return _distributed().Client(scheduler, timeout=CONNECT_WITHIN, set_as_default=False)
    except (OSError, ValueError) as e:
        raise InputError(
            f"no Dask scheduler answers at {scheduler} ({e}); start one with `dask scheduler`, workers with "
            "`dask worker ADDRESS --nthreads 1`, and give its address",
            code="no-scheduler",
        ) from e


def _distributed() -> Any:
    return require("distributed", "A scheduler")
