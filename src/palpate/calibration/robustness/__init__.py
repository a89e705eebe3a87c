"""Changes of the camera: how they look, what they cost a model, and a guard that knows it."""

from palpate.calibration.robustness.perturbation_suite import Suite, guard_of, try_changes
from palpate.calibration.robustness.perturbations import KINDS, perturbed

__all__ = ["KINDS", "Suite", "guard_of", "perturbed", "try_changes"]
