"""The reach of errors together: how far several independent normal ones go, beside one alone."""

from __future__ import annotations

from functools import cache


@cache
def joint_reach(components: int, coverage: float) -> float:
    """Return the radius of the ball that holds several standard normal errors with a coverage.

    It is the quantile of the chi distribution (JCGM 102:2011, doi:10.59161/JCGM102-2011).

    Example:
        >>> [round(joint_reach(k, 0.9), 4) for k in (1, 2, 3)]
        [1.6449, 2.146, 2.5003]
    """
    from scipy.special import chdtri  # here, since few cards need it, and sensing starts without scipy

    return float(chdtri(components, 1 - coverage)) ** 0.5
