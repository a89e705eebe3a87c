"""Matérn kernel with a linear part, regression with it, and a learned metric.

k = (1 + r + r²/3) e⁻ʳ + s z·z′ with r = √5 |z - z′| / l (Rasmussen & Williams, Gaussian Processes for Machine
Learning, MIT Press 2006, ch. 4). The metric is the mean outer product of a first fit's gradients
(Radhakrishnan et al., Science 383:1461 (2024), doi:10.1126/science.adi5639).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from palpate.core import Float, Progress, Values, silent

Scores = Float[np.ndarray, "n k"]

MIN_METRIC = 1e-4  # least weight of every component in a learned metric
JITTER = 1e-9  # of the kernel's diagonal, below which its rows are alike


@dataclass(frozen=True, slots=True)
class Kernel:
    """Matérn kernel of smoothness 5/2 with a length in units of the scores, plus a linear kernel."""

    length: float
    slope: float = 0.0

    @classmethod
    def over(cls, scores: Scores, width: float, linear: float) -> Kernel:
        """Return the kernel scaled by the rows' RMS distance and mean square."""
        square = float(scores.var(axis=0).sum()) or 1.0
        return cls(width * math.sqrt(2 * square), linear / square)

    def reach(self, a: Scores, b: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n m"]:
        squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
        return np.sqrt(np.maximum(squares, 0) * (5 / self.length**2))

    def of(self, a: Scores, b: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n m"]:
        r = self.reach(a, b)
        linear = self.slope * (a @ b.T) if self.slope else 0.0
        return (1 + r + r**2 / 3) * np.exp(-r) + linear

    def gradients(self, a: Scores, dual: Float[np.ndarray, " n"]) -> Scores:
        """Return gradients of Σ dual k(·, aᵢ) at the rows a themselves."""
        r = self.reach(a, a)
        pull = (1 + r) * np.exp(-r) * (5 / (3 * self.length**2)) * dual
        return pull @ a - pull.sum(axis=1)[:, None] * a + self.slope * (dual @ a)


@dataclass(frozen=True, slots=True)
class KernelShape:
    """Shape of the kernel, as inner folds choose it.

    Attributes:
        width: Length in RMS distances between rows.
        linear: Variance of the linear part relative to Matérn's.
        metric: Whether distances use a learned metric.
    """

    width: float = 1.0
    linear: float = 0.0
    metric: bool = False

    def __str__(self) -> str:
        line = f", linear share {self.linear:g}" if self.linear else ""
        return f"width {self.width:g}{line}{', learnt metric' if self.metric else ''}"


def solve(
    kernel: Kernel,
    scores: Scores,
    targets: Values,
    near: np.ndarray,
    penalties: Float[np.ndarray, " t"],
    progress: Progress = silent,
    batch: int = 2048,
) -> Float[np.ndarray, "m t"]:
    """Return the weights of the centers `near` for the penalty of each target.

    With all rows as centers (K + λ)⁻¹ y, else Nyström: ridge regression on L⁻¹ k, L Lᵀ the kernel among the
    centers (Rasmussen & Williams, ch. 8).
    """
    between = kernel.of(scores[near], scores[near])
    between[np.diag_indices_from(between)] += JITTER * len(near)
    if len(near) == len(scores):
        return _ridge(between, targets, penalties)
    lower = np.linalg.cholesky(between)
    products, sums = np.zeros_like(between), np.zeros((len(near), targets.shape[1]))
    for start in range(0, len(scores), batch):
        part = slice(start, start + batch)
        white = solve_triangular(lower, kernel.of(scores[near], scores[part]), lower=True)
        products += white @ white.T
        sums += white @ targets[part]
        progress("solving", min(start + batch, len(scores)), len(scores))
    return np.asarray(solve_triangular(lower.T, _ridge(products, sums, penalties)))


def _ridge(square: Float[np.ndarray, "m m"], right: Values, penalties: Float[np.ndarray, " t"]) -> Values:
    """(square + λ)⁻¹ right, each column with its own λ."""
    answer = np.empty_like(right)
    for penalty in np.unique(penalties):
        its = penalties == penalty
        factor = cho_factor(square + penalty * np.eye(len(square)), lower=True, overwrite_a=True)
        answer[:, its] = cho_solve(factor, right[:, its])
    return answer


def learnt_metric(
    scores: Scores, targets: Values, shape: KernelShape, penalties: Float[np.ndarray, " t"]
) -> Float[np.ndarray, "k k"]:
    """Return the map of scores after which distances count what the targets change by.

    Args:
        scores: Scores of the training rows.
        targets: Values of zero mean and unit spread.
        shape: Kernel of the first fit.
        penalties: Penalties of the first fit by target.
    """
    kernel = Kernel.over(scores, shape.width, shape.linear)
    dual = _ridge(kernel.of(scores, scores) + JITTER * np.eye(len(scores)), targets, penalties)
    outer = np.zeros((scores.shape[1],) * 2)
    for weights in dual.T:
        gradients = kernel.gradients(scores, weights)
        outer += gradients.T @ gradients
    size = float(np.trace(outer))
    if not size > 0:
        return np.eye(len(outer))
    squares, axes = np.linalg.eigh(outer / size + MIN_METRIC / len(outer) * np.eye(len(outer)))
    return np.asarray(axes * np.sqrt(np.maximum(squares, 0)))
