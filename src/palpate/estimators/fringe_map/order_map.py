"""Fringe order by pixel: the map that colors give, and why a pixel tells none.

Noise of a camera's light, and the scale on which it is the same at every light.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2

from palpate.core import Bool, Float, Float32, InputError, RangeError, UInt8, ndarray

MAX_SIGMA = 0.25  # orders, greatest standard deviation of an identified order
SATURATED = 254  # code from which a channel may be saturated


class Untold(IntEnum):
    """Why a pixel's order is not identified; 0 if it is.

    `OUTSIDE` of the mask. `SATURATED` in a channel or frame. `UNLIKE`: no order has its light. `RIVAL`:
    another order is nearly as likely. `FAINT`: standard deviation above a quarter order. `BEYOND`: at the end
    of the calibrated orders.
    """

    TOLD = 0
    OUTSIDE = 1
    SATURATED = 2
    UNLIKE = 3
    RIVAL = 4
    FAINT = 5
    BEYOND = 6


@dataclass(frozen=True, slots=True, eq=False)
class OrderMap:
    """Fringe order by pixel.

    Attributes:
        order: N; NaN if none was chosen.
        sigma: Standard deviation of N, given that the choice is right.
        lead: Log likelihood ratio of the choice to the next one, 0 to 50.
        misfit: Reduced squared misfit; about 1 if noise explains it.
        why: Reason of `Untold`; 0 if valid.
    """

    order: Float32[ndarray, "h w"]
    sigma: Float32[ndarray, "h w"]
    lead: Float32[ndarray, "h w"]
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


MIN_READ = 5e-4  # of light 1: what eight bits leave in the dark
BINS = 12
SECOND_DIFFERENCE = 6.0  # variances in a - 2 b + c
MIN_PIXELS = 1000


@dataclass(frozen=True, slots=True)
class FrameNoise:
    """Variance of a pixel's light v: read^2 + shot v."""

    read: float
    shot: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.read < 1 and 0 <= self.shot < 1):
            raise RangeError(
                f"noise of {self.read} in the dark and {self.shot} by light; allowed are 0 to 1",
                code="noise-range",
            )

    def standard(self, light: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
        """Return light on a scale of constant unit standard deviation."""
        if self.shot < 1e-6 * self.read:
            return np.asarray(light / self.read)
        bright = 2 / self.shot * (np.sqrt(self.read**2 + self.shot * np.maximum(light, 0)) - self.read)
        return np.asarray(bright + np.minimum(light, 0) / self.read)


def measured_noise(light: Float[ndarray, "h w c"]) -> FrameNoise:
    """Return the noise by second differences along rows; narrow fringes and JPEG bias it."""
    # Light is that of other pixels than those whose difference is taken: else noise would sort itself.
    middle = ((light[:, 4:] + light[:, :-4]) / 2).reshape(-1)
    bent = (light[:, 3:-1] - 2 * light[:, 2:-2] + light[:, 1:-3]).reshape(-1) ** 2 / SECOND_DIFFERENCE
    if len(middle) < MIN_PIXELS:
        raise InputError(f"{light.shape[0]} × {light.shape[1]} px are too few to measure noise; give it")
    step = max(len(middle) // 200_000, 1)
    middle, bent = middle[::step], bent[::step]
    order = np.argsort(middle)
    parts = np.array_split(order, BINS)
    at = np.array([np.median(middle[part]) for part in parts])
    variance = np.array([np.median(bent[part]) for part in parts]) / chi2.median(1)
    share = 1 / np.maximum(variance, MIN_READ**2)  # alike in proportion
    columns = np.stack([np.ones(BINS), np.maximum(at, 0)], axis=1) * share[:, None]
    (read, shot), _ = nnls(columns, variance * share)
    return FrameNoise(max(float(np.sqrt(read)), MIN_READ), float(shot))
