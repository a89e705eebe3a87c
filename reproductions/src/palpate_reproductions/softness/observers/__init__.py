"""Observers: what a person of stated noise would answer, fitted to some conditions and tested on others."""

from palpate_reproductions.softness.observers.cue_combination import (
    combined_observer,
    combined_sensitivity,
    correlation_needed,
    gain_needed,
)
from palpate_reproductions.softness.observers.cue_prediction import (
    CueNeeds,
    CuePrediction,
    needs_of,
    predict_by_accuracy,
    predict_with_faults,
    predict_with_spacing,
    predictions_of,
)
from palpate_reproductions.softness.observers.observer_fit import (
    ObserverFit,
    composite_log_likelihood,
    fit_observer,
    fit_shared_spacing,
    sensitivities_at,
    sensitivity_at,
)
from palpate_reproductions.softness.observers.unlike_people import predict_of_unlike_people

__all__ = [
    "CueNeeds",
    "CuePrediction",
    "ObserverFit",
    "combined_observer",
    "combined_sensitivity",
    "composite_log_likelihood",
    "correlation_needed",
    "fit_observer",
    "fit_shared_spacing",
    "gain_needed",
    "needs_of",
    "predict_by_accuracy",
    "predict_of_unlike_people",
    "predict_with_faults",
    "predict_with_spacing",
    "predictions_of",
    "sensitivities_at",
    "sensitivity_at",
]
