"""The course of flow along a sequence: how fast, how divergent, and the divergence so far."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError
from palpate.core.shapes import Bool
from palpate.estimators.flow.brightness import Grey
from palpate.estimators.flow.coarse_to_fine import coarse_to_fine
from palpate.estimators.flow.fast import FlowField, divergence, flow
from palpate.estimators.flow.opencv import dis, farneback
from palpate.estimators.flow.sequence import along

METHODS: dict[str, Callable[[Grey, Grey], FlowField]] = {
    "horn-schunck": flow,
    "coarse-to-fine": coarse_to_fine,
    "dis": dis,
    "farneback": farneback,
}


@dataclass(frozen=True)
class Step:
    """One pair of frames.

    Attributes:
        speed_px: mean length of the flow [px].
        divergence: mean over the region [1/frame].
        field: the flow itself [px].
    """

    speed_px: float
    divergence: float
    field: FlowField


def course(
    frames: Iterable[Grey],
    method: str = "horn-schunck",
    *,
    from_first: bool = False,
    region: Bool[ndarray, "h w"] | None = None,
    threads: int | None = None,
) -> Iterator[Step]:
    """Each step of a sequence.

    Args:
        frames: grey or RGB images of one size, read once; colour is averaged.
        method: one of `METHODS`.
        from_first: from the first frame to each, not from each to the next.
        region: of the image that counts for the means; None for all.
        threads: to share the pairs; None for as many as there are processors.

    Raises:
        InputError: no such method, too few frames, or a region of another size or of no pixels.
        ImageError: frames that are no pair of images.
    """
    if method not in METHODS:
        raise InputError(f"no method {method!r}; there are {', '.join(METHODS)}")
    if region is not None and not region.any():
        raise InputError("the region has no pixels; divergence is averaged over one or more")
    between = partial(_step, METHODS[method], region)
    return along(map(grey, frames), between, from_first=from_first, threads=threads)


def grey(image: ndarray) -> Grey:
    """The image, its colours averaged where it has any."""
    return np.rint(image.mean(axis=2)).astype(np.uint8) if image.ndim == 3 else image


def _step(
    method: Callable[[Grey, Grey], FlowField], region: Bool[ndarray, "h w"] | None, first: Grey, second: Grey
) -> Step:
    field = method(first, second)
    if region is not None and region.shape != field.shape[1:]:
        raise InputError(f"a region of {list(region.shape)} px on images of {list(field.shape[1:])} px")
    inside = slice(None) if region is None else region
    speed, spread = np.hypot(*field)[inside], divergence(field)[inside]
    return Step(float(speed.mean(dtype=np.float64)), float(spread.mean(dtype=np.float64)), field)
