"""Changes of the camera: how they look, what they cost a model, and a guard that knows it."""

from palpate.calibration.robustness.adapted_guard import CertifiedModel, adapted_guard
from palpate.calibration.robustness.perturbation_suite import Suite, try_changes
from palpate.calibration.robustness.perturbations import KINDS, kinds_for, perturbed

__all__ = [
    "KINDS", "CertifiedModel", "Suite", "adapted_guard", "kinds_for", "perturbed", "try_changes",
]  # fmt: skip
