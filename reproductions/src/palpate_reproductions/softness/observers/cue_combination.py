"""Two cues of one softness combined by reliability: sensitivities, and what else would be needed.

An observer who weighs each cue by its reliability, 1 / variance, has the least variance that a weighted mean
can have, and where the noises are independent the sensitivities add in quadrature,

    d'_I² = d'_K² + d'_C².

Noises with a correlation rho and the best weights for it give

    d'_I² = (d'_K² + d'_C² - 2 rho d'_K d'_C) / (1 - rho²),

more than in quadrature where rho is below 0, without bound as rho goes to -1. (It grows also as rho goes to 1
while the two differ: then one cue is used to subtract the noise that both share.)

References: M. O. Ernst, M. S. Banks, Nature 415 (2002) 429, doi:10.1038/415429a; of correlated noise I. Oruç,
L. T. Maloney, M. S. Landy, Vision Res. 43 (2003) 2451, doi:10.1016/S0042-6989(03)00435-8.
"""

from __future__ import annotations

import math

from palpate.core import RangeError
from palpate.psychophysics.judgements import RankObserver


def combined_sensitivity(kinesthetic: float, cutaneous: float, correlation: float = 0.0) -> float:
    """Sensitivity to both cues together.

    Args:
        kinesthetic, cutaneous: d' of either alone, 0 or more.
        correlation: of their noises, above -1 and below 1.

    Example:
        >>> combined_sensitivity(3.0, 4.0)
        5.0
    """
    if min(kinesthetic, cutaneous) < 0 or not -1 < correlation < 1:
        raise RangeError(
            f"sensitivities {kinesthetic:g} and {cutaneous:g} with a correlation of {correlation:g}; 0 or "
            "more are allowed, and a correlation above -1 and below 1",
            code="correlation",
        )
    square = kinesthetic**2 + cutaneous**2 - 2 * correlation * kinesthetic * cutaneous
    return math.sqrt(square / (1 - correlation**2))


def correlation_needed(kinesthetic: float, cutaneous: float, integrated: float) -> float | None:
    """The correlation of two cues' noises, the lower one, that makes them a sensitivity together.

    Args:
        kinesthetic, cutaneous, integrated: d', above 0.

    Returns:
        The correlation; None where no correlation makes so little: two cues are never worse than the better.
    """
    k, c, i = kinesthetic, cutaneous, integrated
    if min(k, c, i) <= 0:
        raise RangeError(f"sensitivities {k:g}, {c:g} and {i:g}; all have to be above 0")
    if i < max(k, c):
        return None
    # i² rho² - 2 k c rho + k² + c² - i² = 0, whose lower root is asked for
    root = math.sqrt(max((k * c) ** 2 - i**2 * (k**2 + c**2 - i**2), 0.0))
    return (k * c - root) / i**2


def gain_needed(kinesthetic: float, cutaneous: float, integrated: float) -> float:
    """Factor by which both cues would have to differ more, for quadrature to make a sensitivity together."""
    return integrated / combined_sensitivity(kinesthetic, cutaneous)


def combined_observer(
    kinesthetic: RankObserver,
    cutaneous: RankObserver,
    *,
    correlation: float = 0.0,
    lapse: float = 0.0,
    reversal: float = 0.0,
    gains: tuple[float, float] = (1.0, 1.0),
) -> RankObserver:
    """The observer of both cues; two neighbours' d' follow from theirs in each cue.

    Args:
        kinesthetic, cutaneous: observers of either cue, both of places that rise.
        gains: how much more stimuli differ in each cue than they did when it was alone.
    """
    steps = [
        [gain * (b - a) for a, b in zip(one.places[:-1], one.places[1:], strict=True)]
        for one, gain in zip((kinesthetic, cutaneous), gains, strict=True)
    ]
    places = [0.0]
    for k, c in zip(*steps, strict=True):
        places.append(places[-1] + combined_sensitivity(k, c, correlation))
    return RankObserver(tuple(places), lapse, reversal)
