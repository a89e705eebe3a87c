"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.assignment import Assignment, assign, nearest
from palpate.psychophysics.groups import Comparison, compare
from palpate.psychophysics.lines import Line, fit_line

__all__ = ["Assignment", "Comparison", "Line", "assign", "compare", "fit_line", "nearest"]
