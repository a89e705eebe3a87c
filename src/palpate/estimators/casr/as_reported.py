"""The report's route from frames and force to a spread rate: flow, divergence, accumulated area.

Divergence is the mean over the whole image. Beside the report's own sum over frames stand the secant and the
regression of A_i = A_0 exp(sum of D_j). A_0 is the circle through the pins, not a contact, so all areas are
relative to it: only contrasts between presses of one sensor mean anything.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray

from palpate.core.errors import PalpateError
from palpate.estimators.casr.force import (
    CONTACT_N,
    GREATEST_N,
    loading,
    moving_average,
    within,
    without_spikes,
)
from palpate.estimators.casr.spread import Spread, area_m2, paper_spread, spread
from palpate.estimators.flow.course import course


@dataclass(frozen=True)
class AsReported:
    """What the report's route gives.

    Attributes:
        force_n: at each frame of the loading part [N].
        divergence: mean over the image, of the step to each frame [1/frame].
        area: A_i over A_0.
        spreads: "regression", "secant" and "paper" [1/N]; those that the press allows.
    """

    force_n: Float[ndarray, " f"]
    divergence: Float[ndarray, " f"]
    area: Float[ndarray, " f"]
    spreads: dict[str, Spread]


def as_reported(
    frames: Iterable[Shaped[ndarray, ...]],
    force_n: Float[ndarray, " s"],
    frame_sample: Int[ndarray, " f"],
    *,
    above_n: float = CONTACT_N,
    method: str = "horn-schunck",
    region: Bool[ndarray, "h w"] | None = None,
) -> AsReported:
    """Run it on a press.

    Args:
        frames: grey images in time.
        force_n: raw samples [N].
        frame_sample: of every frame, which sample it belongs to.
        above_n: frames below are left out of the spread rates; the report takes 2.5 N in its section V [N].
        method: of flow.
        region: over which divergence is averaged; None for the whole image, as reported.

    Raises:
        InputError: no loading part, or too few frames.
    """
    smooth = moving_average(without_spikes(np.asarray(force_n, np.float64)))
    at = np.asarray(frame_sample)
    used = np.flatnonzero(np.isin(at, within(smooth, loading(smooth), CONTACT_N, GREATEST_N)))
    first, last = int(max(used[0] - 1, 0)) if len(used) else 0, int(used[-1]) if len(used) else 0
    steps = course(islice(iter(frames), first, last + 1), method, region=region)
    divergence = np.array([step.divergence for step in steps])[-len(used) :]
    force, area = smooth[at[used]], area_m2(1.0, divergence)
    kept = force >= above_n
    spreads = {}
    for way in ("regression", "secant", "paper"):
        try:
            spreads[way] = (
                paper_spread(force[kept], divergence[kept], 1.0)
                if way == "paper"
                else spread(force[kept], area[kept], way)  # type: ignore[arg-type]
            )
        except PalpateError:  # e.g. too few frames for a line; the others may still stand
            continue
    return AsReported(force, divergence, area, spreads)
