"""What the mean square of smoothed noise is, around a place: its upper tail, and its share at an edge."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq
from scipy.special import log_ndtr

from palpate.core import Float, ndarray


def edge_share(sigma: float, spread: float) -> float:
    """Mean square at a straight edge over that inside, after smoothing by sigma and averaging over spread.

    The mean square of a normal distribution's integral at a normal variable, by Sheppard's formula.
    """
    correlation = spread**2 / (sigma**2 + spread**2)
    return 0.25 + math.asin(correlation) / (2 * math.pi)


def tail_weights(sigma: float, spread: float) -> Float[ndarray, " k"]:
    """Weights of the independent squares whose sum is the local mean square of smoothed noise.

    Noise is smoothed by a Gaussian of sigma, squared, and averaged by one of spread. Along each axis the
    weights are a geometric series, by Mehler's formula; their sum is 1.
    """
    root = sigma / math.hypot(sigma, math.sqrt(2) * spread)
    ratio = (1 - root) / (1 + root)
    series = (1 - ratio) * ratio ** np.arange(math.ceil(math.log(1e-3) / math.log(max(ratio, 1e-3))) + 1)
    weights = np.outer(series, series).ravel()
    return weights[weights > 1e-4 * weights.max()]


def upper_quantile(probability: float, weights: Float[ndarray, " k"], channels: int) -> float:
    """Value that a weighted sum of squares of normal variables exceeds with a probability, over the channels.

    Args:
        probability: below 0.5.
        weights: of the squares; their sum is about 1.
        channels: independent ones of which the mean is taken.

    Reference:
        Lugannani and Rice 1980, doi:10.2307/1426607; for such sums Kuonen 1999, doi:10.1093/biomet/86.4.929.
    """
    share = weights / channels

    def beyond(t: float) -> tuple[float, float]:
        """Value whose saddle point is t, and the logarithm of the probability of more."""
        left = 1 - 2 * share * t
        value = channels * float((share / left).sum())
        curvature = 2 * channels * float((share**2 / left**2).sum())
        cumulant = -channels / 2 * float(np.log(left).sum())
        w = math.sqrt(2 * (t * value - cumulant))
        v = t * math.sqrt(curvature)
        return value, float(log_ndtr(-(w + math.log(v / w) / w)))

    low, high = 1e-3 / (2 * share.max()), (1 - 1e-9) / (2 * share.max())
    t = brentq(lambda t: beyond(t)[1] - math.log(probability), low, high)
    return beyond(t)[0]
