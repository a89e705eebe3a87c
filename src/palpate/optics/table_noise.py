"""Normal noise by a table of quantiles, four times as fast as normal draws.

Each draw is 16 random bits that select one of 65,536 normal quantiles, scaled to variance 1. Values beyond
4.325 standard deviations are missing.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.special import ndtri

from palpate.core import Float32, UInt16, ndarray

VALUES = 2**16
DRAWS_A_WORD = 4


@cache
def normal_table() -> Float32[ndarray, " 65536"]:
    """Return the values of a draw: ascending, symmetric, of variance 1."""
    middle = ndtri((np.arange(VALUES) + 0.5) / VALUES)
    table = (middle / np.sqrt(np.mean(middle**2))).astype(np.float32)
    table.flags.writeable = False
    return table


def table_draws(rng: np.random.Generator, count: int) -> UInt16[ndarray, " count"]:
    """Return uniform indices into `normal_table`."""
    words = rng.integers(0, 2**64 - 1, -(-count // DRAWS_A_WORD), dtype=np.uint64, endpoint=True)
    return words.view(np.uint16)[:count]
