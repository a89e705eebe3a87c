"""What a calibration's int8 copy costs in accuracy, and what it saves in time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.core.errors import InputError
from palpate.estimators.certified import Estimator

ROUNDS, FRAMES, WARM = 8, 25, 3


@dataclass(frozen=True, slots=True)
class Cost:
    """What int8 costs, and what it gives.

    Attributes:
        mae: of each target, in its unit: with the network in float32 and in int8, on the same held-out rows.
        seconds: median time of the network alone for one image, in float32 and in int8, on this machine [s].
    """

    mae: dict[str, tuple[float, float]]
    seconds: tuple[float, float]


def cost(folder: Path, quantised: Path) -> Cost:
    """What a calibration's int8 copy costs, by both cards, and how fast both are here, taken in turn.

    Raises:
        InputError: the second does not come from the first.
    """
    both = Estimator.open(folder), Estimator.open(quantised)
    cards = [estimator.card for estimator in both]
    if cards[1].options.get("quantised_from") != cards[0].id:
        raise InputError(f"{quantised} was not made from {folder}; name a calibration and its own int8 copy")
    image = np.zeros((1, cards[0].input.channels, *cards[0].input.size_px), np.float32)
    seconds = _taken_in_turn([lambda e=estimator: e.values(image) for estimator in both])  # type: ignore[misc]
    mae = {
        a.column: (a.score.mae, b.score.mae) for a, b in zip(cards[0].targets, cards[1].targets, strict=True)
    }
    return Cost(mae, (seconds[0], seconds[1]))


def _taken_in_turn(calls: list[Callable[[], object]]) -> list[float]:
    """Median seconds of each, in rounds, so that all see the machine's other work."""
    taken: list[list[float]] = [[] for _ in calls]
    for _ in range(ROUNDS):
        for call, times in zip(calls, taken, strict=True):
            for i in range(-WARM, FRAMES):
                started = time.perf_counter()
                call()
                if i >= 0:
                    times.append(time.perf_counter() - started)
    return [float(np.median(times)) for times in taken]
