"""Normal noise of whole pictures by a table of quantiles: a quarter of the time that normal draws take.

Each draw is 16 random bits, four of them to a word of the generator, and picks one of 65,536 equally likely
values: the normal quantiles in the middle of each share, scaled to variance 1. Draws are as independent as
the generator's bits. Of a normal distribution they lack what lies beyond 4.325 standard deviations, 1 in
65,000 draws, and their cumulated probability is nowhere off by more than 1 in 99,000.
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
    """Values that a draw picks, ascending and symmetric about 0, of mean 0 and variance 1."""
    middle = ndtri((np.arange(VALUES) + 0.5) / VALUES)
    table = (middle / np.sqrt(np.mean(middle**2))).astype(np.float32)
    table.flags.writeable = False
    return table


def table_draws(rng: np.random.Generator, count: int) -> UInt16[ndarray, " count"]:
    """Places in `normal_table`, each as likely as any other.

    Args:
        rng: the only source of chance.
        count: of draws.
    """
    words = rng.integers(0, 2**64 - 1, -(-count // DRAWS_A_WORD), dtype=np.uint64, endpoint=True)
    return words.view(np.uint16)[:count]
