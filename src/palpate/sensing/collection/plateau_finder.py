"""Steady plateaus in the force of hand presses, from the samples alone, or the reason for their absence.

A plateau is the longest stretch in which force moves and swings within the scale's noise and resolution, or a
small fraction of the force. No-contact samples before and after give zero, noise, and resolution.

A delayed scale needs plateaus longer than its delay, half of which is cut from each end. For a first-order
filter the force is the reading plus lag times its rate; both must be steady. The lag is given or identified
from the decay after presses.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.core import NS_PER_S, Float, ForceSensor, InputError, Wrench, ndarray

Series = Float[ndarray, " n"]

MAX_BINS = 240  # of a press, in which plateaus are looked for
MAX_PRESS_S = 120.0  # of samples kept; a load that stays longer is judged by its end
GRAVE_GAP_S = 0.5  # without a sample, or five periods
MIN_ZERO_SAMPLES = 3
AIR_S = 0.25  # untouched, after which the zero behind a press is known
SETTLE_S = 0.15  # after release, before the zero is read; or so many lags of a slow scale
SETTLE_LAGS = 3.0
NOISES = 6.0  # over the zero: a touch
KEPT_ZEROS_S = 2.0
DYING = 0.25, 0.03  # of a press's force, between which its end tells the scale's lag
CAUGHT_UP_S = 0.2  # of a plateau that is left once a slow scale has caught up
RATE_NOISES = 3.0  # by which a rate may differ from 0 where nothing moves
CAUGHT_UP_LAGS = 3.5  # after which it is within 3 % of the force
MIN_DYING = 4  # samples between them: a quick scale has fewer
MIN_LAG_S = 0.15  # shorter ones cannot be told from how a hand lets go
LAGS = 5  # presses whose lags are kept


@dataclass(frozen=True, slots=True)
class Weighing:
    """Properties of the force sensor or scale that labels presses.

    Attributes:
        delay_s: Time from a force change to its full display [s].
        range_n: Largest measurable force [N].
        lag_s: Filter time constant, 0 for none; None to identify it from presses [s].
    """

    rate_hz: float
    delay_s: float = 0.0
    range_n: float = math.inf
    name: str = "the scale"
    lag_s: float | None = None

    @classmethod
    def by(cls, sensor: ForceSensor, name: str = "the scale", lag_s: float | None = None) -> Weighing:
        """What a force sensor says of itself."""
        delay_s = float(getattr(sensor, "delay_s", 0.0))
        return cls(sensor.rate_hz, delay_s, sensor.range_n[2], name, lag_s)


@dataclass(frozen=True, slots=True)
class PlateauRule:
    """Steadiness that a plateau requires.

    Attributes:
        hold_s: Shortest plateau, unless the scale is slower [s].
        moved: Largest force change over a plateau, relative to the force.
        swing: Largest standard deviation about a line, relative to the force.
        least_n: Smallest force that counts as touch [N].
    """

    hold_s: float = 0.4
    moved: float = 0.03
    swing: float = 0.02
    least_n: float = 0.03

    def shortest_s(self, scale: Weighing) -> float:
        """Shortest plateau of a scale: longer than its delay, and of five samples [s]."""
        return max(self.hold_s, 1.5 * scale.delay_s, 5 / scale.rate_hz)


@dataclass(frozen=True, slots=True, eq=False)
class Plateau:
    """Part of a press with a steady force.

    Attributes:
        begins_ns, ends_ns: Labelable interval on the host clock [ns].
        force_n: Mean force after removal of the zero [N].
        spread_n: Standard deviation about a line [N].
        touched_ns: First contact; None where unknown [ns].
        time_ns, samples_n: Force samples, zero removed ``[n]``.
    """

    begins_ns: int
    ends_ns: int
    force_n: float
    spread_n: float
    zero_n: float
    touched_ns: int | None = None
    time_ns: np.ndarray = field(default_factory=lambda: np.empty(0))
    samples_n: np.ndarray = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, slots=True)
class Refused:
    """Rejected press.

    Attributes:
        kind: One of "too short", "still moving", "trembling", "late", "beyond range", "zero moved", "fault".
    """

    kind: str
    why: str
    ended_ns: int


class PlateauFinder:
    """Finds the plateau of each press in a stream of force samples.

    Attributes:
        zero_n: Reading without contact; None before it is known [N].
        noise_n: Standard deviation without contact [N].
        step_n: Resolution [N].
    """

    def __init__(self, scale: Weighing, rule: PlateauRule | None = None) -> None:
        if not (math.isfinite(scale.rate_hz) and scale.rate_hz > 0):
            raise InputError(f"{scale.name} gives {scale.rate_hz} samples a second; it must be above 0")
        if scale.lag_s is not None and not (math.isfinite(scale.lag_s) and scale.lag_s >= 0):
            raise InputError(f"{scale.name} has a lag of {scale.lag_s} s; give 0 s or more", code="lag-range")
        self.scale, self.rule = scale, rule or PlateauRule()
        self._lags: deque[float] = deque(maxlen=LAGS)
        self.zero_n: float | None = None
        self.noise_n = self.step_n = 0.0
        self._air: deque[tuple[int, float]] = deque()
        self._press: list[tuple[int, float]] = []
        self._behind: list[tuple[int, float]] = []
        self._fault = ""
        self._late_s = 0.0
        self._last: tuple[int, float] | None = None
        self._first_zero: tuple[int, float] | None = None

    @property
    def lag_s(self) -> float:
        """Time constant of the scale's filter: as stated, or as presses told; 0 for none [s]."""
        if self.scale.lag_s is not None:
            return self.scale.lag_s
        told_s = float(np.median(self._lags)) if self._lags else 0.0
        return told_s if told_s >= MIN_LAG_S else 0.0

    @property
    def _settle_s(self) -> float:
        return max(SETTLE_S, SETTLE_LAGS * self.lag_s)

    @property
    def newest_ns(self) -> int | None:
        """Time of the newest sample [ns]."""
        return self._last and self._last[0]

    @property
    def force_n(self) -> float | None:
        """Newest force, the zero taken off; None before both are known [N]."""
        return None if self._last is None or self.zero_n is None else self._last[1] - self.zero_n

    @property
    def fault(self) -> str:
        """What the scale says is wrong with its samples; empty since a good one of the untouched sensor."""
        return self._fault

    @property
    def touched(self) -> bool:
        """Whether a press is under way."""
        return bool(self._press) and not self._behind

    @property
    def pending(self) -> bool:
        """Whether a press is under way, or over and not judged yet."""
        return bool(self._press)

    @property
    def touch_n(self) -> float:
        """Force above which the sensor is touched [N]."""
        return max(NOISES * self.noise_n, 2 * self.step_n, self.rule.least_n)

    @property
    def holding(self) -> bool:
        """Whether the newest samples would make a plateau."""
        if not self.touched or self.zero_n is None:
            return False
        since = self._press[-1][0] - self.rule.shortest_s(self.scale) * NS_PER_S
        if self._press[0][0] > since:
            return False
        recent = [one for one in self._press if one[0] >= since]
        t, f = _arrays(recent)
        moved, swing = _line(t, f)
        level = float(f.mean()) - self.zero_n
        return abs(moved) <= self._may_move_n(level) and swing <= self._may_swing_n(level)

    @property
    def drift_n(self) -> float:
        """By how much the zero has moved since the first [N]."""
        return 0.0 if self._first_zero is None or self.zero_n is None else self.zero_n - self._first_zero[1]

    @property
    def drift_n_min(self) -> float:
        """The same a minute; 0 before one has passed [N/min]."""
        if self._first_zero is None or self._last is None:
            return 0.0
        minutes = (self._last[0] - self._first_zero[0]) / NS_PER_S / 60
        return self.drift_n / minutes if minutes > 0.5 else 0.0

    def take(self, samples: Sequence[Wrench]) -> list[Plateau | Refused]:
        """Presses that have ended, by samples that have come, oldest first."""
        found: list[Plateau | Refused] = []
        for one in samples:
            found += self._take(one)
        return found

    def rezero(self) -> list[Plateau | Refused]:
        """Take the next samples for those of the untouched sensor; a press under way is refused."""
        lost = (
            [Refused("zero moved", "the zero was taken anew during it", self._press[-1][0])]
            if self._press
            else []
        )
        self._press, self._behind, self.zero_n = [], [], None
        self._air.clear()
        return list(lost)

    @property
    def touched_s(self) -> float:
        """Time since which the sensor is touched without a break [s]."""
        return (self._press[-1][0] - self._press[0][0]) / NS_PER_S if self.touched else 0.0

    def end(self) -> list[Plateau | Refused]:
        """No more samples come: judge a press that is over but for its zero."""
        return [self._judged()] if self._press and self._behind else []

    def _take(self, one: Wrench) -> list[Plateau | Refused]:
        if one.fault:
            self._fault = self._fault or one.fault
            return []
        at, force = one.time_ns, one.force_n[2]
        if self._last is not None and self._press:
            self._late_s = max(self._late_s, (at - self._last[0]) / NS_PER_S)
        self._last = at, force
        if self.zero_n is None:
            return self._begin(at, force)
        released = len(self._behind) >= MIN_ZERO_SAMPLES  # whose zero may have moved a little
        if abs(force - self.zero_n) < (2 if released else 1) * self.touch_n:
            return self._in_air(at, force)
        if len(self._behind) < MIN_ZERO_SAMPLES:  # noise about the threshold
            self._press += self._behind
            self._behind = []
        judged = [self._judged()] if self._behind else []  # touched anew before its zero was known
        if not self._press:
            self._fault, self._late_s = "", 0.0
        self._press.append((at, force))
        if at - self._press[0][0] > MAX_PRESS_S * NS_PER_S:
            del self._press[0]
        return judged

    def _begin(self, at: int, force: float) -> list[Plateau | Refused]:
        """The first samples are of the untouched sensor."""
        self._air.append((at, force))
        enough = max(0.5 * self.scale.rate_hz, 2 * MIN_ZERO_SAMPLES)
        if len(self._air) >= enough:
            self._read_zero()
            self._first_zero = at, float(self.zero_n or 0.0)
        return []

    def _in_air(self, at: int, force: float) -> list[Plateau | Refused]:
        if not self._press:
            self._fault = ""
            self._air.append((at, force))
            while self._air[0][0] < at - KEPT_ZEROS_S * NS_PER_S and len(self._air) > 2 * MIN_ZERO_SAMPLES:
                self._air.popleft()
            self._read_zero()
            return []
        self._behind.append((at, force))
        settled = [p for p in self._behind if p[0] >= self._behind[0][0] + self._settle_s * NS_PER_S]
        if len(settled) < MIN_ZERO_SAMPLES or settled[-1][0] - settled[0][0] < AIR_S * NS_PER_S:
            return []
        return [self._judged()]

    def _read_zero(self) -> None:
        values = np.array([force for _, force in self._air])
        self.zero_n = float(np.median(values))
        spread = 1.4826 * float(np.median(np.abs(values - self.zero_n)))
        self.noise_n = max(self.noise_n, spread) if self.noise_n == 0 else 0.9 * self.noise_n + 0.1 * spread
        steps = np.diff(np.unique(np.round(values, 9)))
        if len(steps):
            least = float(steps.min())
            self.step_n = least if self.step_n == 0 else min(self.step_n, least)

    def _may_move_n(self, level_n: float) -> float:
        return max(self.rule.moved * abs(level_n), 1.5 * self.step_n, 2 * self.noise_n)

    def _may_swing_n(self, level_n: float) -> float:
        return max(self.rule.swing * abs(level_n), self.step_n, 2 * self.noise_n)

    def _judged(self) -> Plateau | Refused:
        """Verdict on the press that is over, and begin anew."""
        press, behind, before = self._press, self._behind, float(self.zero_n or 0.0)
        fault, late_s = self._fault, self._late_s
        self._press, self._behind, self._fault, self._late_s = [], [], "", 0.0
        settled = [p for p in behind if p[0] >= behind[0][0] + self._settle_s * NS_PER_S]
        after = float(np.median([f for _, f in settled])) if len(settled) >= MIN_ZERO_SAMPLES else before
        if len(settled) >= MIN_ZERO_SAMPLES:
            self._air = deque(settled)
            self._read_zero()
        ended_ns = press[-1][0]
        if fault:
            kind = (
                "beyond range" if any(word in fault for word in ("satur", "range", "overload")) else "fault"
            )
            return Refused(kind, f"{self.scale.name} said: {fault}", ended_ns)
        gap_s = max(GRAVE_GAP_S, 5 / self.scale.rate_hz)
        if late_s > gap_s:
            why = (
                f"{self.scale.name} gave no sample for {late_s:.2g} s of it, where {gap_s:.2g} s are allowed"
            )
            return Refused("late", f"{why}; check its cable, and that nothing else reads it", ended_ns)
        return self._plateau_of(press, behind, before, after)

    def _tell_lag(self, samples: list[tuple[int, float]], zero: float) -> None:
        """The lag by which readings die away once the force is gone: their logarithm falls by 1 in it."""
        t, f = _arrays(samples)
        f = f - zero
        top = int(np.argmax(f))
        share = f[top:] / max(float(f[top]), 1e-9)
        last = np.flatnonzero(share > DYING[0])
        begin = top + (int(last[-1]) + 1 if len(last) else 0)
        floor = max(DYING[1] * float(f[top]), 4 * self.noise_n, 2 * self.step_n)
        low = np.flatnonzero(f[begin:] <= floor)
        end = begin + (int(low[0]) if len(low) else len(f) - begin)
        if end - begin < MIN_DYING:
            self._lags.append(0.0)
            return
        fall = -float(np.polyfit(t[begin:end], np.log(f[begin:end]), 1)[0])
        self._lags.append(1 / fall if fall > 0 else 0.0)

    def _plateau_of(
        self, press: list[tuple[int, float]], behind: list[tuple[int, float]], before: float, after: float
    ) -> Plateau | Refused:
        t, f = _arrays(press)
        zero = (before + after) / 2
        ended_ns = press[-1][0]
        if float(np.abs(f).max()) > self.scale.range_n:
            why = (
                f"{float(np.abs(f).max()):.3g} N, and {self.scale.name} measures to {self.scale.range_n:g} N"
            )
            return Refused("beyond range", f"{why}; press less hard", ended_ns)
        self._tell_lag(press + behind, zero)
        found = self._longest(t, f - zero)
        if isinstance(found, Refused):
            return found
        first, last = found
        level = float(f[first : last + 1].mean()) - zero
        moved_n = abs(after - before)
        if moved_n > max(self.rule.moved * abs(level), 3 * self.step_n, 4 * self.noise_n):
            why = f"the zero of {self.scale.name} moved by {moved_n:.3g} N over a press of {level:.3g} N"
            return Refused("zero moved", f"{why}; let it warm up, and set nothing else on it", ended_ns)
        delay_s, lag_s = self.scale.delay_s, self.lag_s
        # Behind a filter of first order the frames of a delay's beginning are older than what it shows.
        before_s, after_s = (min(lag_s, delay_s), 0.0) if lag_s else (delay_s / 2, delay_s / 2)
        times = np.array([at for at, _ in press[first : last + 1]], dtype=np.int64)
        held = f[first : last + 1] - zero
        moved, swing = _line(t[first : last + 1], held)
        level += lag_s * moved / max(float(t[last] - t[first]), 1e-9)  # what the filter is still behind
        begins = int(times[0]) + round(before_s * NS_PER_S)
        ends = int(times[-1]) - round(after_s * NS_PER_S)
        return Plateau(begins, ends, level, swing, zero, press[0][0], times, held)

    def _behind_n(self, t: Series, f: Series, edges: np.ndarray, lag_s: float) -> tuple[np.ndarray, float]:
        """By how much the filter is behind at most from each bin to each later one, and by noise alone."""
        count = len(edges) - 1
        if not lag_s:
            return np.zeros((count, count)), 0.0
        wide = max(3, math.ceil(lag_s * self.scale.rate_hz) + 1)
        behind = lag_s * np.maximum.reduceat(np.abs(_rates(t, f, wide)), edges[:-1])
        greatest = np.maximum.accumulate(np.triu(np.broadcast_to(behind, (count, count))), axis=1)
        noise_n = max(self.noise_n, self.step_n / math.sqrt(12))
        return greatest, RATE_NOISES * lag_s * noise_n * self.scale.rate_hz * math.sqrt(12 / wide**3)

    def _longest(self, t: Series, f: Series) -> tuple[int, int] | Refused:
        """First and last sample of the longest steady stretch; or what is wrong with the calmest."""
        lag_s = self.lag_s
        shortest = max(
            self.rule.shortest_s(self.scale), min(lag_s, self.scale.delay_s) + CAUGHT_UP_S * (lag_s > 0)
        )
        edges = _bins(t)
        starts, ends = edges[:-1], edges[1:]
        n = (ends - starts).astype(float)
        sums = [np.concatenate([[0.0], np.cumsum(x)]) for x in (n, *_moments(t, f, edges))]
        i, j = np.triu_indices(len(n))
        count, st, sf, stt, sft, sff = (total[j + 1] - total[i] for total in sums)
        lasts = t[ends[j] - 1] - t[starts[i]]
        long = lasts >= shortest - 1e-9
        ended_ns = self._last[0] if self._last else 0
        if not long.any():
            why = f"it was touched for {t[-1] - t[0]:.2g} s; hold still for {shortest:.2g} s or longer"
            return Refused("too short", why, ended_ns)
        level = sf / count
        var_t = np.maximum(stt / count - (st / count) ** 2, 1e-12)
        slope = (sft / count - st / count * level) / var_t
        moved = np.abs(slope) * lasts
        swing = np.sqrt(np.maximum(sff / count - level**2 - slope**2 * var_t, 0.0))
        may_move = np.maximum(self.rule.moved * np.abs(level), max(1.5 * self.step_n, 2 * self.noise_n))
        may_swing = np.maximum(self.rule.swing * np.abs(level), max(self.step_n, 2 * self.noise_n))
        held = long & (level > self.touch_n)
        behind_n, unsure_n = self._behind_n(t, f, edges, lag_s)
        behind_n = behind_n[i, j]
        good = held & (moved <= may_move) & (swing <= may_swing)
        good &= behind_n <= np.maximum(may_move, unsure_n)
        if good.any():
            best = np.flatnonzero(good)[np.argmax(lasts[good])]
            return int(starts[i[best]]), int(ends[j[best]] - 1)
        if not held.any() and bool((long & (level < -self.touch_n)).any()):
            why = (
                f"{self.scale.name} weighed {-level[long].min():.3g} N less than untouched: something lay on"
            )
            return Refused("zero moved", f"{why} it as its zero was taken; take it off, begin anew", ended_ns)
        if not held.any():
            return Refused(
                "too short", f"no force was held for {shortest:.2g} s; hold still longer", ended_ns
            )
        if lag_s and (held & (moved <= may_move) & (swing <= may_swing)).any():
            why = f"{self.scale.name} follows with a lag of {lag_s:.2g} s and had not caught up; hold "
            why += f"still for {CAUGHT_UP_LAGS * lag_s + shortest:.1f} s or longer"
            return Refused("still moving", why, ended_ns)
        calm = np.flatnonzero(held)[np.argmin(np.maximum(moved / may_move, swing / may_swing)[held])]
        if swing[calm] / may_swing[calm] >= moved[calm] / may_move[calm]:
            why = f"the force swings by {swing[calm]:.2g} N about {level[calm]:.3g} N, where "
            why += f"{may_swing[calm]:.2g} N are allowed; rest your hand or elbow, or lay weights on instead"
            return Refused("trembling", why, ended_ns)
        why = f"the force moves by {moved[calm]:.2g} N within {lasts[calm]:.2g} s, where "
        why += f"{may_move[calm]:.2g} N are allowed; hold still for {shortest:.2g} s"
        return Refused("still moving", why, ended_ns)


def _rates(t: Series, f: Series, wide: int) -> Series:
    """Rate at each sample: slope of a line through so many around it, at the ends through the outermost."""
    wide = min(wide, len(t))
    if wide < 3:
        return np.zeros(len(t))
    t_in, f_in = (np.lib.stride_tricks.sliding_window_view(x, wide) for x in (t, f))
    away = t_in - t_in.mean(axis=1, keepdims=True)
    slope = (away * f_in).sum(axis=1) / np.maximum((away**2).sum(axis=1), 1e-12)
    return np.pad(slope, (wide // 2, wide - 1 - wide // 2), mode="edge")


def _arrays(samples: Sequence[tuple[int, float]]) -> tuple[Series, Series]:
    """Times from the first [s], and forces [N]."""
    at = np.array([t for t, _ in samples], dtype=np.int64)
    return (at - at[0]) / NS_PER_S, np.array([f for _, f in samples])


def _bins(t: Series) -> np.ndarray:
    """Edges of at most so many runs of samples."""
    return np.unique(np.linspace(0, len(t), min(len(t), MAX_BINS) + 1).astype(int))


def _moments(t: Series, f: Series, edges: np.ndarray) -> list[np.ndarray]:
    """Sums over each run of samples of t, f, t t, f t and f f."""
    return [np.add.reduceat(x, edges[:-1]) for x in (t, f, t * t, f * t, f * f)]


def _line(t: Series, f: Series) -> tuple[float, float]:
    """By how much a straight line through samples moves over them, and what they swing about it."""
    if len(t) < 3 or t[-1] <= t[0]:
        return 0.0, float(f.std())
    slope, level = np.polyfit(t - t.mean(), f, 1)
    return float(slope * (t[-1] - t[0])), float(np.std(f - level - slope * (t - t.mean())))
