"""Published route from frames and force to a spread rate: flow, divergence, accumulated area.

A_0 is the circle through the pins, not a contact, so areas are relative to it and only contrasts between
presses of one sensor are meaningful. Divergence is averaged over that circle (equation (8) averages over the
image).
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
    """Results of the published route, one value for each frame of the loading part.

    Attributes:
        force_n: Force [N].
        divergence: Mean divergence of the step to the frame [1/frame].
        area: A_i over A_0.
    """

    force_n: Float[ndarray, " f"]
    divergence: Float[ndarray, " f"]
    area: Float[ndarray, " f"]

    @cached_property
    def spreads(self) -> dict[str, SpreadRate]:
        """Spread rates by regression, secant, and the paper's sum that the press allows [1/N]."""
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
        """Equation (12) up to every frame, with F_0 = 0, without steps of equal force [1/N]."""
        A = np.exp(np.cumsum(self.divergence) * self.force_n)
        step = np.diff(self.force_n, prepend=0.0)
        slopes = np.divide(np.diff(A, prepend=1.0), step, out=np.zeros_like(step), where=step != 0)
        return np.cumsum(slopes)

    def above(self, force_n: float) -> AsReported:
        """Return the same for frames above a force (2.5 N in section V of the report)."""
        rows = self.force_n >= force_n
        return AsReported(self.force_n[rows], self.divergence[rows], self.area[rows])


def circle_through_pins(
    untouched_px: Float[ndarray, "p 2"], height: int, width: int, cells: Int[ndarray, "p 2"] | None = None
) -> Bool[ndarray, "h w"]:
    """Return the largest circle through the pins about the middle one, A_0 of Algorithm 1, as a mask.

    Args:
        untouched_px: Pins of the reference frame [px].
        height, width: Size of the image [px].
        cells: Lattice cell of each pin, to locate middle and edge if pins are hidden.
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
    """Run the published route on a press (see `follow_press`), averaging over `region` or the image."""
    smooth = smoothed(force_n)
    at = np.asarray(frame_sample)
    used = np.flatnonzero(np.isin(at, within(smooth, loading(smooth), CONTACT_N, MAX_N)))
    first, last = int(max(used[0] - 1, 0)) if len(used) else 0, int(used[-1]) if len(used) else 0
    steps = course(islice(iter(frames), first, last + 1), region=region)
    divergence = np.array([step.divergence for step in steps])[-len(used) :]
    if len(divergence) < len(used) or not len(used):
        raise InputError(
            f"{len(divergence)} steps for {len(used)} frames under {CONTACT_N:g} to {MAX_N:g} N; begin "
            "before contact",
            code="frames-differ",
        )
    return AsReported(smooth[at[used]], divergence, area_m2(1.0, divergence))
