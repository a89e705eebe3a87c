"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.grouped_trials import GroupedComparison, compare_grouped, refuse_confounded
from palpate.psychophysics.judgements import (
    Condition,
    Judgement,
    Presentation,
    Stimulus,
    Task,
    checked_code,
    checked_judgements,
    is_rehearsal,
    read_judgements,
    read_stimuli,
    write_stimuli,
)
from palpate.psychophysics.trial_statistics import (
    Comparison,
    Line,
    compare,
    corrected_by_holm,
    fit_line,
    mean_interval,
)

__all__ = [
    "Comparison", "Condition", "GroupedComparison", "Judgement", "Line", "Presentation", "Stimulus", "Task",
    "checked_code", "checked_judgements", "compare", "compare_grouped", "corrected_by_holm", "fit_line",
    "is_rehearsal", "mean_interval", "read_judgements", "read_stimuli", "refuse_confounded", "write_stimuli",
]  # fmt: skip
