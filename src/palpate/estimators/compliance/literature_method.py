"""The report's route from frames and force to a spread rate: flow, divergence, accumulated area.

A_0 is the circle through the pins, not a contact, so all areas are relative to it: only contrasts between
presses of one sensor mean anything. `circle_through_pins` gives that circle, over which the mean divergence
is taken; over the whole image, as (8) has it, it is nothing but what flows through the image's border. Beside
the report's own sum over frames stand the secant and the regression of A_i = A_0 exp(sum of D_j).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np

from palpate.core import Bool, Float, InputError, Int, PalpateError, Shaped, ndarray
from palpate.estimators.compliance.pin_field import pin_field
from palpate.estimators.compliance.press_force import CONTACT_N, MAX_N, loading, smoothed, within
from palpate.estimators.compliance.spread_rate import SpreadRate, Way, area_m2, paper_spread, spread
from palpate.estimators.flow.flow_sequence import course

WAYS: tuple[Way, ...] = ("regression", "secant", "paper")


@dataclass(frozen=True)
class AsReported:
    """Results of the report's route.

    Attributes:
        force_n: at each frame of the loading part [N].
        divergence: mean over the image, of the step to each frame [1/frame].
        area: A_i over A_0.
    """

    force_n: Float[ndarray, " f"]
    divergence: Float[ndarray, " f"]
    area: Float[ndarray, " f"]

    @cached_property
    def spreads(self) -> dict[str, SpreadRate]:
        """Spread rates by "regression", "secant" and "paper" [1/N]; those that the press allows."""
        spreads: dict[str, SpreadRate] = {}
        for way in WAYS if len(self.force_n) > 1 else ():
            try:
                if way == "paper":
                    spreads[way] = paper_spread(self.force_n, self.divergence, 1.0)
                else:
                    spreads[way] = spread(self.force_n, self.area, way)
            except PalpateError:  # e.g. too few frames for a line; the others may still stand
                continue
        return spreads

    @property
    def summed(self) -> Float[ndarray, " f"]:
        """Equation (12) up to every frame, with F_0 = 0 and steps of equal force left out [1/N]."""
        A = np.exp(np.cumsum(self.divergence) * self.force_n)
        step = np.diff(self.force_n, prepend=0.0)
        slopes = np.divide(np.diff(A, prepend=1.0), step, out=np.zeros_like(step), where=step != 0)
        return np.cumsum(slopes)

    def above(self, force_n: float) -> AsReported:
        """The same of frames above a force; the report takes 2.5 N in its section V [N]."""
        rows = self.force_n >= force_n
        return AsReported(self.force_n[rows], self.divergence[rows], self.area[rows])


def circle_through_pins(
    untouched_px: Float[ndarray, "p 2"], height: int, width: int, cells: Int[ndarray, "p 2"] | None = None
) -> Bool[ndarray, "h w"]:
    """The largest circle through the pins about the one in their middle: A_0 of the report's Algorithm 1.

    Args:
        untouched_px: their places.
        height, width: of the image [px].
        cells: of each, by which middle and edge are told also where pins are hidden; None takes the pin
            nearest to the mean of those seen, and the one farthest from it.
    """
    if cells is not None:
        field = pin_field(untouched_px, cells)
        middle, reach = field.middle, field.farthest
    else:
        places = untouched_px[np.isfinite(untouched_px).all(axis=1)]
        middle = places[np.argmin(np.hypot(*(places - places.mean(axis=0)).T))]
        reach = np.hypot(*(places - middle).T).max()
    y, x = np.mgrid[:height, :width]
    return np.asarray(np.hypot(x - middle[0], y - middle[1]) <= reach)


def as_reported(
    frames: Iterable[Shaped[ndarray, ...]],
    force_n: Float[ndarray, " s"],
    frame_sample: Int[ndarray, " f"],
    *,
    region: Bool[ndarray, "h w"] | None = None,
) -> AsReported:
    """Run the report's route on a press.

    Args:
        frames, force_n, frame_sample: see `pin_press.follow_press`.
        region: over which divergence is averaged; None for the whole image, as reported.

    Raises:
        InputError: no loading part, or too few frames.
    """
    smooth = smoothed(force_n)
    at = np.asarray(frame_sample)
    used = np.flatnonzero(np.isin(at, within(smooth, loading(smooth), CONTACT_N, MAX_N)))
    first, last = int(max(used[0] - 1, 0)) if len(used) else 0, int(used[-1]) if len(used) else 0
    steps = course(islice(iter(frames), first, last + 1), region=region)
    divergence = np.array([step.divergence for step in steps])[-len(used) :]
    if len(divergence) < len(used) or not len(used):
        raise InputError(
            f"{len(divergence)} steps between frames for {len(used)} frames under {CONTACT_N:g} to "
            f"{MAX_N:g} N; give the frames and the table of one press, from a frame before contact on",
            code="frames-differ",
        )
    return AsReported(smooth[at[used]], divergence, area_m2(1.0, divergence))
