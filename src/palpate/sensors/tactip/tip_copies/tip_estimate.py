"""Forward model of a TacTip's presses for `estimators.unit_fit`: pin motions, known forces, and positions.

Model errors of neighboring pins are correlated, so the pins of a patch count as one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from palpate.core import Float, Int, Progress, ndarray
from palpate.estimators.lattice.ring_layout import ring_of
from palpate.estimators.unit_fit import (
    Block,
    KnownRow,
    Layout,
    State,
    covariance_with,
    most_probable,
    posterior,
    untold_terms,
)
from palpate.mechanics.axisymmetric.tip_table import ratio_range, tip_between
from palpate.sensors.tactip.posed_tip import (
    InnerSkin,
    PinRoots,
    PinView,
    TipOptics,
    pin_roots,
    plate_motion,
)
from palpate.sensors.tactip.tip_copies.plate_presses import PlatePress
from palpate.sensors.tactip.tip_copies.tip_copy import (
    COPY_TERMS,
    STATED_MM,
    TermCovariance,
    TermVector,
    TipCopy,
    design_force_n,
)

OWN = 5  # unknowns of a press: depth [mm], tilt from the usual (x, y) [rad], shift (x, y) [px]
OWN_SD = np.array([np.inf, 0.006, 0.006, 0.3, 0.3])
"""Standard deviations of these from press to press. Assumed."""
OWN_STEP = np.array([2e-3, 1e-3, 1e-3])  # the shift's derivative is exact
TERM_STEP = np.array([1e-3, 5e-3, 5e-3, 5e-2, 2e-3, 1e-3, 1e-2, 1e-2, 1e-3, 1e-3])
PIN_PX, MIN_PIN_PX = 0.1, 0.03  # initial and minimum standard deviation of a pin's coordinate
PATCH = 6.0  # number of correlated pins
MODEL_SHARE = 0.003  # relative model error of a force
POSITION_MM = 0.03
ZERO_MM = 20.0  # prior standard deviation of a stage's zero
AXIS_MM = 0.08  # effect of misplaced pins on the camera's axis
MIN_DEPTH_MM = 0.05
ROUNDS, SETTLED, STIFFEST = 40, 1e-4, 1e6  # see `most_probable`
OUTLIER = 6.0  # outlier limit in robust standard deviations


@dataclass(frozen=True)
class PlateReading:
    """Reading of one press on a flat rigid plate.

    Attributes:
        turn_rad: Rotation of the contact about the dome's centre (x, y).
        force_share: Standard deviation of the force's logarithm.
        off_px: Rms difference of pins from the unit's.
        motion_px: Rms motion of the pins.
        shift_px: Shift of the whole field that the press does not explain.
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
    """Stage position at first touch of one approach [mm], and its standard deviation."""

    approach: int
    zero_mm: float
    sd_mm: float


@dataclass(frozen=True)
class HelpfulPress:
    """A further press, the term it would improve most, and the ratio of that term's standard deviations.

    Attributes:
        press: `deeper`, `shallower`, `inclined` by 2 degrees, or `stage-position` with each press.
        force_n: Force of the press [N]; None for a position.
    """

    press: str
    force_n: float | None
    term: str
    ratio: float


@dataclass(frozen=True, eq=False)
class TipCopyFit:
    """A unit after its presses.

    Attributes:
        untold: Terms whose variance fell by less than a fifth.
        zeros: Zeros of stages, for approaches with positions.
        forces_off: Rms of known forces' residuals in standard deviations.
        helpful: Further presses, the most informative first.
    """

    copy: TipCopy
    presses: tuple[PlateReading, ...]
    untold: tuple[str, ...]
    zeros: tuple[StageZero, ...]
    forces_off: float
    helpful: tuple[HelpfulPress, ...] = ()


@lru_cache(maxsize=64)
def _skin(log_ratio: float) -> InnerSkin:
    tip = tip_between(log_ratio)
    return InnerSkin.of(tip.press, tip.radius_m)


class TipEstimate:
    """A TacTip's presses as a `UnitModel`."""

    kink = math.inf

    def __init__(self, known: TipCopy, presses: Sequence[PlatePress]) -> None:
        self._known, self._presses = known, presses
        n = self._n = len(presses)
        t = self._t = len(COPY_TERMS)
        self._pins = max(len(one.rest_px) for one in presses)
        self._at = np.zeros((n, self._pins, 2))  # pins at rest over the field's edge
        self._moved = np.full((n, self._pins, 2), np.nan)  # motion [px]
        self._edge_px = np.empty(n)
        self._patch = np.zeros((n, self._pins), int)
        for i, one in enumerate(presses):
            count = len(one.rest_px)
            middle = np.median(one.rest_px, axis=0)
            ring = ring_of(one.cells)
            self._edge_px[i] = np.hypot(*(one.rest_px[ring == ring.max()] - middle).T).mean()
            self._at[i, :count] = (one.rest_px - middle) / self._edge_px[i]
            self._moved[i, :count] = one.moved_px - one.rest_px
            self._patch[i, :count] = _patches(one.cells)
        self._last: tuple[bytes, tuple[InnerSkin, PinView, PinRoots]] | None = None
        self._approaches = sorted({p.approach for p in presses if p.position_m is not None})
        self._pin_px = PIN_PX
        self._depths = t + OWN * np.arange(n)
        self.layout = Layout(t, OWN, n, len(self._approaches))
        size, self._zeros = self.layout.size, t + OWN * n
        self.mean = np.zeros(size)
        self.mean[:t] = known.terms
        spread = np.concatenate([np.ones(t), np.tile(OWN_SD, n), np.full(len(self._approaches), ZERO_MM)])
        self.precision = np.diag(1 / spread**2)
        self.precision[:t, :t] = np.linalg.inv(known.covariance)
        self._low, self._high = np.full(size, -np.inf), np.full(size, np.inf)
        self._low[1], self._high[1] = (math.log(one) for one in ratio_range())
        self._low[2], self._low[3] = 0.0, 1e3 * known.spec.table.radius_m + 1
        self._low[self._depths], self._high[self._depths] = MIN_DEPTH_MM, 8.0

    def settled(self, progress: Progress) -> State:
        """Most probable state; outlier pins are dropped once and the rest reweighted."""
        state = self._solved(self._start(), progress)
        size = np.sqrt(np.sum(self._off(state) ** 2, axis=2))
        usual = np.nanmedian(size, axis=1, keepdims=True) / 1.18
        stray = size > OUTLIER * np.maximum(usual, PIN_PX)
        self._moved[stray] = np.nan
        self._pin_px = max(math.sqrt(float(np.nanmean(self._off(state) ** 2))), MIN_PIN_PX)
        return self._solved(state, progress)

    def _solved(self, start: State, progress: Progress) -> State:
        return most_probable(
            self, self.inside(start), progress, rounds=ROUNDS, settled=SETTLED, stiffest=STIFFEST
        )

    def inside(self, state: State) -> State:
        return np.clip(state, self._low, self._high)

    def _start(self) -> State:
        """Depths from the pins' motion, other unknowns at 0."""
        state = self.mean.copy()
        depths = np.array([0.5, 1.0, 1.8, 2.8, 3.8, 4.8])
        off = []
        for depth in depths:
            state[self._depths] = depth
            off.append(np.nansum(self._off(state) ** 2, axis=(1, 2)))
        state[self._depths] = depths[np.argmin(off, axis=0)]
        for k, approach in enumerate(self._approaches):
            zero = [
                1e3 * one.position_m - depth
                for one, depth in zip(self._presses, state[self._depths], strict=True)
                if one.position_m is not None and one.approach == approach
            ]
            self.mean[self._zeros + k] = state[self._zeros + k] = np.median(zero)
        return state

    def _off(self, state: State) -> Float[ndarray, "n p 2"]:
        return np.asarray(self._motion(state[: self._t], self.layout.own_of(state)) - self._moved)

    def _motion(self, terms: TermVector, own: Float[ndarray, "n o"]) -> Float[ndarray, "n p 2"]:
        skin, view, pins = self._pins_of(terms)
        seen = plate_motion(skin, view, pins, own[:, 0], own[:, 1:3] + terms[8:10])
        return np.asarray(self._edge_px[:, None, None] * seen + own[:, None, 3:5])

    def _pins_of(self, terms: TermVector) -> tuple[InnerSkin, PinView, PinRoots]:
        """The tip and its untouched pins (cached)."""
        key = terms[1:8].tobytes()
        if self._last is None or self._last[0] != key:
            skin, optics = _skin(float(terms[1])), TipOptics(*terms[2:6].tolist())
            view = PinView.of(skin, optics, self._known.spec.camera.gel_index)
            pins = pin_roots(skin, view, optics.lever_mm, self._at, terms[6:8])
            self._last = key, (skin, view, pins)
        return self._last[1]

    def residuals(self, state: State) -> Iterator[tuple[Float[ndarray, " r"], float]]:
        for one in self._off(state):
            yield -np.nan_to_num(one).ravel(), self._row_px

    @property
    def _row_px(self) -> float:
        """Standard deviation of a pin's coordinate when a patch counts as one [px]."""
        return self._pin_px * math.sqrt(PATCH)

    def known(self, state: State) -> list[KnownRow]:
        terms, own, rows = state[: self._t], self.layout.own_of(state), []
        for i, one in enumerate(self._presses):
            depth = float(own[i, 0])
            if one.force_n is not None:
                J, off = (
                    self.force_slopes(terms, depth, i),
                    math.log(one.force_n) - self.log_force(terms, depth),
                )
                rows.append(KnownRow(J, off, 1 / self._force_sd(one) ** 2, i, True))
            if one.position_m is not None:
                J, zero = np.zeros(self.layout.size), self._zeros + self._approaches.index(one.approach)
                J[[self._depths[i], zero]] = 1.0
                off = 1e3 * one.position_m - depth - float(state[zero])
                rows.append(KnownRow(J, off, 1 / POSITION_MM**2, i, False))
        return rows

    @staticmethod
    def _force_sd(one: PlatePress) -> float:
        assert one.force_n is not None
        return math.hypot(one.force_sd_n / one.force_n, MODEL_SHARE)

    def log_force(self, terms: TermVector, depth_mm: float) -> float:
        """Log force at a depth [ln N]; a power law beyond the table."""
        press = tip_between(float(terms[1])).press
        deepest = 1e3 * float(press.approach_m[-1])
        depth = np.clip([depth_mm, STATED_MM, 0.97 * deepest, deepest], MIN_DEPTH_MM, deepest)
        at, stated, before, last = np.log(press.force_at(1e-3 * depth))
        if depth_mm > deepest:
            at += (last - before) / -math.log(0.97) * math.log(depth_mm / deepest)
        return float(at - stated + math.log(design_force_n(self._known.spec, STATED_MM)) + terms[0])

    def blocks(self, state: State) -> Iterator[Block]:
        t, n = self._t, self._n
        terms, own = state[:t], self.layout.own_of(state)
        pins = np.zeros((n, self._pins, 2, t + OWN))
        for k, step in enumerate(TERM_STEP):
            if k:  # the stiffness does not move pins
                there, here = self._ends(terms, k, step)
                change = self._motion(there, own) - self._motion(here, own)
                pins[..., k] = change / (there[k] - here[k])
        for k, step in enumerate(OWN_STEP):
            d = step * (np.arange(OWN) == k)
            pins[..., t + k] = (self._motion(terms, own + d) - self._motion(terms, own - d)) / (2 * step)
        pins[:, :, 0, t + 3] = pins[:, :, 1, t + 4] = 1.0
        pins[~np.isfinite(self._moved)] = 0.0
        for i, (residual, sd) in enumerate(self.residuals(state)):
            J = pins[i].reshape(-1, t + OWN)
            yield Block(self.layout.at(i), J, residual, sd, np.repeat(self._patch[i], 2))

    @staticmethod
    def _ends(terms: TermVector, k: int, step: float) -> tuple[TermVector, TermVector]:
        """Terms a step to either side, with the ratio inside the tables."""
        d = step * (np.arange(len(terms)) == k)
        there, here = terms + d, terms - d
        if k == 1:
            low, high = (math.log(one) for one in ratio_range())
            there[1], here[1] = min(there[1], high), max(here[1], low)
        return there, here

    def force_slopes(self, terms: TermVector, depth_mm: float, i: int) -> State:
        """Derivatives of a press's log force by all unknowns."""
        row = np.zeros(self.layout.size)
        row[0] = 1.0
        there, here = self._ends(terms, 1, TERM_STEP[1])
        row[1] = (self.log_force(there, depth_mm) - self.log_force(here, depth_mm)) / (there[1] - here[1])
        d = OWN_STEP[0]
        row[self._t + OWN * i] = (
            self.log_force(terms, depth_mm + d) - self.log_force(terms, depth_mm - d)
        ) / (2 * d)
        return row

    def found(self, state: State) -> TipCopyFit:
        """Unit and presses of a converged state, with covariances."""
        t, end = self._t, posterior(self, state)
        covariance = end.covariance
        covariance[[6, 7], [6, 7]] += AXIS_MM**2
        self._state, self._normal = state, end.hessian
        copy = replace(self._known, terms=state[:t].copy(), covariance=covariance[:t, :t])
        sd = np.sqrt(np.diag(covariance))
        zeros = tuple(
            StageZero(approach, float(state[k]), float(sd[k]))
            for k, approach in enumerate(self._approaches, self._zeros)
        )
        forces = [one.weight * one.off**2 for one in end.known if one.is_force]
        return TipCopyFit(
            copy,
            tuple(self._reading(state, i, covariance) for i in range(self._n)),
            untold_terms(COPY_TERMS, self._known.covariance, copy.covariance),
            zeros,
            float(np.sqrt(np.mean(forces))) if forces else 0.0,
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
        """Further presses by the expected reduction of their best term's standard deviation."""
        state = self._state
        deepest = float(tip_between(float(state[1])).press.approach_m[-1]) * 1e3
        depths = state[self._depths]
        ways = {
            "deeper": (0.97 * deepest, 0.0),
            "shallower": (0.5 * float(depths.min()), 0.0),
            "inclined": (float(np.median(depths)), math.radians(2)),
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
        t, now = self._t, np.linalg.inv(self._normal)[: self._t, : self._t]
        state = np.concatenate([self._state[:t], [depth_mm, turn_rad, 0.0, 0.0, 0.0]])
        H = posterior(more, state).hessian
        H[:t, :t] -= more.precision[:t, :t]  # the prior counts once
        if turn_rad:
            H[t + 1, t + 1] -= more.precision[t + 1, t + 1]  # an intended tilt is not random
        return self._gain(name, force, covariance_with(now, H))

    def _with_positions(self) -> HelpfulPress:
        size = len(self._normal)
        normal = np.pad(self._normal, (0, 1))
        normal[size, size] = 1 / ZERO_MM**2
        for depth in self._depths.tolist():
            at = [depth, size]
            normal[np.ix_(at, at)] += 1 / POSITION_MM**2
        return self._gain("stage-position", None, np.linalg.inv(normal))

    def _gain(self, name: str, force_n: float | None, covariance: TermCovariance) -> HelpfulPress:
        t = self._t
        now = np.sqrt(np.diag(np.linalg.inv(self._normal))[:t])
        ratio = np.sqrt(np.diag(covariance)[:t]) / now
        best = int(np.argmin(ratio))
        return HelpfulPress(name, force_n, COPY_TERMS[best], float(ratio[best]))


def _patches(cells: Int[ndarray, "p 2"]) -> Int[ndarray, " p"]:
    """Patches of about six pins."""
    low = cells.min(axis=0)
    column, row = ((cells - low) // np.array([3, 2])).T
    return np.asarray(column * 30 + row)
