"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.line_fit import Line, fit_line
from palpate.psychophysics.rank_tests import Comparison, compare
from palpate.psychophysics.trial_assignment import Assignment, assign, nearest

__all__ = ["Assignment", "Comparison", "Line", "assign", "compare", "fit_line", "nearest"]
