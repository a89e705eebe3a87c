"""Flow along a sequence of frames, with speed and divergence; pairs are shared among threads."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain, pairwise, repeat
from typing import TypeVar

import cv2
import numpy as np

from palpate.core import Bool, InputError, ndarray
from palpate.estimators.flow.horn_schunck import (
    FlowField,
    Grey,
    brightness,
    check_pair,
    coarse_to_fine,
    divergence,
    flow,
)

FASTEST = 0.99  # quantile of the speed that counts as the greatest: single pixels at edges claim more
FAST = 0.8  # speed of the pixels that move most, over the greatest
AHEAD = 4  # pairs a thread that wait, so that no thread waits for the reader

T = TypeVar("T")


def along(
    frames: Iterable[Grey],
    between: Callable[[Grey, Grey], T],
    *,
    from_first: bool = False,
    threads: int | None = None,
) -> Iterator[T]:
    """Yield a function of each pair of frames, in temporal order.

    Args:
        frames: Gray images of one size; read once.
        between: Function of an earlier and a later frame; it must not keep or change them.
        from_first: Pair each frame with the first instead of the previous one.
        threads: Number of threads; None for one for each processor.
    """
    threads = threads or os.cpu_count() or 1
    if threads < 1:
        raise InputError(f"{threads} threads; 1 or more work", code="thread-count")
    return _results(_pairs(frames, from_first), between, threads)


def _pairs(frames: Iterable[Grey], from_first: bool) -> Iterator[tuple[Grey, Grey]]:
    frames = iter(frames)
    first, second = next(frames, None), next(frames, None)
    if first is None or second is None:
        raise InputError("flow needs two frames or more; the sequence has fewer", code="too-few-frames")
    later = chain([second], frames)
    yield from zip(repeat(first), later) if from_first else pairwise(chain([first], later))


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


def dis(first: Grey, second: Grey) -> FlowField:
    """Return dense inverse search flow, preset MEDIUM [px/frame]; doi:10.1007/978-3-319-46493-0_29."""
    a, b = _eight_bit_pair(first, second)
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return _planes(method.calc(a, b, None))


def farneback(first: Grey, second: Grey) -> FlowField:
    """Return Farnebäck's flow, 3 levels, window 15 px [px/frame]; doi:10.1007/3-540-45103-X_50."""
    a, b = _eight_bit_pair(first, second)
    return _planes(
        cv2.calcOpticalFlowFarneback(
            a, b, None, pyr_scale=0.5, levels=3, winsize=15, iterations=3, poly_n=5, poly_sigma=1.2, flags=0
        )
    )


def _eight_bit_pair(first: Grey, second: Grey) -> tuple[Grey, Grey]:
    check_pair(first, second)
    a, b = (np.round(255 * brightness(image)).astype(np.uint8) for image in (first, second))
    return a, b


def _planes(field: np.ndarray) -> FlowField:
    return np.ascontiguousarray(np.moveaxis(field, -1, 0), np.float32)


METHODS: dict[str, Callable[[Grey, Grey], FlowField]] = {
    "horn-schunck": flow,
    "coarse-to-fine": coarse_to_fine,
    "dis": dis,
    "farneback": farneback,
}


@dataclass(frozen=True)
class Step:
    """Flow of one pair of frames.

    Attributes:
        speed_px: Mean length of the flow in the region [px].
        divergence: Mean over the region [1/frame].
        border_flux: Mean divergence over the image, the flow through its border by the divergence theorem
            [1/frame].
        field: Flow [px].
    """

    speed_px: float
    divergence: float
    border_flux: float
    field: FlowField


def course(
    frames: Iterable[Grey],
    method: str = "horn-schunck",
    *,
    from_first: bool = False,
    region: Bool[ndarray, "h w"] | None = None,
) -> Iterator[Step]:
    """Yield the flow of each step of a sequence.

    Args:
        frames: Gray or RGB images of one size, read once; color is averaged.
        method: One of `METHODS`.
        from_first: From the first frame to each, not from each to the next.
        region: Pixels that count for the means; None for all.
    """
    if method not in METHODS:
        raise InputError(f"no method {method!r}; there are {', '.join(METHODS)}")
    if region is not None and not region.any():
        raise InputError("the region has no pixels; divergence is averaged over one or more")
    between = partial(_step, METHODS[method], region)
    return along(map(grey, frames), between, from_first=from_first)


def grey(image: ndarray) -> Grey:
    """Return the image with averaged colors."""
    return np.rint(image.mean(axis=2)).astype(np.uint8) if image.ndim == 3 else image


def _step(
    method: Callable[[Grey, Grey], FlowField], region: Bool[ndarray, "h w"] | None, first: Grey, second: Grey
) -> Step:
    field = method(first, second)
    if region is not None and region.shape != field.shape[1:]:
        raise InputError(f"a region of {list(region.shape)} px on images of {list(field.shape[1:])} px")
    inside = slice(None) if region is None else region
    speed, spread = np.hypot(*field)[inside], divergence(field)
    mean_speed, mean_spread, flux = (
        float(values.mean(dtype=np.float64)) for values in (speed, spread[inside], spread)
    )
    return Step(mean_speed, mean_spread, flux, field)


def contact_region(frames: Iterable[Grey], method: str = "horn-schunck") -> Bool[ndarray, "h w"]:
    """Return the convex region of the pixels that move most between the first and last frame."""
    first, last = _ends(frames)
    speed = np.hypot(*METHODS[method](first, last))
    most = float(np.quantile(speed, FASTEST))
    if not most > 0:
        return np.ones(speed.shape, bool)
    y, x = np.nonzero(speed >= FAST * most)
    hull = cv2.convexHull(np.stack([x, y], axis=1).astype(np.int32))
    return cv2.fillConvexPoly(np.zeros(speed.shape, np.uint8), hull, 1).astype(bool)


def _ends(frames: Iterable[Grey]) -> tuple[Grey, Grey]:
    every = iter(frames)
    first, last = next(every, None), deque(every, maxlen=1)
    if first is None or not last:
        raise InputError("flow needs two frames or more; the sequence has fewer")
    return grey(first), grey(last[0])
