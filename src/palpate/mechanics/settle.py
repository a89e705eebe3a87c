"""Pressures that are never negative: conjugate gradients on the cells that press or are about to.

Wanted is the least of 1/2 p.Gp - p.(d - z) over p >= 0. A step goes along the residual of the working cells
(those that press, and those the indenter is inside of), turned by an approximate inverse of G and made
conjugate to the step before (Polak and Ribiere's factor, never negative, which restarts by itself where cells
come and go); then what became negative is cut off. Under a given load every direction has zero sum, and the
depth is the mean over what presses.

Reference: I. A. Polonsky and L. M. Keer, Wear 231, 206 (1999), doi:10.1016/S0043-1648(99)00113-1, for
gradients on changing cells. An inverse by Fourier transform as the turn is E. A. H. Vollebregt's (2014).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from palpate.core.errors import RangeError
from palpate.core.shapes import Field, Mask

STEPS = 1000
REFRESHED = 10  # steps after which the sinking is summed anew, so that rounding does not gather in it
LOWEST = 0.1  # of the indenter, on which a load first rests

Linear = Callable[[Field], Field]


class Settled(NamedTuple):
    """Pressures [Pa], sinking [m], depth [m], steps taken, and the greatest misfit where it presses [m]."""

    pressure: Field
    sinking: Field
    depth: float
    steps: int
    misfit: float


def settle(
    yielding: Linear,
    resisting: Linear,
    gap: Field,
    tolerance: float,
    *,
    depth: float | None = None,
    load: float | None = None,
) -> Settled:
    """Find p >= 0 with yielding(p) = depth - gap where p > 0, and no less elsewhere.

    Args:
        yielding: sinking [m] under pressures [Pa]; linear, symmetric, positive definite.
        resisting: about its inverse; symmetric, positive definite.
        gap: heights [m]; infinite where nothing can touch.
        tolerance: misfit allowed, as a part of the greatest sinking.
        depth: of the indenter, above the least of the gap [m]; or
        load: the sum of the pressures, positive [Pa].

    Raises:
        RangeError: it does not settle in 1000 steps.
    """
    possible = np.isfinite(gap)
    heights = np.where(possible, gap, 0.0)
    p = _first(yielding, gap, possible, depth, load)
    u = yielding(p)
    along, gradient, gain = np.zeros_like(p), np.zeros_like(p), np.inf
    for step in range(STEPS):
        pressing = p > 0.0
        d = float((u + heights)[pressing].mean()) if depth is None else depth
        room = u + heights - d  # between skin and indenter; below zero the indenter is inside the skin
        allowed = tolerance * float(np.max(d - heights, where=possible, initial=0.0))
        misfit = float(np.abs(room[pressing]).max(initial=0.0))
        if misfit <= allowed and not np.any(possible & ~pressing & (room < -allowed)):
            return Settled(p, u, d, step, misfit)
        working = pressing | (possible & (room < 0.0))
        fixed_sum = depth is None
        before, gradient = gradient, _within(room, working, fixed_sum)
        turned = _within(resisting(gradient), working, fixed_sum)
        conjugate = max(0.0, float((turned * (gradient - before)).sum())) / gain
        along = np.where(working, turned + conjugate * along, 0.0)
        gain = float((turned * gradient).sum())
        yielded = yielding(along)
        length = float((gradient * along).sum() / (yielded * along).sum())
        moved = p - length * along
        p = np.maximum(moved, 0.0)
        summed_anew = np.any(moved < 0.0) or step % REFRESHED == 0
        u = yielding(p) if summed_anew else u - length * yielded
        if load is not None:
            u, p = u * (load / p.sum()), p * (load / p.sum())
    raise RangeError(
        f"the contact did not settle to {tolerance:g} of its sinking in {STEPS} steps; allow a larger "
        "tolerance, or give a grid that resolves the indenter"
    )


def _within(values: Field, working: Mask, fixed_sum: bool) -> Field:
    mean = values[working].mean() if fixed_sum else 0.0
    return np.where(working, values - mean, 0.0)


def _first(yielding: Linear, gap: Field, possible: Mask, depth: float | None, load: float | None) -> Field:
    """A plain guess: pressures like the overlap, of the best height; or the load on the lowest part."""
    if load is not None:
        resting = gap <= np.quantile(gap[possible], LOWEST)
        return np.where(resting, load / np.count_nonzero(resting), 0.0)
    overlap = np.maximum(depth - gap, 0.0)
    return overlap * float((overlap**2).sum() / (overlap * yielding(overlap)).sum())
