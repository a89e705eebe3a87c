"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.trial_statistics import (
    Comparison,
    Line,
    compare,
    corrected_by_holm,
    fit_line,
    mean_interval,
)

__all__ = ["Comparison", "Line", "compare", "corrected_by_holm", "fit_line", "mean_interval"]
