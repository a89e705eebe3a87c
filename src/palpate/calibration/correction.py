"""Correction of a network's estimates u to one sensor unit, fitted to a few presses.

With z = (u - centre) / scale and terms f(z) = (1, each z, each product of two),

    corrected = u + f(z) W,    W = argmin mean |label - u - f(z) W|^2 + strength |W|^2,

a ridge regression shrunk towards the identity. Terms and strength are chosen per target by
leave-one-press-out, nested for scores.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import onnx
from onnx import helper, numpy_helper

from palpate.core import Float, Indices, Values
from palpate.estimators.intervals import design

STRENGTHS = tuple(10.0**power for power in range(-6, 2))  # in units of the mean square of a term, about 1
AS_IT_WAS = "as it was"
NO_PRESS = -1

Terms = Float[np.ndarray, "n k"]


@dataclass(frozen=True, slots=True)
class Correction:
    """corrected = u + f(z) W.

    Attributes:
        centre, scale: of the estimates, in the targets' units ``[t]``.
        least, greatest: of the scaled training estimates ``[t]``; products stay constant beyond them.
        weights: W ``[k t]``; zeros where a target keeps its estimate.
    """

    centre: Float[np.ndarray, " t"]
    scale: Float[np.ndarray, " t"]
    least: Float[np.ndarray, " t"]
    greatest: Float[np.ndarray, " t"]
    weights: Float[np.ndarray, "k t"]

    @classmethod
    def none(cls, centre: Float[np.ndarray, " t"], scale: Float[np.ndarray, " t"], met: Values) -> Correction:
        """The identity, ready to be learnt: `met` are the estimates to learn from."""
        z = (met - centre) / scale
        weights = np.zeros((design(z[:1]).shape[1], z.shape[1]))
        return cls(centre, scale, z.min(axis=0), z.max(axis=0), weights)

    def terms(self, estimates: Values) -> Terms:
        """f(z)."""
        z = (estimates - self.centre) / self.scale
        terms = design(np.clip(z, self.least, self.greatest))
        terms[:, 1 : 1 + z.shape[1]] = z
        return terms

    def at(self, estimates: Values) -> Values:
        """The corrected estimates ``[n t]``."""
        return estimates + self.terms(estimates) @ self.weights

    def appended(self, model: onnx.ModelProto, tag: str) -> onnx.ModelProto:
        """Return a network with the correction behind it, in one graph.

        Args:
            model: from `image` to `value`; not changed.
            tag: word that no name in the graph contains yet.
        """
        whole = onnx.ModelProto()
        whole.CopyFrom(model)
        before = f"{tag}-before"
        for node in whole.graph.node:
            for names in (node.input, node.output):
                names[:] = [before if name == "value" else name for name in names]
        whole.graph.node.extend(self._nodes(before, tag))
        constants = {f"{tag}-{name}": value for name, value in self._constants().items()}
        whole.graph.initializer.extend(numpy_helper.from_array(v, k) for k, v in constants.items())
        onnx.checker.check_model(whole, full_check=True)
        return whole

    def _constants(self) -> dict[str, np.ndarray]:
        first, second = np.triu_indices(len(self.centre))
        rows = {"centre": self.centre, "scale": self.scale, "least": self.least, "greatest": self.greatest}
        return {name: value[None, :].astype(np.float32) for name, value in rows.items()} | {
            "first": first.astype(np.int64),
            "second": second.astype(np.int64),
            "offset": self.weights[0].astype(np.float32),
            "weights": self.weights[1:].astype(np.float32),
        }

    def _nodes(self, before: str, tag: str) -> list[onnx.NodeProto]:
        steps: tuple[tuple[str, tuple[str, ...], str, dict[str, int]], ...] = (
            ("Sub", ("centre",), "centred", {}),
            ("Div", ("centred", "scale"), "z", {}),
            ("Max", ("z", "least"), "raised", {}),
            ("Min", ("raised", "greatest"), "held", {}),
            ("Gather", ("held", "first"), "one", {"axis": 1}),
            ("Gather", ("held", "second"), "other", {"axis": 1}),
            ("Mul", ("one", "other"), "products", {}),
            ("Concat", ("z", "products"), "terms", {"axis": 1}),
            ("Gemm", ("terms", "weights", "offset"), "change", {}),
        )
        nodes = []
        for kind, inputs, output, how in steps:
            names = [f"{tag}-{name}" for name in inputs]
            nodes.append(
                helper.make_node(
                    kind, [before, *names] if kind == "Sub" else names, [f"{tag}-{output}"], **how
                )
            )
        return [*nodes, helper.make_node("Add", [before, f"{tag}-change"], ["value"])]


@dataclass(frozen=True, slots=True)
class Choice:
    """Terms ("as it was", "offset", "linear", or "quadratic"), their count, and shrinkage of a correction."""

    terms: str
    count: int = 0
    strength: float | None = None


@dataclass(frozen=True, slots=True)
class Adapted:
    """Correction with held-out estimates.

    Attributes:
        estimates: of the network alone ``[n t]``.
        held_out: corrected estimates, each by a correction that has not seen its press ``[n t]``.
    """

    correction: Correction
    estimates: Values
    held_out: Values
    choices: tuple[Choice, ...]


def correct(
    estimates: Values, true: Values, presses: Indices, start: Correction, *, linear: tuple[int, ...] = ()
) -> Adapted:
    """Fit a correction; keep a target's estimates unless leave-one-press-out shows an improvement of its mean
    absolute error by more than one standard error.

    Args:
        estimates, true: of the network, and labels, in the same units ``[n t]``.
        presses: press of each row ``[n]``, 0, 1, 2, and so on.
        start: identity, with the scales to work in.
        linear: targets whose correction is at most linear, as the cosine and sine of one direction.
    """
    folds = _LeavePressOut(start.terms(estimates), true - estimates, presses, linear)
    held_out, targets = estimates.copy(), range(true.shape[1])
    for press in range(folds.presses):
        rows = presses == press
        weights = folds.weights(folds.chosen(press), press)
        held_out[rows] += folds.terms[rows] @ weights
    helps = [_helps(held_out[:, j] - true[:, j], folds.errors[:, j], presses) for j in targets]
    best = folds.chosen()
    choices = tuple(c if good else Choice(AS_IT_WAS) for c, good in zip(best, helps, strict=True))
    for j in targets:
        if choices[j].terms == AS_IT_WAS:
            held_out[:, j] = estimates[:, j]
    return Adapted(replace(start, weights=folds.weights(choices)), estimates, held_out, choices)


def _helps(after: np.ndarray, before: np.ndarray, presses: Indices) -> bool:
    rows = np.bincount(presses)
    gain = np.bincount(presses, weights=np.abs(before) - np.abs(after)) / rows
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)))


class _LeavePressOut:
    """Ridge regressions without one press, or two, from sums that are made once for each press."""

    def __init__(self, terms: Terms, errors: Values, presses: Indices, linear: tuple[int, ...] = ()) -> None:
        self.linear = list(linear)
        self.terms, self.errors, self.of = terms, errors, presses
        self.presses = int(presses.max()) + 1
        self.rows = np.bincount(presses).astype(np.float64)
        parts = [presses == press for press in range(self.presses)]
        self._squares = np.stack([terms[p].T @ terms[p] for p in parts])
        self._moments = np.stack([terms[p].T @ errors[p] for p in parts])
        # A term for which there are not as many presses is not asked of them.
        t = errors.shape[1]
        counts = {"offset": 1, "linear": 1 + t, "quadratic": terms.shape[1]}
        self._kinds = {name: count for name, count in counts.items() if count <= self.presses}

    def chosen(self, without: int = NO_PRESS) -> tuple[Choice, ...]:
        """Terms and strength for each target by leave-one-press-out, without the press `without`."""
        rows = self.of != without
        choices, errors = [Choice(AS_IT_WAS)], [np.abs(self.errors[rows]).mean(axis=0)]
        for name, count in self._kinds.items():
            for strength, change in zip(STRENGTHS, self._changes(count, without), strict=True):
                choices.append(Choice(name, count, strength))
                errors.append(np.abs(self.errors - change)[rows].mean(axis=0))
                if name == "quadratic":
                    errors[-1][self.linear] = np.inf
        return tuple(choices[best] for best in np.argmin(errors, axis=0))

    def weights(self, choices: tuple[Choice, ...], without: int = NO_PRESS) -> Float[np.ndarray, "k t"]:
        others = np.arange(self.presses) != without
        n, weights = self.rows[others].sum(), np.zeros(self._moments.shape[1:])
        for j, choice in enumerate(choices):
            if choice.strength is not None:
                c = choice.count
                squares = self._squares[others, :c, :c].sum(axis=0) / n + choice.strength * np.eye(c)
                weights[:c, j] = np.linalg.solve(squares, self._moments[others, :c, j].sum(axis=0) / n)
        return weights

    def _changes(self, count: int, without: int) -> Float[np.ndarray, "s n t"]:
        """The change of every row at each strength, learnt without its own press and `without`."""
        squares, moments, rows = self._squares[:, :count, :count], self._moments[:, :count], self.rows
        others = np.arange(self.presses) != without
        n = rows[others].sum() - rows
        n[~others] = rows[others].sum()  # of the press left out itself nothing is asked; any sound sums do
        own = np.where(others, 1.0, 0.0)[:, None, None]
        a = (squares[others].sum(axis=0) - own * squares) / n[:, None, None]
        b = (moments[others].sum(axis=0) - own * moments) / n[:, None, None]
        sizes, axes = np.linalg.eigh(a)
        along = np.einsum("nk,nkm->nm", self.terms[:, :count], axes[self.of])
        aims = np.einsum("pkm,pkt->pmt", axes, b)[self.of]
        shrunk = [along / (np.maximum(sizes, 0.0)[self.of] + strength) for strength in STRENGTHS]
        return np.einsum("snm,nmt->snt", np.stack(shrunk), aims)
