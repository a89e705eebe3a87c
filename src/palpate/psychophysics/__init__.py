"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.grouped_trials import GroupedComparison, compare_grouped, refuse_confounded
from palpate.psychophysics.trial_statistics import (
    Comparison,
    Line,
    compare,
    corrected_by_holm,
    fit_line,
    mean_interval,
)

__all__ = [
    "Comparison",
    "GroupedComparison",
    "Line",
    "compare",
    "compare_grouped",
    "corrected_by_holm",
    "fit_line",
    "mean_interval",
    "refuse_confounded",
]
