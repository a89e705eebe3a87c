"""Dense optical flow by Horn and Schunck, in single precision.

Jacobi iterations move the neighbors' average (4 nearest 1/6, 4 diagonal 1/12) towards constant brightness:

    (u, v) <- (ū, v̄) - (E_x, E_y) (E_x ū + E_y v̄ + E_t) / (alpha^2 + E_x^2 + E_y^2)

E_x, E_y, E_t are means of four differences on the cube of two frames, half a pixel right of and below their
pixel. Black is 0 and the greatest value of the image's type is 1, which fixes the unit of alpha. Information
travels one pixel an iteration: use at least as many as the widest even patch has pixels (26 px TacTip pins).
For motion of more than a pixel use OpenCV's `dis`. Kernels release the GIL.

Reference: B. K. P. Horn, B. G. Schunck, Determining optical flow, Artificial Intelligence 17 (1981) 185-203,
doi:10.1016/0004-3702(81)90024-2, sections 7 and 8.

Flow along a sequence of frames, with speed and divergence; pairs are shared among threads.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain, pairwise, repeat
from threading import local
from typing import TypeVar

import cv2
import numpy as np

from palpate.core import Bool, Float, Float32, ImageError, InputError, RangeError, Shaped, ndarray

WHITE = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}

Grey = Shaped[ndarray, "..."]  # [h w], which `brightness` checks: refusals are ours, with what to do
FlowField = Float32[ndarray, "2 h w"]


def brightness(image: Grey) -> Float[ndarray, "h w"]:
    """Return the image in double precision, black 0 and white 1."""
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < 2:
        raise ImageError(
            f"flow is of grey images [h w] of 2 x 2 px or more, got {list(image.shape)}", code="gray-image"
        )
    if image.dtype in WHITE:
        return image / WHITE[image.dtype]
    if not np.issubdtype(image.dtype, np.floating):
        raise ImageError(f"give uint8, uint16 or floats in [0, 1], not {image.dtype}", code="pixel-format")
    if not (np.isfinite(image).all() and image.min() >= 0 and image.max() <= 1):
        raise ImageError("float images hold brightness in [0, 1]", code="brightness-range")
    return image.astype(np.float64)


def check_pair(first: Grey, second: Grey) -> None:
    """Refuse images of different shape or type."""
    if first.shape != second.shape or first.dtype != second.dtype:
        raise InputError(
            f"images of {list(first.shape)} {first.dtype} and {list(second.shape)} {second.dtype} differ",
            code="images-differ",
        )


@dataclass(frozen=True)
class HornSchunck:
    """Settings of the flow; the defaults are those of the TacTip report.

    Attributes:
        alpha: Smoothness weight [brightness/px], white being 1.
        iterations: Jacobi steps from no motion.
    """

    alpha: float = 0.1
    iterations: int = 26

    def __post_init__(self) -> None:
        if not (np.isfinite(self.alpha) and self.alpha > 0):
            raise RangeError(f"alpha is {self.alpha}; give a brightness above 0", code="alpha-range")
        if self.iterations < 1:
            raise RangeError(f"{self.iterations} iterations; give 1 or more", code="iteration-count")


AS_REPORTED = HornSchunck()


class _Workspace(local):
    """Reusable workspace of one thread, laid out as in `flow_kernels`."""

    shape: tuple[int, int, int] = (0, 0, 0)

    def of(self, iterations: int, h: int, w: int) -> tuple[ndarray, ndarray, ndarray, ndarray]:
        from palpate.estimators.flow.flow_kernels import RING, row_length

        if self.shape != (iterations, h, w):
            row = row_length(w)
            self.a, self.b = _aligned(h, row), _aligned(h, row)
            self.e = _aligned(h, 3, row)
            self.rows = _aligned(iterations + 1, RING, 2, row)
            self.shape = (iterations, h, w)
        return self.a, self.b, self.e, self.rows


def _aligned(*shape: int) -> ndarray:
    """Zeros aligned to cache lines."""
    size = math.prod(shape)
    spare = np.zeros(size + 16, np.float32)
    first = -spare.ctypes.data // 4 % 16
    return spare[first : first + size].reshape(shape)


_WORKSPACE = _Workspace()


def flow(
    first: Grey,
    second: Grey,
    settings: HornSchunck = AS_REPORTED,
) -> FlowField:
    """Return the flow (u along columns, v along rows) from the first image to the second [px/frame].

    Motion beyond about a pixel is underestimated, because brightness is taken as linear between the images.

    Args:
        first, second: Gray images of one size and type.
        settings: Smoothness and iterations.

    Example:
        >>> still = np.zeros((20, 20), np.uint8)
        >>> float(abs(flow(still, still)).max())
        0.0
    """
    from palpate.estimators.flow import flow_kernels  # here: compiling is for those who need flow

    first, second = np.asarray(first), np.asarray(second)
    check_pair(first, second)
    white = _white(first)
    if white is None:
        first, second, white = brightness(first), brightness(second), 1.0
    h, w = first.shape
    a, b, e, rows = _WORKSPACE.of(settings.iterations, h, w)
    for image, levels in ((first, a), (second, b)):
        levels[:, :w] = image
        levels[:, w] = image[:, -1]
    flow_kernels.coefficients(a, b, w, np.float32(0.25 / white), np.float32(settings.alpha**2), e)
    field = np.zeros((2, h, w), np.float32)
    flow_kernels.relax(e, settings.iterations, rows, field)
    return field


def _white(image: Grey) -> float | None:
    """White level of an integer image."""
    whole = image.ndim == 2 and min(image.shape) > 1
    return WHITE.get(image.dtype) if whole else None


def divergence(field: FlowField) -> Float32[ndarray, "h w"]:
    """Return du/dx + dv/dy [1/frame] by three-point differences, one-sided on the border."""
    from palpate.estimators.flow import flow_kernels

    out = np.empty(field.shape[1:], np.float32)
    flow_kernels.diverge(np.ascontiguousarray(field, np.float32), out)
    return out


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


def _eight_bit_pair(first: Grey, second: Grey) -> tuple[Grey, Grey]:
    check_pair(first, second)
    a, b = (np.round(255 * brightness(image)).astype(np.uint8) for image in (first, second))
    return a, b


def _planes(field: np.ndarray) -> FlowField:
    return np.ascontiguousarray(np.moveaxis(field, -1, 0), np.float32)


METHODS: dict[str, Callable[[Grey, Grey], FlowField]] = {
    "horn-schunck": flow,
    "dis": dis,
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
