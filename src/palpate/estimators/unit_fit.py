"""Bayesian fit of one sensor unit: maximum a posteriori (MAP), with Laplace covariance.

A unit differs from its design by terms with a Gaussian prior; each press adds nuisances with their own. A
sensor gives the forward model (`UnitModel`); here are Levenberg-Marquardt steps, covariances, and held-out
presses. Rows may be robust (pseudo-Huber; P. Charbonnier et al., IEEE Trans. Image Processing 6 (1997) 298,
doi:10.1109/83.551699). Errors are correlated within clusters, whose scores (K.-Y. Liang and S. L. Zeger,
Biometrika 73 (1986) 13, doi:10.1093/biomet/73.1.13) are added to the Laplace covariance.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from palpate.core import Float, InputError, Int, Progress, RangeError, ndarray, new_file, storage_errors

UNTOLD = 0.8  # ratio to its prior spread from which a term is not identified
TIED = 0.95  # correlation from which two terms cannot be distinguished

GRAVITY_M_S2 = 9.80665  # standard; over the Earth it varies by 0.5 %
WEIGHT_SHARE = 0.005
SAID = 2.6  # standard deviations of a significant change, 1 in 100 by chance
DAILY = 0.1  # spread of a nuisance term from day to day, as a fraction of that from unit to unit

AS_STATED = 4.0  # errors in number, of the stated size, that are assumed in addition to those seen
MIN_PRESSES = 2  # presses below which none is held out

State = Float[ndarray, " u"]
Square = Float[ndarray, "u u"]
Covariance = Float[ndarray, "t t"]


class Layout(NamedTuple):
    """Order of the unknowns: terms of the unit, nuisances (`own`) of each press, and others."""

    terms: int
    own: int
    presses: int
    others: int = 0

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.terms + self.own * self.presses + self.others

    def own_of(self, state: State) -> Float[ndarray, "n o"]:
        """Nuisances of each press, a view."""
        return state[self.terms : self.terms + self.own * self.presses].reshape(self.presses, self.own)

    def at(self, press: int) -> Int[ndarray, " k"]:
        """Indices of the terms and of a press's nuisances."""
        return np.concatenate([np.arange(self.terms), self.terms + self.own * press + np.arange(self.own)])

    def row(self, press: int, slopes: Float[ndarray, " k"]) -> State:
        """Slopes over the terms and a press's nuisances, over all unknowns."""
        J = np.zeros(self.size)
        J[self.at(press)] = slopes
        return J


class Block(NamedTuple):
    """Measured rows of one press.

    Attributes:
        at: Unknowns that move them.
        slopes: Derivatives of the predictions with respect to these.
        residual: Measured less predicted, 0 if nothing is measured.
        sd: Standard deviation of a row.
        cluster: Cluster of each row.
    """

    at: Int[ndarray, " k"]
    slopes: Float[ndarray, "r k"]
    residual: Float[ndarray, " r"]
    sd: float
    cluster: Int[ndarray, " r"]


@dataclass(frozen=True, slots=True, eq=False)
class KnownRow:
    """Known force or position of a press: slopes over all unknowns, residual, and weight."""

    slopes: State
    off: float
    weight: float
    press: int
    is_force: bool


@runtime_checkable
class UnitModel(Protocol):
    """Forward model of a sensor unit's presses."""

    mean: State  # prior mean of all unknowns
    precision: Square  # prior precision; 0 for an unknown without a prior
    kink: float  # standard deviations from which a row of data weighs less; infinite for least squares

    def residuals(self, state: State) -> Iterator[tuple[Float[ndarray, " r"], float]]:
        """Yield residual and standard deviation of each press's rows."""

    def blocks(self, state: State) -> Iterator[Block]:
        """Yield the rows of each press."""

    def known(self, state: State) -> list[KnownRow]:
        """Return rows of known forces and positions."""

    def inside(self, state: State) -> State:
        """Return the nearest state within bounds."""


class Posterior(NamedTuple):
    """Most probable state, Hessian of half the cost, clusters' covariance, covariance, known rows."""

    state: State
    hessian: Square
    meat: Square
    covariance: Square
    known: list[KnownRow]


def cost(model: UnitModel, state: State) -> float:
    """Return twice the negative log posterior density, up to a constant."""
    data = sum(_misfit(residual / sd, model.kink) for residual, sd in model.residuals(state))
    sure = sum(one.weight * one.off**2 for one in model.known(state))
    away = state - model.mean
    return float(data + sure + away @ model.precision @ away)


def most_probable(
    model: UnitModel, state: State, progress: Progress, *, rounds: int = 25, settled: float = 0.02,
    stiffest: float = 20.0,
) -> State:  # fmt: skip
    """Return the most probable state near a first one.

    Args:
        model: Forward model.
        state: Start within bounds.
        progress: Progress callback, called with rounds.
        rounds: Greatest number of rounds.
        settled: Fall of the cost that ends the search, at a cost of 0; 1 is a standard deviation.
        stiffest: Damping from which no step is tried.
    """
    damping, now = 1e-3, cost(model, state)
    for i in range(rounds):
        progress("rounds", i, rounds)
        H, g = _normal(model, state)
        while damping < stiffest:
            after = _stepped(model, state, H + damping * np.diag(np.diag(H)), g)
            new = cost(model, after)
            if new < now:
                break
            damping *= 10.0
        else:
            return state
        state, fallen, now, damping = after, now - new, new, max(damping / 10.0, 1e-6)
        if fallen < settled * (1.0 + now / 100.0):
            return state
    return state


def posterior(model: UnitModel, state: State) -> Posterior:
    """Return the Laplace covariance of a settled state, with the part of correlated errors."""
    H, meat = model.precision.copy(), np.zeros_like(model.precision)
    for at, J, residual, sd, cluster in model.blocks(state):
        weight = _weight(residual / sd, model.kink)
        H[np.ix_(at, at)] += (J.T * weight) @ J / sd**2
        scores = np.stack([np.bincount(cluster, one * weight * residual) for one in J.T]) / sd**2
        meat[np.ix_(at, at)] += scores @ scores.T
    known = model.known(state)
    H += sum(one.weight * np.outer(one.slopes, one.slopes) for one in known)
    return Posterior(state, H, meat, _covariance(H, meat), known)


def covariance_with(terms: Covariance, press: Float[ndarray, "k k"]) -> Covariance:
    """Return the terms' covariance after one more press with this Hessian over terms and nuisances."""
    n, H = len(terms), press.copy()
    H[:n, :n] += np.linalg.inv(terms)
    return np.asarray(np.linalg.inv(H)[:n, :n])


def _misfit(z: Float[ndarray, " r"], kink: float) -> float:
    if math.isinf(kink):
        return float(z @ z)
    return 2 * kink**2 * float(np.sum(np.sqrt(1 + (z / kink) ** 2) - 1))


def _weight(z: Float[ndarray, " r"], kink: float) -> Float[ndarray, " r"]:
    return 1 / np.sqrt(1 + (z / kink) ** 2)


def _normal(model: UnitModel, state: State) -> tuple[Square, State]:
    """Normal matrix and gradient descent direction of the cost."""
    H, g = model.precision.copy(), model.precision @ (model.mean - state)
    for at, J, residual, sd, _ in model.blocks(state):
        weight = _weight(residual / sd, model.kink)
        H[np.ix_(at, at)] += (J.T * weight) @ J / sd**2
        g[at] += J.T @ (weight * residual) / sd**2
    for one in model.known(state):
        H += one.weight * np.outer(one.slopes, one.slopes)
        g += one.weight * one.slopes * one.off
    return H, g


def _stepped(model: UnitModel, state: State, H: Square, g: State) -> State:
    """State after one step; unknowns at bounds are fixed and the others solved again."""
    free = np.ones(len(state), bool)
    for _ in range(3):
        step = np.zeros(len(state))
        step[free] = np.linalg.solve(H[np.ix_(free, free)], g[free])
        after = model.inside(state + step)
        held = free & (after == state) & (step != 0)
        if not held.any():
            break
        free &= ~held
    return after


class Widening(NamedTuple):
    """Factors on the standard deviations of a new press, from held-out presses; 1 without any."""

    place: float = 1.0
    depth: float = 1.0
    force: float = 1.0
    presses: int = 0


def standardised(
    hessian: Square, meat: Square, known: Sequence[KnownRow], depth_at: Sequence[int]
) -> dict[str, list[float]]:
    """Return errors of every held-out press over their stated standard deviations.

    Each press is read as new by the unit fitted to the others: one linear solve without its known force and
    position.

    Args:
        hessian: Hessian of half the cost, at the fit of all.
        meat: Covariance of clusters' scores.
        known: Known rows of all presses.
        depth_at: Index of each press's log depth.
    """
    found: dict[str, list[float]] = {"place": [], "depth": [], "force": []}
    whole = _covariance(hessian, meat)
    for i, depth in enumerate(depth_at):
        rows = [one for one in known if one.press == i]
        if not rows:
            continue
        H = hessian - sum(one.weight * np.outer(one.slopes, one.slopes) for one in rows)
        g = -sum(one.weight * one.off * one.slopes for one in rows)
        covariance, step = _covariance(H, meat), np.linalg.solve(H, g)
        for one in rows:
            off = one.off - one.slopes @ step
            variance = one.slopes @ covariance @ one.slopes + 1 / one.weight
            found["force" if one.is_force else "place"].append(off / math.sqrt(variance))
        if any(one.is_force for one in rows):  # against the depth at which the known force is
            variance = max(covariance[depth, depth] - whole[depth, depth], 0.1 * covariance[depth, depth])
            found["depth"].append(step[depth] / math.sqrt(variance))
    return found


def widening_of(errors: dict[str, list[float]], presses: int) -> Widening:
    """Return factors of at least 1 on intervals, from standardized errors of held-out presses."""
    if presses < MIN_PRESSES:
        return Widening()

    def factor(name: str) -> float:
        seen = np.array(errors[name])
        return max(math.sqrt((AS_STATED + float(seen @ seen)) / (AS_STATED + len(seen))), 1.0)

    return Widening(factor("place"), factor("depth"), factor("force"), presses)


def _covariance(hessian: Square, meat: Square) -> Square:
    bread = np.linalg.inv(hessian)
    return np.asarray(bread + bread @ meat @ bread)


def weight_n(mass_kg: float) -> float:
    """Return the weight of a mass laid on a sensor [N]."""
    if not (math.isfinite(mass_kg) and mass_kg > 0):
        raise RangeError(f"a mass of {1e3 * mass_kg:g} g; give one above 0 g", code="mass-range")
    return mass_kg * GRAVITY_M_S2


def term_rows(
    names: Sequence[str], values: Float[ndarray, " t"], covariance: Covariance
) -> dict[str, dict[str, float]]:
    """Return each term's value and standard deviation by name."""
    spreads = np.sqrt(np.diag(covariance))
    return {
        name: {"value": float(value), "standard_deviation": float(spread)}
        for name, value, spread in zip(names, values, spreads, strict=True)
    }


def untold_terms(names: Sequence[str], before: Covariance, after: Covariance) -> tuple[str, ...]:
    """Return terms whose uncertainty hardly fell."""
    was, now = np.sqrt(np.diag(before)), np.sqrt(np.diag(after))
    return tuple(name for name, b, a in zip(names, was, now, strict=True) if a > UNTOLD * b)


def correlated_pairs(names: Sequence[str], covariance: Covariance) -> tuple[tuple[str, str], ...]:
    """Return pairs of terms that cannot be distinguished."""
    sd = np.sqrt(np.diag(covariance))
    high = np.abs(np.triu(covariance / np.outer(sd, sd), 1)) > TIED
    return tuple((names[i], names[j]) for i, j in np.argwhere(high))


def since_fit(before: Covariance, design: Covariance, constants: int) -> tuple[Covariance, Covariance]:
    """Return the terms' covariance some days after the fit, and that of a change of the constants since.

    Args:
        before: Covariance at the fit.
        design: Covariance between units; `DAILY` of its spread is the daily one of other terms.
        constants: Number of first terms that a known weight checks.
    """
    daily, freedom = DAILY**2 * np.diag(np.diag(design)), np.zeros_like(design)
    daily[:constants] = 0.0
    freedom[:constants, :constants] = design[:constants, :constants]
    return before + daily, freedom


def changed_since(
    change: Float[ndarray, " t"], freedom: Covariance, before: Covariance, now: Covariance
) -> tuple[Float[ndarray, " t"], Covariance]:
    """Return the change of terms since `before`, and its covariance.

    With terms N(m, C) and a change N(0, D), the change's part of a move from m is D (C + D)^-1.

    Args:
        change: Most probable terms, now less before.
        freedom: D.
        before: C.
        now: Covariance of the terms now.
    """
    share = freedom @ np.linalg.inv(before + freedom)
    return share @ change, freedom - share @ freedom + share @ now @ share.T


def drifted(changes: dict[str, float]) -> tuple[str, ...]:
    """Return names of significant changes, given in standard deviations."""
    return tuple(name for name, deviations in changes.items() if abs(deviations) > SAID)


MAX_TERM = 100.0  # in its own unit: no logarithm, angle, millimeter, pixel or mired comes near

Unit = TypeVar("Unit")


def write_unit(
    path: Path, form: str, names: Sequence[str], terms: Float[ndarray, " t"],
    covariance: Float[ndarray, "t t"], others: dict[str, Any],
) -> None:  # fmt: skip
    """Write a sensor unit to a new file; `form` is name and version, `others` are plain numbers."""
    record = {
        "format": form, "terms": dict(zip(names, terms.tolist(), strict=True)),
        "covariance": covariance.tolist(), **others,
    }  # fmt: skip
    with new_file(path) as building:
        building.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_unit(
    path: Path, form: str, names: Sequence[str], command: str,
    made: Callable[[dict[str, Any], ndarray, ndarray], Unit],
) -> Unit:  # fmt: skip
    """Read a sensor unit as `write_unit` wrote it.

    Args:
        path: File.
        form: Name and version of the format.
        names: Names of the terms.
        command: Command that writes such a file, for messages.
        made: Function from record, terms, and covariance to the unit; raises ValueError.
    """
    if not path.is_file():
        raise InputError(f"there is no file {path}; `{command}` makes one", code="file-missing")
    with storage_errors(path):
        text = path.read_bytes()
    try:
        return made(*_numbers(json.loads(text), form, names))
    except InputError as e:
        raise InputError(f"{path} is no unit that can be used: {e}", code=e.code) from e
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as e:
        raise InputError(f"{path} is no unit's file: {type(e).__name__}: {e}", code="unit-damaged") from e


def _numbers(
    record: dict[str, Any], form: str, names: Sequence[str]
) -> tuple[dict[str, Any], ndarray, ndarray]:
    if record["format"] != form:
        raise InputError(f"its format is {record['format']!r}, not {form!r}; fit anew", code="unit-format")
    terms = np.array([float(record["terms"][name]) for name in names])
    covariance = np.array(record["covariance"], dtype=np.float64)
    if covariance.shape != (len(names),) * 2 or not np.isfinite(covariance).all():
        raise ValueError("its covariance is not one of its terms")
    sound = bool((np.abs(terms) < MAX_TERM).all())
    if not (sound and np.linalg.eigvalsh((covariance + covariance.T) / 2).min() > 0):
        raise ValueError(f"its numbers are not those of {form}")
    return record, terms, covariance
