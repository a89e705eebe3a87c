"""Rows of the least squares that finds a copy of the palm, and their most probable solution.

Gauss and Newton's steps, damped as by Levenberg and Marquardt; the copy's prior, what one press differs by,
and known forces and places are further rows. Pixels weigh less the more they are off, so that dirt and
reflections that the untouched frame did not show move little (pseudo-Huber; P. Charbonnier et al., IEEE
Trans. Image Processing 6 (1997) 298, doi:10.1109/83.551699). Pixels near each other err together:
covariances are those of scores summed over blocks of pixels (cluster-robust; K.-Y. Liang and S. L. Zeger,
Biometrika 73 (1986) 13, doi:10.1093/biomet/73.1.13), added to what the assumed error of pixels gives: with
few blocks, residuals that many unknowns have been fitted to are too small.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from palpate.core import Float, Progress, ndarray
from palpate.estimators.known_terms import untold_terms
from palpate.sensors.palm.copies.copy_force import deepest_m, log_force
from palpate.sensors.palm.copies.copy_slopes import picture_slopes, still_near
from palpate.sensors.palm.copies.held_out import KnownRow, standardised, widening_of
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

STIFFEST = 20.0  # damping from which no step is tried: what is left is the roughness of sampled pixels
ROBUST = 3.0  # standard deviations of a pixel from which it begins to weigh less
ROUNDS, SETTLED = 25, 0.02  # of the cost, in which 1 is a standard deviation
MIN_DEPTH_M = 0.15e-3
MAX_THICKER = 0.055  # logarithm of a copy's thickness over the design's, and
MAX_THICKER_HERE = 0.02  # of a press's over the copy's
REACH = 0.78  # of the membrane's radius, within which a press is looked for


class CopyState(NamedTuple):
    """Terms, and the unknowns of each press."""

    terms: Terms
    local: Float[ndarray, "p 8"]


class CopyEstimate:
    """The rows of the least squares, for one set of pictures."""

    def __init__(
        self, known: PalmCopy, seen: Sequence[SeenPress], backdrop: Backdrop | None = None,
        kept: Sequence[Kept] | None = None,
    ) -> None:  # fmt: skip
        self._known, self._seen, self._backdrop = known, seen, backdrop
        self._masks = [None] * len(seen) if kept is None else kept
        self._pixels = [one.kept(mask) for one, mask in zip(seen, self._masks, strict=True)]
        self._prior = np.linalg.inv(known.covariance)
        self._middle = np.array([[0.0, 0.0, 0.0, one.exposure, 0.0, 0.0, 0.0, 0.0] for one in seen])
        self._own = np.array([0.0, 0.0, 0.0, *(1 / one**2 for one in known.local_spreads)])
        self._size = len(TERMS) + len(LOCAL) * len(seen)
        self._weight = (PIXEL_SD * BLOCK_PX) ** 2  # of squared pixels: those of a block tell as much as one
        self._kink = ROBUST * PIXEL_SD
        self._slopes_at: dict[int, tuple[tuple[Terms, Local], ndarray]] = {}
        self._left: dict[int, list[tuple[bytes, Pixels]]] = {}

    def settled(self, state: CopyState, progress: Progress, rounds: int = ROUNDS) -> CopyState:
        """The most probable state near a first one."""
        damping, cost = 1e-3, self.cost(state)
        for i in range(rounds):
            progress("rounds", i, rounds)
            H, g = self._normal(state)
            while damping < STIFFEST:
                step = np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
                after = self._moved(state, step)
                new = self.cost(after)
                if new < cost:
                    break
                damping *= 10.0
            else:
                return state
            state, fallen, cost, damping = after, cost - new, new, max(damping / 10.0, 1e-6)
            if fallen < SETTLED * (1.0 + cost / 100.0):
                return state
        return state

    def fit(self, state: CopyState) -> CopyFit:
        """The copy and presses of a settled state, with their covariances."""
        H, meat = np.zeros((self._size, self._size)), np.zeros((self._size, self._size))
        off = []
        for at, J, residual, weight, block in self._pixel_rows(state):
            H[np.ix_(at, at)] += (J.T * weight) @ J / self._weight
            scores = [np.bincount(block, J[:, k] * weight * residual) for k in range(len(at))]
            summed = np.stack(scores) / self._weight
            meat[np.ix_(at, at)] += summed @ summed.T
            off.append(math.sqrt(float(residual @ residual) / max(int(np.count_nonzero(residual)), 1)))
        self._add_own(H)
        rows = list(self._sure_rows(state))
        for one in rows:
            H += one.weight * np.outer(one.slopes, one.slopes)
        n = len(TERMS)
        bread = np.linalg.inv(H)
        covariance = bread + bread @ meat @ bread  # of pixels' own errors, and of those that blocks share
        depths = [n + len(LOCAL) * i + 2 for i in range(len(self._seen))]
        errors = standardised(H, meat, rows, depths)
        held = {one.press for one in rows if one.is_force}
        widening = widening_of(errors, len(held)) if held else self._known.widening
        copy = replace(self._known, terms=state.terms, covariance=covariance[:n, :n], widening=widening)
        presses = tuple(self._found(state, i, covariance, off[i]) for i in range(len(self._seen)))
        untold = untold_terms(TERMS, self._known.covariance, copy.covariance)
        maps = {one for names in RESIDUAL_MODES.values() for one in names}  # many, each of little account
        return CopyFit(copy, presses, tuple(one for one in untold if one not in maps))

    def _found(self, state: CopyState, i: int, covariance: ndarray, off: float) -> PressFound:
        at, local, wider = len(TERMS) + len(LOCAL) * i, state.local[i], self._known.widening
        force, slopes = log_force(self._copy(state), local)
        towards = self._spread_out(i, slopes)
        x_sd, y_sd, depth_sd = np.sqrt(np.diag(covariance)[at : at + 3])
        depth = math.exp(local[2])
        share = math.sqrt(towards @ covariance @ towards)
        return PressFound(
            float(local[0]),
            float(local[1]),
            depth,
            math.exp(force),
            wider.place * float(x_sd),
            wider.place * float(y_sd),
            wider.depth * float(depth_sd) * depth,
            wider.force * share,
            off,
        )

    def _normal(self, state: CopyState) -> tuple[ndarray, ndarray]:
        """Normal matrix, and the cost's descent."""
        H, g, n = np.zeros((self._size, self._size)), np.zeros(self._size), len(TERMS)
        for at, J, residual, weight, _ in self._pixel_rows(state):
            H[np.ix_(at, at)] += (J.T * weight) @ J / self._weight
            g[at] += J.T @ (weight * residual) / self._weight
        for one in self._sure_rows(state):
            H += one.weight * np.outer(one.slopes, one.slopes)
            g += one.weight * one.slopes * one.off
        self._add_own(H)
        g[:n] += self._prior @ (self._known.terms - state.terms)
        g[n:] -= (self._own * (state.local - self._middle)).ravel()
        return H, g

    def _add_own(self, H: ndarray) -> None:
        n = len(TERMS)
        H[:n, :n] += self._prior
        H[np.arange(n, self._size), np.arange(n, self._size)] += np.tile(self._own, len(self._seen))

    def cost(self, state: CopyState) -> float:
        """What is left of pixels, forces and places, and how far all is from what was known."""
        pixels = 0.0
        for i in range(len(self._seen)):
            left = self._residual(state, i) / self._kink
            pixels += 2 * self._kink**2 * float(np.sum(np.sqrt(1 + left**2) - 1))
        sure = sum(one.weight * one.off**2 for one in self._sure_rows(state))
        away = state.terms - self._known.terms
        own = float(np.sum(self._own * (state.local - self._middle) ** 2))
        return pixels / self._weight + sure + float(away @ self._prior @ away) + own

    def _residual(self, state: CopyState, i: int) -> Pixels:
        key = state.terms.tobytes() + state.local[i].tobytes()
        kept = self._left.setdefault(i, [])
        for at, left in kept:
            if at == key:
                return left
        seen = shown(self._copy(state), state.local[i], self._backdrop, kept=self._masks[i])
        left = self._pixels[i] - seen
        self._left[i] = [*kept[-1:], (key, left)]
        return left

    def _copy(self, state: CopyState) -> PalmCopy:
        return replace(self._known, terms=state.terms)

    def _pixel_rows(self, state: CopyState) -> Iterator[tuple[ndarray, ndarray, Pixels, Pixels, ndarray]]:
        """Rows of each press: its unknowns, slopes of its pixels, what is left, weights and blocks."""
        n, m = len(TERMS), len(LOCAL)
        for i, one in enumerate(self._seen):
            at = np.concatenate([np.arange(n), n + m * i + np.arange(m)])
            residual = self._residual(state, i)
            weight = 1 / np.sqrt(1 + (residual / self._kink) ** 2)
            yield at, self._slopes(state, i), residual, weight, one.block

    def _slopes(self, state: CopyState, i: int) -> Float[ndarray, "n u"]:
        here = state.terms, state.local[i]
        if i not in self._slopes_at or not still_near(self._slopes_at[i][0], here):
            slopes = picture_slopes(self._copy(state), state.local[i], self._backdrop, self._masks[i])
            self._slopes_at[i] = here, slopes
        return self._slopes_at[i][1]

    def _sure_rows(self, state: CopyState) -> Iterator[KnownRow]:
        """Rows of each known force and place."""
        for i, one in enumerate(seen.press for seen in self._seen):
            first = len(TERMS) + len(LOCAL) * i
            for k, at in enumerate(one.place_m or ()):
                J = (np.arange(self._size) == first + k).astype(float)
                yield KnownRow(J, at - float(state.local[i, k]), 1 / one.place_sd_m**2, i, False)
            if one.force_n is not None:
                force, slopes = log_force(self._copy(state), state.local[i])
                J = self._spread_out(i, slopes)
                yield KnownRow(J, math.log(one.force_n) - force, 1 / one.force_share**2, i, True)

    def _spread_out(self, i: int, slopes: ndarray) -> Float[ndarray, " u"]:
        """Slopes over the terms and one press's unknowns, over all."""
        n, m = len(TERMS), len(LOCAL)
        J = np.zeros(self._size)
        J[:n], J[n + m * i : n + m * (i + 1)] = slopes[:n], slopes[n:]
        return J

    def _moved(self, state: CopyState, step: ndarray) -> CopyState:
        n, spec = len(TERMS), self._known.spec
        terms = state.terms + step[:n]
        local = state.local + step[n:].reshape(-1, len(LOCAL))
        size = np.maximum(np.hypot(local[:, 0], local[:, 1]) / (REACH * spec.radius_m), 1.0)
        local[:, :2] /= size[:, None]
        local[:, 2] = np.clip(local[:, 2], math.log(MIN_DEPTH_M), math.log(0.96 * deepest_m(spec)))
        local[:, 5] = np.clip(local[:, 5], -MAX_THICKER_HERE, MAX_THICKER_HERE)
        terms[AT["thickness"]] = np.clip(terms[AT["thickness"]], -MAX_THICKER, MAX_THICKER)
        return CopyState(terms, local)
