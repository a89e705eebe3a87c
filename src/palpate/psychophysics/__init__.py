"""Statistics of specimens, stimuli and people."""

from palpate.psychophysics.trial_statistics import Comparison, Line, bootstrap_interval, compare, fit_line

__all__ = ["Comparison", "Line", "bootstrap_interval", "compare", "fit_line"]
