"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.line_fit import Line, fit_line
from palpate.psychophysics.rank_tests import Comparison, bootstrap_interval, compare
from palpate.psychophysics.trial_assignment import Assignment, assign, nearest

__all__ = [
    "Assignment", "Comparison", "Line", "assign", "bootstrap_interval", "compare", "fit_line", "nearest",
]  # fmt: skip
