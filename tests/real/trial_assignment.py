"""Which of several objects was touched? Each trial assigned by all others, and how likely luck does as well.

A trial goes to the object whose mean is nearest, every feature measured in units of its spread within objects
(pooled over them, both from the other trials): linear discriminant analysis with a diagonal covariance and
equal odds. With a few trials an object no more can be estimated.

Luck is judged by giving the trials each other's labels: the p-value is the share of all labellings (or of
many drawn, and the true one) for which as many trials or more are assigned rightly, each labelling going
through all of the leaving-out. It cannot be less than `least_p`, since a labelling that only swaps objects'
names scores the same. It takes trials as exchangeable: trials of one object made in one sitting, in one
light, are not, and no permutation of them tells the object from its sitting.

References: E. S. Edgington, P. Onghena, Randomization Tests (2007); B. Phipson, G. K. Smyth, Permutation
P-values should never be zero, Stat. Appl. Genet. Mol. Biol. 9 (2010) 39, doi:10.2202/1544-6115.1585.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from palpate.core import Float, InputError, Int, ndarray

EXACT_UP_TO = 20_000  # labellings
DRAWS = 9_999
CHUNK = 2_000  # labellings at a time, for memory's sake
MIN_A_CLASS = 2
STILL = 1e-12  # of a feature's variance: a spread within objects below it counts as this

Features = Float[ndarray, "n k"]


@dataclass(frozen=True)
class Assignment:
    """What became of every trial.

    Attributes:
        labels: of the trials.
        assigned: of each, by all others.
        p: share of labellings that do as well or better.
        least_p: the smallest that it can be, as far as names and draws tell.
        labellings: that were gone through, the true one included.
        exact: they are all there are.
    """

    labels: tuple[str, ...]
    assigned: tuple[str, ...]
    p: float
    least_p: float
    labellings: int
    exact: bool

    @property
    def right(self) -> int:
        """Trials assigned to their own object."""
        return sum(a == b for a, b in zip(self.assigned, self.labels, strict=True))


def assign(features: Any, labels: Sequence[str], rng: np.random.Generator, draws: int = DRAWS) -> Assignment:
    """Assign every trial by all others, and judge how likely luck does as well.

    Args:
        features: a row a trial, or one value a trial.
        labels: object of every trial.
        rng: for labellings, where there are too many to go through all.
        draws: how many then.

    Raises:
        InputError: features that are not finite or the same for all trials, fewer than two objects, or an
            object with one trial.

    Example:
        >>> stiffness = [1.0, 1.1, 1.2, 2.0, 2.1, 2.2]
        >>> found = assign(stiffness, ["soft"] * 3 + ["hard"] * 3, np.random.default_rng(0))
        >>> found.right, round(found.p, 2)
        (6, 0.1)
    """
    x, names, codes = _checked(features, labels)
    assigned = _left_out(x, codes[None])[0]
    right = int((assigned == codes).sum())
    counts = np.bincount(codes)
    total = math.factorial(len(codes)) // math.prod(math.factorial(int(n)) for n in counts)
    exact = total <= EXACT_UP_TO
    others = _all(codes) if exact else _drawn(codes, draws, rng)
    as_good = sum(
        int(((_left_out(x, chunk) == chunk).sum(axis=1) >= right).sum()) for chunk in _chunks(others)
    )
    swaps = math.prod(math.factorial(n) for n in Counter(counts.tolist()).values())
    n = total if exact else draws + 1
    return Assignment(
        tuple(labels),
        tuple(names[k] for k in assigned),
        (as_good if exact else as_good + 1) / n,
        max(swaps / total, 1 / n),
        n,
        exact,
    )


def nearest(features: Any, labels: Sequence[str], others: Any) -> tuple[str, ...]:
    """Assign other trials, perhaps of other objects, by all of these.

    Raises:
        InputError: as `assign`, or others with other features.
    """
    x, names, codes = _checked(features, labels)
    new = np.asarray(others, np.float64)
    new = new[:, None] if new.ndim == 1 else new
    if new.ndim != 2 or new.shape[1] != x.shape[1] or not np.isfinite(new).all():
        raise InputError(
            f"other trials of {list(new.shape)} finite features, these have {x.shape[1]} each",
            code="feature-count",
        )
    means = np.array([x[codes == k].mean(axis=0) for k in range(len(names))])
    within = ((x - means[codes]) ** 2).sum(axis=0) / (len(x) - len(names))
    within = np.maximum(within, STILL * x.var(axis=0))
    distance = ((new[:, None] - means) ** 2 / within).sum(axis=2)
    return tuple(names[k] for k in distance.argmin(axis=1))


def _checked(features: Any, labels: Sequence[str]) -> tuple[Features, list[str], Int[ndarray, " n"]]:
    x = np.asarray(features, np.float64)
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != len(labels) or not np.isfinite(x).all():
        raise InputError(
            f"features of {list(x.shape)} for {len(labels)} trials; one finite row a trial",
            code="lengths-differ",
        )
    if not (np.ptp(x, axis=0) > 0).all():
        raise InputError("a feature is the same for all trials; leave it out", code="feature-constant")
    names, codes = np.unique(np.asarray(labels, dtype=str), return_inverse=True)
    few = [str(name) for name, n in zip(names, np.bincount(codes), strict=True) if n < MIN_A_CLASS]
    if len(names) < 2 or few:
        alone = f", with one trial of {', '.join(few)}" if few else ""
        raise InputError(
            f"{len(names)} objects{alone}; two objects or more, {MIN_A_CLASS} trials or more of each, so "
            "that one can be left out",
            code="too-few-trials",
        )
    if len(x) - 1 <= len(names):
        raise InputError(
            f"{len(x)} trials of {len(names)} objects leave no spread to measure by; repeat more",
            code="too-few-objects",
        )
    return x, [str(name) for name in names], codes.astype(np.int64)


def _left_out(x: Features, labellings: Int[ndarray, "m n"]) -> Int[ndarray, "m n"]:
    """Of every labelling and trial the object nearest to it, learnt from the other trials."""
    x = x - x.mean(axis=0)
    n, objects = len(x), int(labellings.max()) + 1
    is_of = np.eye(objects)[labellings]  # [m n c]
    count = is_of.sum(axis=1, keepdims=True) - is_of  # of others, for each trial left out
    total = np.einsum("mnc,nk->mck", is_of, x)[:, None] - is_of[..., None] * x[:, None]
    means = total / count[..., None]
    squares = (x**2).sum(axis=0) - x**2  # [n k]
    within = (squares - (count[..., None] * means**2).sum(axis=2)) / (n - 1 - objects)
    within = np.maximum(within, STILL * x.var(axis=0))
    distance = ((x[:, None] - means) ** 2 / within[:, :, None]).sum(axis=3)
    return distance.argmin(axis=2)


def _all(codes: Int[ndarray, " n"]) -> Iterator[Int[ndarray, " n"]]:
    """Every labelling with as many trials of each object."""

    def fill(free: tuple[int, ...], objects: list[int]) -> Iterator[dict[int, int]]:
        if not objects:
            yield {}
            return
        first, *rest = objects
        for chosen in combinations(free, int((codes == first).sum())):
            for more in fill(tuple(i for i in free if i not in chosen), rest):
                yield {**dict.fromkeys(chosen, first), **more}

    for found in fill(tuple(range(len(codes))), list(range(int(codes.max()) + 1))):
        yield np.array([found[i] for i in range(len(codes))])


def _drawn(codes: Int[ndarray, " n"], draws: int, rng: np.random.Generator) -> Iterator[Int[ndarray, " n"]]:
    return (rng.permutation(codes) for _ in range(draws))


def _chunks(labellings: Iterator[Int[ndarray, " n"]]) -> Iterator[Int[ndarray, "m n"]]:
    held: list[Int[ndarray, " n"]] = []
    for labelling in labellings:
        held.append(labelling)
        if len(held) == CHUNK:
            yield np.array(held)
            held = []
    if held:
        yield np.array(held)
