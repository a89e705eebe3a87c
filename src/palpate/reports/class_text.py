"""Classes in words: how many were told right beside the baseline, the confusion table, the sets."""

from __future__ import annotations

import pandas as pd

from palpate.estimators.class_sets import ClassCard, ClassCoverageCard, ClassScoreCard
from palpate.estimators.model_card import Card


def class_lines(card: ClassCard, score: ClassScoreCard, coverage: float) -> list[str]:
    """Return a sentence and a table on one column of classes.

    Args:
        score: its own, or that of another run.
    """
    widths = [max(len(name), 5) for name in card.names]
    head = max(len("true class"), *map(len, card.names))
    columns = "  ".join(name.rjust(width) for name, width in zip(card.names, widths, strict=True))
    lines = [
        f"{card.column}: {classes_told(card, score)}",
        f"{'true class':{head}}  {columns}  in its set ({100 * coverage:g} % asked)",
    ]
    for name, counts, covered in zip(card.names, score.confusion, score.coverage, strict=True):
        cells = "  ".join(f"{count:{width}d}" for count, width in zip(counts, widths, strict=True))
        lines.append(f"{name:{head}}  {cells}  {class_covered(covered)}")
    return lines


def classes_told(card: ClassCard, score: ClassScoreCard) -> str:
    """Accuracy beside the baseline's, and the size of the sets, in a sentence."""
    return (
        f"{100 * score.accuracy:.1f} % of {score.n} rows right (95 % interval "
        f"{100 * score.accuracy_low:.1f} to {100 * score.accuracy_high:.1f} %), where always saying "
        f"{card.most_frequent} gives {100 * score.baseline:.1f} %; sets hold {score.set_size:.2f} of "
        f"{len(card.names)} classes on average, all in {100 * score.whole:.1f} % and "
        f"none in {100 * score.empty:.1f} % of rows"
    )


def class_covered(one: ClassCoverageCard) -> str:
    """Share of a class's rows whose set held it, with the interval of that share."""
    if not one.rows:
        return "no rows"
    return (
        f"{100 * one.covered / one.rows:.1f} % ({100 * one.low:.1f} to {100 * one.high:.1f} %; "
        f"{one.groups} groups)"
    )


def class_answer(row: pd.Series, card: Card) -> str:
    """Classes that a row was told as, and what it was."""
    return "; ".join(
        f"{one.column} {row[f'estimate:{one.column}']}, truth {row[one.column]}" for one in card.classes or ()
    )
