"""What the softness display's report prints of its experiments with people, as printed.

Tables 1 and 2 count 30 rankings of five stimuli, three of each of ten people, in three conditions: both cues
(I), the kinesthetic alone (K), the cutaneous alone (C). Of Figures 10 and 11 the text prints a few bars; the
others cannot be read from it.

Reference: E. P. Scilingo, M. Bianchi, G. Grioli, A. Bicchi, IEEE Trans. Haptics 3 (2010) 109,
doi:10.1109/TOH.2010.2, sections 5.1 to 5.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.psychophysics import Condition, Presentation
from palpate.psychophysics.analysis import RankConfusion

RANKINGS, PEOPLE, EACH = 30, 10, 3
PAIR_ANSWERS = 30


@dataclass(frozen=True)
class PublishedRanking:
    """One confusion matrix, and the accuracies that are printed beside it.

    Attributes:
        relative: printed accuracy of each stimulus [%].
        total: printed total accuracy [%].
        where: table and name of the matrix.
        in_text: total accuracy that the text prints, where it differs from the table's [%].
    """

    presentation: Presentation
    condition: Condition
    confusion: RankConfusion
    relative: tuple[float, ...]
    total: float
    where: str
    in_text: float | None = None


def _ranking(
    presentation: Presentation, condition: Condition, counts: str, relative: tuple[float, ...], total: float,
    in_text: float | None = None,
) -> PublishedRanking:  # fmt: skip
    direct = presentation is Presentation.DIRECT
    names = tuple(f"{'SS' if direct else 'SH'}{i}" for i in range(1, 6))
    table = np.array([[int(one) for one in row.split()] for row in counts.split("/")])
    number = list(Condition).index(condition) + 1
    where = f"Table {1 if direct else 2}, C{'L' if direct else 'M'}{number}({condition})"
    return PublishedRanking(
        presentation, condition, RankConfusion(names, table), relative, total, where, in_text
    )


RANKINGS_PRINTED = (
    _ranking(
        Presentation.DIRECT, Condition.INTEGRATED,
        "29 0 1 0 0/0 30 0 0 0/1 0 28 0 1/0 0 0 30 0/0 0 1 0 29",
        (86.67, 100.00, 93.34, 100.00, 96.67), 98.67,
    ),
    _ranking(
        Presentation.DIRECT, Condition.KINESTHETIC,
        "18 3 1 0 8/5 19 1 4 1/0 0 19 9 2/2 7 7 13 1/5 1 2 4 18",
        (60.00, 63.34, 63.34, 43.34, 60.00), 58.00,
    ),
    _ranking(
        Presentation.DIRECT, Condition.CUTANEOUS,
        "24 3 1 1 1/2 23 4 0 1/2 4 16 0 8/1 0 9 18 2/1 0 0 11 18",
        (80.00, 76.67, 53.34, 60.00, 60.00), 66.00,
    ),
    _ranking(
        Presentation.RENDERED, Condition.INTEGRATED,
        "26 1 1 1 1/1 27 0 1 1/1 0 27 0 2/1 1 1 26 1/1 1 1 2 25",
        (86.67, 90.00, 90.00, 86.67, 83.34), 87.34, 87.35,
    ),
    _ranking(
        Presentation.RENDERED, Condition.KINESTHETIC,
        "18 4 2 2 4/6 12 6 5 1/1 5 16 7 1/3 6 6 15 0/2 3 0 1 24",
        (60.00, 40.00, 53.34, 50.00, 80.00), 56.67,
    ),
    _ranking(
        Presentation.RENDERED, Condition.CUTANEOUS,
        "21 4 0 2 3/4 23 0 1 2/0 1 19 2 8/5 0 10 15 0/0 2 1 10 17",
        (70.00, 76.67, 63.34, 50.00, 56.67), 63.34,
    ),
)  # fmt: skip


def printed_ranking(presentation: Presentation, condition: Condition) -> PublishedRanking:
    """The matrix of one presentation and condition."""
    return next(
        one for one in RANKINGS_PRINTED if (one.presentation, one.condition) == (presentation, condition)
    )


PAIRS = ((0, "1-3"), (1, "2-3"), (3, "4-3"), (4, "5-3"))
"""Number of the stimulus, from 0, that is compared with the third, and the pair's name."""

I, K, C = Condition  # noqa: E741 -- the conditions' own letters
PAIRS_PRINTED: dict[tuple[Presentation, Condition, str], float] = {
    **{(Presentation.DIRECT, I, name): 1.0 for _, name in PAIRS},
    (Presentation.RENDERED, I, "1-3"): 1.0,
    (Presentation.RENDERED, I, "5-3"): 1.0,
    (Presentation.RENDERED, I, "2-3"): 0.75,
    (Presentation.RENDERED, C, "2-3"): 0.82,
    (Presentation.RENDERED, K, "2-3"): 0.79,
}
"""Shares of right answers to pairs that the text prints of Figures 10 and 11; other bars are not printed."""

WIDTHS_PRINTED = {0.75: 0.3, 0.82: 0.27, 0.79: 0.29}
"""Of three means, the printed width of equation (7)'s interval."""
