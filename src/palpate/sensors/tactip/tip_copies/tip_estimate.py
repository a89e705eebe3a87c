"""The most probable copy of a TacTip, by least squares on pins, forces and positions of its presses.

Rows are the pins' motions, the copy's prior, known forces and positions. What the model leaves out moves
neighbouring pins together: pins of a patch count as one, and covariances are those of scores summed over
patches (cluster-robust; K.-Y. Liang and S. L. Zeger, Biometrika 73 (1986) 13,
doi:10.1093/biomet/73.1.13), added to what the residuals of pins give.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares

from palpate.core import Float, Int, Progress, ndarray
from palpate.estimators.lattice.ring_layout import ring_of
from palpate.estimators.unit_fit import untold_terms
from palpate.mechanics.axisymmetric.tip_family import ratio_range, tip_between
from palpate.sensors.tactip.tip_copies.plate_presses import PlatePress
from palpate.sensors.tactip.tip_copies.tip_copy import (
    COPY_TERMS,
    STATED_MM,
    TermCovariance,
    TermVector,
    TipCopy,
    design_force_n,
)
from palpate.sensors.tactip.tip_view import (
    InnerSkin,
    PinRoots,
    PinView,
    TipOptics,
    pin_roots,
    plate_motion,
)

OWN = 5  # unknowns of a press: depth [mm], turn of its seat beside the usual, x and y [rad], shift [px]
OWN_SD = np.array([np.inf, 0.006, 0.006, 0.3, 0.3])
"""Of the same from press to press; the shift is of the tip's seat between two frames. Assumed."""
OWN_STEP = np.array([2e-3, 1e-3, 1e-3])  # a shift is told without one
TERM_STEP = np.array([1e-3, 5e-3, 5e-3, 5e-2, 2e-3, 1e-3, 1e-2, 1e-2, 1e-3, 1e-3])
PIN_PX, MIN_PIN_PX = 0.1, 0.03  # of a pin's coordinate, until its residuals are seen, and at best
PATCH = 6.0  # pins that err together
MODEL_SHARE = 0.003  # of a force, by what the model leaves out
POSITION_MM = 0.03
ZERO_MM = 20.0  # to which the zero of a stage is known
AXIS_MM = 0.08  # by which pins beside their lattice move the middle that the camera's axis is told from
MIN_DEPTH_MM = 0.05
ROUNDS = 40
OUTLIER = 6.0  # standard deviations by their median, from which a pin is left out

Rows = Float[ndarray, " r"]
State = Float[ndarray, " u"]


@dataclass(frozen=True)
class PlateReading:
    """What one press on a flat rigid plate tells.

    Attributes:
        depth_mm, force_n: of the press.
        turn_rad: of the contact about the dome's centre, x and y.
        depth_sd_mm: standard deviation.
        force_share: standard deviation of the force's logarithm.
        off_px: root mean square of what pins differ from the copy's.
        motion_px: of the pins' motion.
        shift_px: of the whole field beside what the press explains.
    """

    depth_mm: float
    force_n: float
    turn_rad: tuple[float, float]
    depth_sd_mm: float
    force_share: float
    off_px: float
    motion_px: float
    shift_px: tuple[float, float]


@dataclass(frozen=True)
class StageZero:
    """Where a stage stood when the apex touched, in one approach [mm], and its standard deviation."""

    approach: int
    zero_mm: float
    sd_mm: float


@dataclass(frozen=True)
class HelpfulPress:
    """A further press, the term that it would tell best, and that term's spread then over now."""

    press: str
    term: str
    ratio: float


@dataclass(frozen=True, eq=False)
class TipCopyFit:
    """A copy after its presses.

    Attributes:
        copy: as known now.
        presses: what each told.
        untold: terms of which the presses told less than a fifth of what was known before.
        zeros: of stages, in approaches with positions.
        forces_off: root mean square of known forces' residuals over their standard deviations.
        helpful: further presses, the most helpful first.
    """

    copy: TipCopy
    presses: tuple[PlateReading, ...]
    untold: tuple[str, ...]
    zeros: tuple[StageZero, ...]
    forces_off: float
    helpful: tuple[HelpfulPress, ...] = ()


def _weight(pin_px: float) -> float:
    """Weight of a pin's coordinate, where those of a patch count as one [1/px]."""
    return 1 / (pin_px * math.sqrt(PATCH))


@lru_cache(maxsize=64)
def _skin(log_ratio: float) -> InnerSkin:
    tip = tip_between(log_ratio)
    return InnerSkin.of(tip.press, tip.radius_m)


class TipEstimate:
    """The rows of the least squares, for one set of presses."""

    def __init__(self, known: TipCopy, presses: Sequence[PlatePress]) -> None:
        self._known, self._presses = known, presses
        self._n, self._t = len(presses), len(COPY_TERMS)
        self._pins = max(len(one.rest_px) for one in presses)
        self._prior = np.linalg.cholesky(np.linalg.inv(known.covariance)).T
        self._at = np.zeros((self._n, self._pins, 2))  # pins at rest from their field's middle, in its edges
        self._moved = np.full((self._n, self._pins, 2), np.nan)  # by so many px
        self._edge_px = np.empty(self._n)
        self._patch = np.zeros((self._n, self._pins), int)
        for i, one in enumerate(presses):
            count = len(one.rest_px)
            middle = np.median(one.rest_px, axis=0)
            ring = ring_of(one.cells)
            self._edge_px[i] = np.hypot(*(one.rest_px[ring == ring.max()] - middle).T).mean()
            self._at[i, :count] = (one.rest_px - middle) / self._edge_px[i]
            self._moved[i, :count] = one.moved_px - one.rest_px
            self._patch[i, :count] = _patches(one.cells) + 1000 * i
        self._last: tuple[bytes, tuple[InnerSkin, PinView, PinRoots]] | None = None
        self._approaches = sorted({p.approach for p in presses if p.position_m is not None})
        self._weight = _weight(PIN_PX)
        self._size = self._t + OWN * self._n + len(self._approaches)

    def settled(self, progress: Progress) -> State:
        """The most probable state; once, pins far off are left out and all weighed by what is left."""
        start = self._start()
        state = self._solved(start, progress)
        off = self._off(state)
        size = np.sqrt(np.sum(off**2, axis=2))
        usual = np.nanmedian(size, axis=1, keepdims=True) / 1.18
        stray = size > OUTLIER * np.maximum(usual, PIN_PX)
        self._moved[stray] = np.nan
        left = math.sqrt(float(np.nanmean(self._off(state) ** 2)))
        self._weight = _weight(max(left, MIN_PIN_PX))
        return self._solved(state, progress)

    def _solved(self, start: State, progress: Progress) -> State:
        low, high = np.full(self._size, -np.inf), np.full(self._size, np.inf)
        low[1], high[1] = (math.log(one) for one in ratio_range())
        low[2], low[3] = 0.0, 1e3 * self._known.spec.table.radius_m + 1
        depths = self._t + OWN * np.arange(self._n)
        low[depths], high[depths] = MIN_DEPTH_MM, 8.0
        rounds = 0

        def slopes(state: State) -> Float[ndarray, "r u"]:
            nonlocal rounds
            rounds += 1
            progress("rounds", min(rounds, ROUNDS), ROUNDS)
            return self._slopes(state)

        inside = np.clip(start, low + 1e-6, high - 1e-6)
        scale = np.ones(self._size)
        scale[: self._t] = np.sqrt(np.diag(self._known.covariance))
        scale[self._t : self._t + OWN * self._n] = np.tile([0.3, 0.01, 0.01, 0.3, 0.3], self._n)
        found = least_squares(
            self._rows, inside, jac=slopes, bounds=(low, high), x_scale=scale, max_nfev=ROUNDS, ftol=1e-7
        )
        return np.asarray(found.x)

    def _start(self) -> State:
        """Depths by the pins' motion, or by known forces, seats and shifts at nothing."""
        state = np.zeros(self._size)
        state[: self._t] = self._known.terms
        depths = np.array([0.5, 1.0, 1.8, 2.8, 3.8, 4.8])
        off = []
        for depth in depths:
            state[self._t + OWN * np.arange(self._n)] = depth
            off.append(np.nansum(self._off(state) ** 2, axis=(1, 2)))
        state[self._t + OWN * np.arange(self._n)] = depths[np.argmin(off, axis=0)]
        for k, approach in enumerate(self._approaches):
            zero = [
                1e3 * one.position_m - state[self._t + OWN * i]
                for i, one in enumerate(self._presses)
                if one.position_m is not None and one.approach == approach
            ]
            state[self._t + OWN * self._n + k] = np.median(zero)
        self._zero_start = state[self._t + OWN * self._n :].copy()
        return state

    def _off(self, state: State) -> Float[ndarray, "n p 2"]:
        """What pins differ from the copy's [px]; NaN where one is not seen."""
        terms, own = state[: self._t], state[self._t : self._t + OWN * self._n].reshape(self._n, OWN)
        return np.asarray(self._motion(terms, own) - self._moved)

    def _motion(self, terms: TermVector, own: Float[ndarray, "n o"]) -> Float[ndarray, "n p 2"]:
        skin, view, pins = self._pins_of(terms)
        seen = plate_motion(skin, view, pins, own[:, 0], own[:, 1:3] + terms[8:10])
        return np.asarray(self._edge_px[:, None, None] * seen + own[:, None, 3:5])

    def _pins_of(self, terms: TermVector) -> tuple[InnerSkin, PinView, PinRoots]:
        """The tip and the untouched pins on it, which most calls share."""
        key = terms[1:8].tobytes()
        if self._last is None or self._last[0] != key:
            skin, optics = _skin(float(terms[1])), TipOptics(*terms[2:6].tolist())
            view = PinView.of(skin, optics, self._known.spec.camera.gel_index)
            pins = pin_roots(skin, view, optics.lever_mm, self._at, terms[6:8])
            self._last = key, (skin, view, pins)
        return self._last[1]

    def _rows(self, state: State) -> Rows:
        pins = self._weight * np.nan_to_num(self._off(state)).ravel()
        return np.concatenate([pins, self._sure_rows(state)])

    def _sure_rows(self, state: State) -> Rows:
        """The prior's rows, those of presses' seats and shifts, known forces, positions and zeros."""
        terms, own = state[: self._t], state[self._t : self._t + OWN * self._n].reshape(self._n, OWN)
        rows = [self._prior @ (terms - self._known.terms), (own / OWN_SD)[:, 1:].ravel()]
        force = [
            (math.log(one.force_n) - self.log_force(terms, own[i, 0])) / self._force_sd(one)
            for i, one in enumerate(self._presses)
            if one.force_n is not None
        ]
        zeros = state[self._t + OWN * self._n :]
        place = [
            (1e3 * one.position_m - own[i, 0] - zeros[self._approaches.index(one.approach)]) / POSITION_MM
            for i, one in enumerate(self._presses)
            if one.position_m is not None
        ]
        return np.concatenate([*rows, force, place, (zeros - self._zero_start) / ZERO_MM])

    @staticmethod
    def _force_sd(one: PlatePress) -> float:
        assert one.force_n is not None
        return math.hypot(one.force_sd_n / one.force_n, MODEL_SHARE)

    def log_force(self, terms: TermVector, depth_mm: float) -> float:
        """Logarithm of the force at a depth [ln N]; beyond the table along its last power."""
        press = tip_between(float(terms[1])).press
        deepest = 1e3 * float(press.approach_m[-1])
        depth = np.clip([depth_mm, STATED_MM, 0.97 * deepest, deepest], MIN_DEPTH_MM, deepest)
        at, stated, before, last = np.log(press.force_at(1e-3 * depth))
        if depth_mm > deepest:
            at += (last - before) / -math.log(0.97) * math.log(depth_mm / deepest)
        return float(at - stated + math.log(design_force_n(self._known.spec, STATED_MM)) + terms[0])

    def _slopes(self, state: State) -> Float[ndarray, "r u"]:
        """Slopes of all rows over all unknowns; a press's own move its own pins alone."""
        t, n = self._t, self._n
        terms, own = state[:t], state[t : t + OWN * n].reshape(n, OWN)
        pins = np.zeros((n, self._pins * 2, self._size))
        seen = np.isfinite(self._moved).reshape(n, -1)
        for k, step in enumerate(TERM_STEP):
            if k:  # the stiffness moves no pin
                there, here = self._ends(terms, k, step)
                change = (self._motion(there, own) - self._motion(here, own)) / (there[k] - here[k])
                pins[:, :, k] = change.reshape(n, -1)
        pins[:, 0::2, [t + OWN * i + 3 for i in range(n)]] = np.eye(n)[:, None, :]  # a shift moves all
        pins[:, 1::2, [t + OWN * i + 4 for i in range(n)]] = np.eye(n)[:, None, :]
        for k, step in enumerate(OWN_STEP):
            d = step * (np.arange(OWN) == k)
            change = (self._motion(terms, own + d) - self._motion(terms, own - d)) / (2 * step)
            for i in range(n):
                pins[i, :, t + OWN * i + k] = change[i].ravel()
        J = (self._weight * pins * seen[:, :, None]).reshape(-1, self._size)
        return np.concatenate([J, self._sure_slopes(state)])

    @staticmethod
    def _ends(terms: TermVector, k: int, step: float) -> tuple[TermVector, TermVector]:
        """Terms a step to either side; the ratio stays between the tables."""
        d = step * (np.arange(len(terms)) == k)
        there, here = terms + d, terms - d
        if k == 1:
            low, high = (math.log(one) for one in ratio_range())
            there[1], here[1] = min(there[1], high), max(here[1], low)
        return there, here

    def _sure_slopes(self, state: State) -> Float[ndarray, "s u"]:
        t, n = self._t, self._n
        terms, own = state[:t], state[t : t + OWN * n].reshape(n, OWN)
        blocks = [np.zeros((t, self._size)), np.zeros((n * (OWN - 1), self._size))]
        blocks[0][:, :t] = self._prior
        for i in range(n):
            for k in range(1, OWN):
                blocks[1][i * (OWN - 1) + k - 1, t + OWN * i + k] = 1 / OWN_SD[k]
        rows = []
        for i, one in enumerate(self._presses):
            if one.force_n is not None:
                rows.append(-self.force_slopes(terms, own[i, 0], i) / self._force_sd(one))
        for i, one in enumerate(self._presses):
            if one.position_m is not None:
                row = np.zeros(self._size)
                row[t + OWN * i] = -1 / POSITION_MM
                row[t + OWN * n + self._approaches.index(one.approach)] = -1 / POSITION_MM
                rows.append(row)
        zeros = np.zeros((len(self._approaches), self._size))
        zeros[:, t + OWN * n :] = np.eye(len(self._approaches)) / ZERO_MM
        return np.concatenate([*blocks, np.reshape(rows, (-1, self._size)), zeros])

    def force_slopes(self, terms: TermVector, depth_mm: float, i: int) -> State:
        """Slopes of the logarithm of a press's force over all unknowns."""
        row = np.zeros(self._size)
        row[0] = 1.0
        there, here = self._ends(terms, 1, TERM_STEP[1])
        row[1] = (self.log_force(there, depth_mm) - self.log_force(here, depth_mm)) / (there[1] - here[1])
        d = OWN_STEP[0]
        row[self._t + OWN * i] = (
            self.log_force(terms, depth_mm + d) - self.log_force(terms, depth_mm - d)
        ) / (2 * d)
        return row

    def found(self, state: State) -> TipCopyFit:
        """The copy and presses of a settled state, with their covariances."""
        J, t, n = self._slopes(state), self._t, self._n
        count = n * self._pins * 2
        bread = np.linalg.inv(J.T @ J)
        residual = self._weight * np.nan_to_num(self._off(state)).ravel()
        patch = np.repeat(self._patch.ravel(), 2)
        order, patch = np.unique(patch, return_inverse=True)
        scores = np.zeros((len(order), self._size))
        np.add.at(scores, patch, J[:count] * residual[:, None])
        covariance = bread + bread @ (scores.T @ scores) @ bread
        covariance[[6, 7], [6, 7]] += AXIS_MM**2
        self._state, self._normal, self._covariance = state, J.T @ J, covariance
        copy = replace(self._known, terms=state[:t].copy(), covariance=covariance[:t, :t])
        zeros = tuple(
            StageZero(
                approach,
                float(state[t + OWN * n + k]),
                float(np.sqrt(covariance[t + OWN * n + k, t + OWN * n + k])),
            )
            for k, approach in enumerate(self._approaches)
        )
        forces = self._sure_rows(state)[t + n * (OWN - 1) :][
            : sum(one.force_n is not None for one in self._presses)
        ]
        return TipCopyFit(
            copy,
            tuple(self._reading(state, i, covariance) for i in range(n)),
            untold_terms(COPY_TERMS, self._known.covariance, copy.covariance),
            zeros,
            float(np.sqrt(np.mean(forces**2))) if len(forces) else 0.0,
        )

    def _reading(self, state: State, i: int, covariance: ndarray) -> PlateReading:
        t = self._t
        own = state[t + OWN * i : t + OWN * (i + 1)]
        towards = self.force_slopes(state[:t], own[0], i)
        off, motion = self._off(state)[i], self._moved[i]
        return PlateReading(
            float(own[0]),
            math.exp(self.log_force(state[:t], float(own[0]))),
            (float(own[1] + state[8]), float(own[2] + state[9])),
            float(np.sqrt(covariance[t + OWN * i, t + OWN * i])),
            math.hypot(math.sqrt(towards @ covariance @ towards), MODEL_SHARE),
            float(np.sqrt(np.nanmean(np.sum(off**2, axis=1)))),
            float(np.sqrt(np.nanmean(np.sum(motion**2, axis=1)))),
            (float(own[3]), float(own[4])),
        )

    def helpful(self) -> tuple[HelpfulPress, ...]:
        """Further presses, and the term whose spread each would make fall most, by the rows it would have."""
        state, t, n = self._state, self._t, self._n
        deepest = float(tip_between(float(state[1])).press.approach_m[-1]) * 1e3
        depths = state[t + OWN * np.arange(n)]
        ways = {
            "deeper": (0.97 * deepest, 0.0),
            "shallower": (0.5 * float(depths.min()), 0.0),
            "plate seated 2 degrees aside": (float(np.median(depths)), math.radians(2)),
        }
        if deepest < 1.1 * depths.max():
            del ways["deeper"]
        told = [self._with_press(name, *way) for name, way in ways.items()]
        if not self._approaches:
            told.append(self._with_positions())
        return tuple(sorted((one for one in told if one.ratio < 0.9), key=lambda one: one.ratio))

    def _with_press(self, name: str, depth_mm: float, turn_rad: float) -> HelpfulPress:
        first = self._presses[0]
        force = math.exp(self.log_force(self._state[: self._t], depth_mm))
        more = TipEstimate(
            self._known, [replace(first, moved_px=first.rest_px, force_n=force, position_m=None)]
        )
        own = np.array([depth_mm, turn_rad, 0.0, 0.0, 0.0])
        state = np.concatenate([self._state[: self._t], own])
        J = more._slopes(state)
        J = np.delete(J, slice(more._pins * 2, more._pins * 2 + self._t), axis=0)  # the prior counts once
        if turn_rad:
            J[more._pins * 2, self._t + 1] *= 0.0  # a lean that was meant is no chance
        t = self._t
        size = len(self._normal)
        normal = np.zeros((size + OWN, size + OWN))
        normal[:size, :size] = self._normal
        at = np.concatenate([np.arange(t), size + np.arange(OWN)])
        normal[np.ix_(at, at)] += J.T @ J
        return self._gain(f"{name}, {force:.2g} N", np.linalg.inv(normal))

    def _with_positions(self) -> HelpfulPress:
        """The stage's position with each of these presses, of one approach."""
        t, n, size = self._t, self._n, len(self._normal)
        normal = np.zeros((size + 1, size + 1))
        normal[:size, :size] = self._normal
        normal[size, size] = 1 / ZERO_MM**2
        for i in range(n):
            at = [t + OWN * i, size]
            normal[np.ix_(at, at)] += 1 / POSITION_MM**2
        return self._gain("the stage's position with each press", np.linalg.inv(normal))

    def _gain(self, name: str, covariance: TermCovariance) -> HelpfulPress:
        t = self._t
        now = np.sqrt(np.diag(np.linalg.inv(self._normal))[:t])
        ratio = np.sqrt(np.diag(covariance)[:t]) / now
        best = int(np.argmin(ratio))
        return HelpfulPress(name, COPY_TERMS[best], float(ratio[best]))


def _patches(cells: Int[ndarray, "p 2"]) -> Int[ndarray, " p"]:
    """Patches of the field, some six pins each."""
    low = cells.min(axis=0)
    column, row = ((cells - low) // np.array([3, 2])).T
    return np.asarray(column * 30 + row)
