"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.line_fit import Line, fit_line
from palpate.psychophysics.rank_tests import Comparison, bootstrap_interval, compare

__all__ = ["Comparison", "Line", "bootstrap_interval", "compare", "fit_line"]
