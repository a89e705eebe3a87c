"""Forward model of a palm's presses for `estimators.unit_fit`: pixels, known forces, and positions.

Pixels are weighted robustly, against unmodeled dirt and reflections; pixels of a block are correlated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from palpate.core import Float, ndarray
from palpate.estimators.unit_fit import (
    Block,
    KnownRow,
    Layout,
    Posterior,
    State,
    posterior,
    standardised,
    untold_terms,
    widening_of,
)
from palpate.sensors.palm.copies.copy_force import deepest_m, log_force
from palpate.sensors.palm.copies.copy_slopes import picture_slopes, still_near
from palpate.sensors.palm.copies.palm_copy import (
    AT,
    LOCAL,
    PIXEL_SD,
    RESIDUAL_MODES,
    TERMS,
    CopyFit,
    Local,
    PalmCopy,
    PressFound,
    Terms,
)
from palpate.sensors.palm.copies.press_picture import BLOCK_PX, Backdrop, Kept, Pixels, SeenPress, shown

ROBUST = 3.0  # standard deviations from which a pixel's weight decreases
PRESS_SD = PIXEL_SD * BLOCK_PX  # standard deviation of a pixel when a block counts as one
MIN_DEPTH_M = 0.15e-3
MAX_THICKER = 0.055  # limit of the logarithm of a unit's thickness over the design's
MAX_THICKER_HERE = 0.02  # limit of a press's over the unit's
REACH = 0.78  # search radius of a press over the membrane's radius


class CopyEstimate:
    """A palm's presses as a `UnitModel`."""

    kink = ROBUST / BLOCK_PX

    def __init__(
        self, known: PalmCopy, seen: Sequence[SeenPress], backdrop: Backdrop | None = None,
        kept: Sequence[Kept] | None = None,
    ) -> None:  # fmt: skip
        self._known, self._seen, self._backdrop = known, seen, backdrop
        self._masks = [None] * len(seen) if kept is None else kept
        self._pixels = [one.kept(mask) for one, mask in zip(seen, self._masks, strict=True)]
        self.layout = Layout(len(TERMS), len(LOCAL), len(seen))
        own = np.zeros((len(seen), len(LOCAL)))
        own[:, 3] = [one.exposure for one in seen]
        self.mean = joined(known.terms, own)
        self.precision = np.zeros((self.layout.size,) * 2)
        self.precision[: len(TERMS), : len(TERMS)] = np.linalg.inv(known.covariance)
        after = np.arange(len(TERMS), self.layout.size)
        sure = [0.0, 0.0, 0.0, *(1 / one**2 for one in known.local_spreads)]
        self.precision[after, after] = np.tile(sure, len(seen))
        self._slopes_at: dict[int, tuple[tuple[Terms, Local], ndarray]] = {}
        self._left: dict[int, list[tuple[bytes, Pixels]]] = {}

    def residuals(self, state: State) -> Iterator[tuple[Pixels, float]]:
        for i in range(len(self._seen)):
            yield self._residual(state, i), PRESS_SD

    def blocks(self, state: State) -> Iterator[Block]:
        for i, one in enumerate(self._seen):
            at, slopes = self.layout.at(i), self._slopes(state, i)
            yield Block(at, slopes, self._residual(state, i), PRESS_SD, one.block)

    def known(self, state: State) -> list[KnownRow]:
        rows, own = [], self.layout.own_of(state)
        for i, one in enumerate(seen.press for seen in self._seen):
            first = len(TERMS) + len(LOCAL) * i
            for k, at in enumerate(one.place_m or ()):
                J = (np.arange(self.layout.size) == first + k).astype(float)
                rows.append(KnownRow(J, at - float(own[i, k]), 1 / one.place_sd_m**2, i, False))
            if one.force_n is not None:
                force, slopes = log_force(self._copy(state), own[i])
                J = self.layout.row(i, slopes)
                rows.append(KnownRow(J, math.log(one.force_n) - force, 1 / one.force_share**2, i, True))
        return rows

    def inside(self, state: State) -> State:
        state, spec, thick = state.copy(), self._known.spec, AT["thickness"]
        local = self.layout.own_of(state)
        size = np.maximum(np.hypot(local[:, 0], local[:, 1]) / (REACH * spec.radius_m), 1.0)
        local[:, :2] /= size[:, None]
        local[:, 2] = np.clip(local[:, 2], math.log(MIN_DEPTH_M), math.log(0.96 * deepest_m(spec)))
        local[:, 5] = np.clip(local[:, 5], -MAX_THICKER_HERE, MAX_THICKER_HERE)
        state[thick] = np.clip(state[thick], -MAX_THICKER, MAX_THICKER)
        return state

    def fit(self, state: State) -> CopyFit:
        """Return unit and presses of a converged state, with covariances."""
        n, found = len(TERMS), posterior(self, state)
        depths = [n + len(LOCAL) * i + 2 for i in range(len(self._seen))]
        held = {one.press for one in found.known if one.is_force}
        widening = self._known.widening
        if held:
            errors = standardised(found.hessian, found.meat, found.known, depths)
            widening = widening_of(errors, len(held))
        copy = replace(
            self._known, terms=state[:n].copy(), covariance=found.covariance[:n, :n], widening=widening
        )
        presses = tuple(self._found(found, i) for i in range(len(self._seen)))
        untold = untold_terms(TERMS, self._known.covariance, copy.covariance)
        maps = {one for names in RESIDUAL_MODES.values() for one in names}  # many, each of little account
        return CopyFit(copy, presses, tuple(one for one in untold if one not in maps))

    def _found(self, found: Posterior, i: int) -> PressFound:
        at, local = len(TERMS) + len(LOCAL) * i, self.layout.own_of(found.state)[i]
        wider, covariance = self._known.widening, found.covariance
        force, slopes = log_force(self._copy(found.state), local)
        towards, residual = self.layout.row(i, slopes), self._residual(found.state, i)
        x_sd, y_sd, depth_sd = np.sqrt(np.diag(covariance)[at : at + 3])
        depth = math.exp(local[2])
        return PressFound(
            float(local[0]),
            float(local[1]),
            depth,
            math.exp(force),
            wider.place * float(x_sd),
            wider.place * float(y_sd),
            wider.depth * float(depth_sd) * depth,
            wider.force * math.sqrt(towards @ covariance @ towards),
            math.sqrt(float(residual @ residual) / max(int(np.count_nonzero(residual)), 1)),
        )

    def _residual(self, state: State, i: int) -> Pixels:
        local = self.layout.own_of(state)[i]
        key = state[: len(TERMS)].tobytes() + local.tobytes()
        kept = self._left.setdefault(i, [])
        for at, left in kept:
            if at == key:
                return left
        seen = shown(self._copy(state), local, self._backdrop, kept=self._masks[i])
        left = self._pixels[i] - seen
        self._left[i] = [*kept[-1:], (key, left)]
        return left

    def _copy(self, state: State) -> PalmCopy:
        return replace(self._known, terms=state[: len(TERMS)])

    def _slopes(self, state: State, i: int) -> Float[ndarray, "n u"]:
        here = state[: len(TERMS)], self.layout.own_of(state)[i]
        if i not in self._slopes_at or not still_near(self._slopes_at[i][0], here):
            slopes = picture_slopes(self._copy(state), here[1], self._backdrop, self._masks[i])
            self._slopes_at[i] = here, slopes
        return self._slopes_at[i][1]


def joined(terms: Terms, local: Float[ndarray, "p 8"]) -> State:
    """Return the state of terms and press unknowns."""
    return np.concatenate([terms, local.ravel()])
