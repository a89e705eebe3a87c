"""Flow along a sequence of frames: from each to the next, or from the first to each.

Frames are taken as they come and few are held at a time, so a sequence may be as long as its file. Pairs are
shared among threads; results come in the order of the frames.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from palpate.core.errors import InputError
from palpate.estimators.flow.brightness import Grey

AHEAD = 4  # pairs a thread that wait, so that no thread waits for the reader

T = TypeVar("T")


def along(
    frames: Iterable[Grey],
    between: Callable[[Grey, Grey], T],
    *,
    from_first: bool = False,
    threads: int | None = None,
) -> Iterator[T]:
    """What a function says of each pair of frames, in their order.

    Args:
        frames: grey images of one size, in time; read once.
        between: of an earlier and a later frame, e.g. `flow`; it must not keep or change them.
        from_first: pair each frame with the first of all, not with the one before it.
        threads: to share the pairs; None for as many as there are processors.

    Yields:
        One result a frame, but for the first frame.

    Raises:
        InputError: fewer than two frames, or no thread.
        PalpateError: what the function raises for a pair.
    """
    threads = threads or os.cpu_count() or 1
    if threads < 1:
        raise InputError(f"{threads} threads; 1 or more work")
    return _results(_pairs(frames, from_first), between, threads)


def _pairs(frames: Iterable[Grey], from_first: bool) -> Iterator[tuple[Grey, Grey]]:
    """Each frame after the first, behind its partner."""
    frames = iter(frames)
    earlier = next(frames, None)
    several = False
    for frame in frames:
        assert earlier is not None
        yield earlier, frame
        several = True
        if not from_first:
            earlier = frame
    if not several:
        raise InputError("flow needs two frames or more; the sequence has fewer")


def _results(
    pairs: Iterator[tuple[Grey, Grey]], between: Callable[[Grey, Grey], T], threads: int
) -> Iterator[T]:
    with ThreadPoolExecutor(threads, thread_name_prefix="flow") as pool:
        begun: deque[Future[T]] = deque()
        try:
            for first, second in pairs:
                begun.append(pool.submit(between, first, second))
                if len(begun) >= threads * AHEAD:
                    yield begun.popleft().result()
            while begun:
                yield begun.popleft().result()
        finally:
            for future in begun:
                future.cancel()
