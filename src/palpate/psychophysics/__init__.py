"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.groups import Comparison, compare
from palpate.psychophysics.lines import Line, fit_line

__all__ = ["Comparison", "Line", "compare", "fit_line"]
