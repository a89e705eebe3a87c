"""Fringe order by pixel: the map that colours and phases both give, and why a pixel tells none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from palpate.core import Bool, Float32, UInt8, ndarray

MAX_SIGMA = 0.25  # orders, greatest standard deviation of an identified order
SATURATED = 254  # code from which a channel may be saturated


class Untold(IntEnum):
    """Why a pixel's order is not identified; 0 if it is.

    `OUTSIDE` of the mask. `SATURATED` in a channel or frame. `UNLIKE`: no order has its light. `RIVAL`:
    another order is nearly as likely. `FAINT`: standard deviation above a quarter order. `BEYOND`: at the end
    of the calibrated orders. `APART`: no path of small steps leads to the known position.
    """

    TOLD = 0
    OUTSIDE = 1
    SATURATED = 2
    UNLIKE = 3
    RIVAL = 4
    FAINT = 5
    BEYOND = 6
    APART = 7
    DENSE = 8


@dataclass(frozen=True, slots=True, eq=False)
class OrderMap:
    """Fringe order by pixel.

    Attributes:
        order: N; NaN if none was chosen.
        sigma: Standard deviation of N, given that the choice is right.
        lead: Log likelihood ratio of the choice to the next one, 0 to 50.
        axis_rad: Axis of the larger index from x towards y; NaN from color.
        misfit: Reduced squared misfit; about 1 if noise explains it.
        why: Reason of `Untold`; 0 if valid.
    """

    order: Float32[ndarray, "h w"]
    sigma: Float32[ndarray, "h w"]
    lead: Float32[ndarray, "h w"]
    axis_rad: Float32[ndarray, "h w"]
    misfit: Float32[ndarray, "h w"]
    why: UInt8[ndarray, "h w"]

    @property
    def valid(self) -> Bool[ndarray, "h w"]:
        return np.asarray(self.why == Untold.TOLD)

    def summary(self) -> dict[str, float | dict[str, float] | None]:
        """Return plain values for JSON; ratios are of the pixels inside the mask."""
        inside = self.why != Untold.OUTSIDE
        told, every = self.valid, max(int(inside.sum()), 1)
        counts = np.bincount(self.why.ravel(), minlength=len(Untold))
        order, sigma, misfit = self.order[told], self.sigma[told], self.misfit[inside & (self.misfit >= 0)]
        return {
            "told_share": float(told.sum() / every),
            "untold_shares": {u.name.lower(): float(counts[u] / every) for u in Untold if u > Untold.OUTSIDE},
            "order_median": float(np.median(order)) if order.size else None,
            "order_greatest": float(np.quantile(order, 0.999)) if order.size else None,
            "sigma_median": float(np.median(sigma)) if order.size else None,
            "misfit_median": float(np.median(misfit)) if misfit.size else None,
        }
