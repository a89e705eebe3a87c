"""Simple estimates of normal force, held out by the same presses as a calibration's law."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palpate.calibration.shear.force_interval import held_out
from palpate.calibration.shear.labelled_cues import LabelledCues
from palpate.core import Bool, Float, ndarray

Rows = Float[ndarray, "n k"]
Series = Float[ndarray, " n"]
Fit = Callable[[Rows, Series], Callable[[Rows], Series]]

STRENGTHS = np.logspace(-4, 2, 13)
KERNEL_STRENGTH, KERNEL_WIDTH = 1e-2, 0.5  # of standardised inputs


def baseline_errors(samples: LabelledCues, used: Bool[ndarray, " n"]) -> dict[str, float]:
    """Mean absolute error of each baseline on presses it was not fitted to [N].

    The mean force; a line in the mean shift, which is the published law; kernel ridge on gamma and the ring's
    area; and where frames were at hand a line in the sum of pixels' change, and ridge and kernel ridge on the
    moments of that change.

    Args:
        samples: labelled frames.
        used: those to fit to and to score on.
    """
    return {name: _error(*one, samples, used) for name, one in _inputs(samples).items()}


def transferred_errors(
    learnt: LabelledCues, used: Bool[ndarray, " n"], read: LabelledCues, scored: Bool[ndarray, " m"]
) -> dict[str, float]:
    """Mean absolute error of each baseline of one run on another, of a later day or of another pad [N].

    Args:
        learnt, used: frames, and those to fit to.
        read, scored: frames of the other run, and those to score on.
    """
    fits, inputs = _inputs(learnt), _inputs(read)
    truth, errors = read.force_n[scored], {}
    for name in [one for one in fits if one in inputs]:
        rows, fit = fits[name]
        model = fit(_finite(rows)[used], learnt.force_n[used])
        errors[name] = float(np.abs(model(_finite(inputs[name][0])[scored]) - truth).mean())
    return errors


def _inputs(samples: LabelledCues) -> dict[str, tuple[Rows, Fit]]:
    """Inputs of each baseline, and how it is fitted."""
    gamma = np.array([c.gamma for c in samples.cues])
    area = np.array([c.radius_m**2 for c in samples.cues])
    inputs: dict[str, tuple[Rows, Fit]] = {
        "mean": (np.zeros((len(gamma), 1)), _line),
        "mean shift": (gamma[:, None], _line),
        "kernel ridge on gamma and area": (np.column_stack([gamma, 1e6 * area]), _kernel_ridge),
    }
    if samples.image is not None:
        inputs["sum of pixel change"] = (samples.image[:, :1], _line)
        inputs["ridge on image moments"] = (samples.image, _ridge)
        inputs["kernel ridge on image moments"] = (samples.image, _kernel_ridge)
    return inputs


def _finite(rows: Rows) -> Rows:
    return np.where(np.isfinite(rows), rows, 0.0)


def _error(rows: Rows, fit: Fit, samples: LabelledCues, used: Bool[ndarray, " n"]) -> float:
    rows = _finite(rows)

    def fitted(kept: Bool[ndarray, " n"]) -> Series:
        learnt = used & kept
        return fit(rows[learnt], samples.force_n[learnt])(rows)

    estimate = held_out(fitted, samples.press)
    return float(np.abs(estimate - samples.force_n)[used].mean())


def _line(rows: Rows, force_n: Series) -> Callable[[Rows], Series]:
    terms = np.column_stack([rows, np.ones(len(rows))])
    weights = np.linalg.lstsq(terms, force_n, rcond=None)[0]
    return lambda now: np.asarray(now @ weights[:-1] + weights[-1])


def _ridge(rows: Rows, force_n: Series) -> Callable[[Rows], Series]:
    from sklearn.linear_model import RidgeCV
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    model = make_pipeline(StandardScaler(), PolynomialFeatures(2, include_bias=False), RidgeCV(STRENGTHS))
    model.fit(rows, force_n)
    return lambda now: np.asarray(model.predict(now))


def _kernel_ridge(rows: Rows, force_n: Series) -> Callable[[Rows], Series]:
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    kernel = KernelRidge(alpha=KERNEL_STRENGTH, kernel="rbf", gamma=KERNEL_WIDTH)
    model, mean = make_pipeline(StandardScaler(), kernel), float(force_n.mean())
    model.fit(rows, force_n - mean)
    return lambda now: np.asarray(mean + model.predict(now))
