"""Latency of the camera from presses that go down and come back.

If frames are late by tau, force and pin motion s satisfy F(t - tau) = h(s(t)) with h rising; any other tau
gives hysteresis. A monotone spline h is fitted at every tau; the residual profile gives the estimate and its
interval (Student's quantile with autocorrelation-corrected freedom). A press whose force only rises
identifies no tau: `told` is the ratio of dF/dtau that no h can mimic. Creep looks like a delay at one speed,
but not at two.

References: J. O. Ramsay, Statist. Sci. 3 (1988) 425, doi:10.1214/ss/1177012761 (monotone splines);
D. J. Venzon, S. H. Moolgavkar, Appl. Statist. 37 (1988) 87, doi:10.2307/2347496 (profile intervals);
J. G. MacKinnon, H. White, J. Econometrics 29 (1985) 305, doi:10.1016/0304-4076(85)90158-7 (uneven errors);
R. DerSimonian, N. Laird, Control. Clin. Trials 7 (1986) 177, doi:10.1016/0197-2456(86)90046-2 (joining).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import minimize_scalar, nnls
from scipy.stats import chi2, norm, t as student, ttest_ind

from palpate.core import Float, InputError, Int, RangeError, ndarray
from palpate.core.reading import NONE, Refusal
from palpate.estimators.compliance.stiffness_curve import CONTACT_N, without_spikes

COVERAGE = 0.95
MAX_LATENCY_S = 0.25  # of the latencies looked for, to either side
STEP_S = 4e-3  # of the first, coarse search
PIECES, ORDER = 6, 4  # of the law's spline: polynomials of degree 3
MIN_FRAMES = 20  # for eight coefficients and an interval
MIN_TOLD = 0.3  # of the derivative along the latency, that no law of force mimics
MIN_EXPLAINED = 0.95  # of the force's variance, by the motion
MIN_MOTION = 0.5  # px that the pins must move, all taken together
AIR = 0.1  # of the greatest force, below which a record that begins or ends so does it in the air
MIN_RATIO = 1.5  # of two presses' speeds, for them to be two speeds
UNLIKELY = 0.01  # chance by which presses that agree would differ so much
MIN_APART_S = 5e-3  # least significant difference between presses
MAX_CORRELATION = 0.95

Series = Float[ndarray, " _"]  # of any length; matching lengths are checked
Samples = Float[ndarray, " s"]
Frames = Float[ndarray, " f"]
Columns = Float[ndarray, "f c"]


@dataclass(frozen=True)
class PressLatency:
    """Latency by one press.

    Attributes:
        seconds: Estimate, above 0 if a frame shows an earlier moment than its table time [s].
        low_s, high_s: 95 % interval [s].
        sd_s: Standard uncertainty [s].
        freedom: Degrees of freedom of the residuals after their autocorrelation.
        told: Ratio of the force's derivative along the latency that no law of force mimics, 0 to 1.
        explained: R² of force by motion.
        rate_n_s: Loading rate between 10 and 90 % of the greatest force [N/s].
    """

    seconds: float
    low_s: float
    high_s: float
    sd_s: float
    freedom: float
    told: float
    explained: float
    rate_n_s: float


@dataclass(frozen=True)
class Latency:
    """Latency of a camera by several presses.

    Attributes:
        between_s: Standard deviation between presses beyond their own uncertainty [s].
        agree_p: Probability of so large a difference between presses with one latency; NaN for one press.
        speeds: 2 if slow and fast presses differ by a factor of `MIN_RATIO` or more, else 1.
        slow_s, fast_s: Latency and standard uncertainty by slow and by fast presses; None for one speed.
        speeds_p: Probability of so large a difference between slow and fast presses; NaN for one speed.
    """

    seconds: float
    low_s: float
    high_s: float
    sd_s: float
    between_s: float = 0.0
    agree_p: float = math.nan
    speeds: int = 1
    slow_s: tuple[float, float] | None = None
    fast_s: tuple[float, float] | None = None
    speeds_p: float = math.nan


def pin_course(moved_px: Float[ndarray, "f p 2"]) -> Frames:
    """Return the RMS pin motion along the first principal component of `moved_px`, of arbitrary sign [px]."""
    kept = np.isfinite(moved_px).all(axis=(0, 2))
    if not kept.mean() > 0.5:
        raise InputError(f"{int((~kept).sum())} of {len(kept)} pins are lost", code="pins-lost")
    motion = moved_px[:, kept].reshape(len(moved_px), -1)
    _, _, ways = np.linalg.svd(motion, full_matrices=False)
    return np.asarray(motion @ ways[0]) / math.sqrt(int(kept.sum()))


def press_latency(
    time_s: Series,
    force_n: Series,
    frame_sample: Int[ndarray, " _"],
    motion_px: Series,
    *,
    most_s: float = MAX_LATENCY_S,
) -> PressLatency:
    """Return the latency of the frames of one press that goes down and comes back.

    Args:
        time_s: Time of the force samples, ascending [s].
        force_n: Raw force, positive in compression [N].
        frame_sample: Index of each frame's sample by the table.
        motion_px: Pin motion of each frame, monotone in force.
        most_s: Greatest latency of either sign [s].

    Example:
        >>> t = np.arange(0.0, 3.0, 0.005)
        >>> press = lambda t: 5 * np.clip(1 - np.abs(t - 1.5), 0, None)
        >>> frames = np.arange(0, 600, 7)
        >>> found = press_latency(t, press(t), frames, 8 * np.sqrt(press(t[frames] - 0.06)))
        >>> round(found.seconds, 2)
        0.06
    """
    profile = _Profile(time_s, force_n, frame_sample, motion_px, most_s)
    coarse = np.linspace(-most_s, most_s, 2 * math.ceil(most_s / STEP_S) + 1)
    left = np.array([profile.squares(float(tau)) for tau in coarse])
    best = int(np.argmin(left))
    told = profile.told(float(coarse[best]))
    if told < MIN_TOLD:
        raise RangeError(
            f"force explains {1 - told:.0%} of a latency, {1 - MIN_TOLD:.0%} are allowed; record the "
            "unloading as well",
            code="no-unloading",
        )
    if best in (0, len(coarse) - 1):
        raise RangeError(
            f"no latency of up to {1e3 * most_s:g} ms aligns motion and force of these files",
            code="latency-not-found",
        )
    near = (float(coarse[best - 1]), float(coarse[best + 1]))
    fine = minimize_scalar(profile.squares, bounds=near, method="bounded", options={"xatol": 1e-6})
    return _with_interval(profile, float(fine.x), float(fine.fun), coarse, left, told)


class _Profile:
    """Sum of squares of the best rising law of force over motion, at any latency."""

    def __init__(
        self,
        time_s: Series,
        force_n: Series,
        frame_sample: Int[ndarray, " _"],
        motion_px: Series,
        most_s: float,
    ) -> None:
        time, motion = np.asarray(time_s, np.float64), np.asarray(motion_px, np.float64)
        _check(time, force_n, frame_sample, motion, most_s)
        force = without_spikes(np.asarray(force_n, np.float64))
        at = time[frame_sample]
        sample_s, frame_s = float(np.median(np.diff(time))), float(np.median(np.diff(at)))
        # Wide enough that noise counts alike whether tau falls on a sample or between two.
        self._width_s = max(2 * sample_s, frame_s / 2)
        self.top_n = float(force.max())
        kept = self._covered(time, force, at, most_s)
        if np.count_nonzero(kept) < MIN_FRAMES:
            raise RangeError(
                f"{np.count_nonzero(kept)} frames in contact are {1e3 * most_s:g} ms from the record's "
                f"ends; {MIN_FRAMES} are needed"
            )
        self.at, motion = at[kept], motion[kept]
        _check_press(force, motion)
        # In the air before and after there is nothing but noise, and no more of it than there was.
        ends = 2 * most_s + self._width_s
        padded_t = np.concatenate([[time[0] - ends], time, [time[-1] + ends]])
        rest = max(len(time) // 50, 1)
        padded = np.concatenate([[force[:rest].mean()], force, [force[-rest:].mean()]])
        self._integral = make_interp_spline(padded_t, padded, k=1).antiderivative()
        rises = np.corrcoef(motion, self.force(0.0))[0, 1] >= 0
        self.columns = _rising_columns(motion if rises else -motion)
        self.rate_n_s = _rate(time, force)

    def _covered(self, time: Samples, force: Samples, at: Frames, most_s: float) -> ndarray:
        """Frames whose force is known at every latency (beyond the record only without contact)."""
        reach = most_s + self._width_s
        first = time[0] if force[0] > AIR * self.top_n else -math.inf
        last = time[-1] if force[-1] > AIR * self.top_n else math.inf
        return np.asarray((at - reach >= first) & (at + reach <= last))

    def force(self, tau_s: float) -> Frames:
        """Mean force around the moments that frames show at a latency [N]."""
        middle, half = self.at - tau_s, self._width_s / 2
        return np.asarray(self._integral(middle + half) - self._integral(middle - half)) / self._width_s

    def residual(self, tau_s: float) -> Frames:
        force = self.force(tau_s)
        law, _ = nnls(self.columns, force)
        return np.asarray(force - self.columns @ law)

    def squares(self, tau_s: float) -> float:
        """Sum of squares of the best rising law [N^2]."""
        residual = self.residual(tau_s)
        return float(residual @ residual)

    def slope(self, tau_s: float) -> tuple[Frames, Frames]:
        """Derivative of the force with the latency, and its part that no law mimics [N/s]."""
        h = max(self._width_s, STEP_S)
        slope = (self.force(tau_s + h) - self.force(tau_s - h)) / (2 * h)
        mimic, *_ = np.linalg.lstsq(self.columns, slope, rcond=None)
        return slope, slope - self.columns @ mimic

    def told(self, tau_s: float) -> float:
        """Ratio of the derivative with the latency that no law of force mimics."""
        slope, own = self.slope(tau_s)
        whole = float(slope @ slope)
        return float(own @ own) / whole if whole > 0 else 0.0


def _check(
    time: Series, force_n: Series, frame_sample: Int[ndarray, " _"], motion: Series, most_s: float
) -> None:
    if time.shape != np.shape(force_n) or time.ndim != 1 or len(time) < MIN_FRAMES:
        raise InputError(
            f"{time.size} times, {np.size(force_n)} forces; give {MIN_FRAMES} or more of each",
            code="lengths-differ",
        )
    if len(frame_sample) != len(motion) or len(motion) < MIN_FRAMES:
        raise RangeError(
            f"{len(motion)} motions, {len(frame_sample)} frames; give {MIN_FRAMES} or more",
            code="too-few-frames",
        )
    if not (np.isfinite(time).all() and np.isfinite(force_n).all() and np.isfinite(motion).all()):
        raise InputError("times, forces and motions must be finite; repair the table", code="not-finite")
    if not (np.diff(time) > 0).all() or not (np.diff(frame_sample) > 0).all():
        raise InputError("times of samples and frames must rise; sort the rows", code="time-order")
    if not 0 < most_s < math.inf:
        raise RangeError(f"latencies of up to {most_s} s; above 0, {MAX_LATENCY_S} s if in doubt")


def _check_press(force: Samples, motion: Frames) -> None:
    """Refuse series that are no press."""
    if force.max() - np.quantile(force, 0.05) < CONTACT_N:
        raise RangeError(
            f"the force changes by {force.max() - force.min():.2g} N; a press needs {CONTACT_N:g} N",
            code="nothing-pressed",
        )
    if np.ptp(motion) < MIN_MOTION:
        raise RangeError(
            f"the pins move by {np.ptp(motion):.2g} px; {MIN_MOTION:g} px are needed", code="no-motion"
        )


def _rising_columns(motion: Frames) -> Columns:
    """Columns whose sums with non-negative weights rise with motion."""
    low, high = float(motion.min()), float(motion.max())
    inner = np.linspace(low, high, PIECES + 1)[1:-1]
    knots = np.concatenate([np.full(ORDER, low), inner, np.full(ORDER, high)])
    splines = BSpline.design_matrix(np.clip(motion, low, high), knots, ORDER - 1).toarray()
    sums = np.cumsum(splines[:, ::-1], axis=1)[:, ::-1]
    return np.column_stack([sums, -sums[:, 0]])


def _rate(time: Samples, force: Samples) -> float:
    """Loading rate between 10 and 90 % of the greatest force [N/s]."""
    top = int(np.argmax(force))
    rise = np.maximum.accumulate(force[: top + 1])
    begins, ends = (time[np.searchsorted(rise, share * force[top])] for share in (0.1, 0.9))
    return float(0.8 * force[top] / max(ends - begins, 1e-9))


def _with_interval(
    profile: _Profile, best_s: float, least: float, coarse: Frames, left: Frames, told: float
) -> PressLatency:
    force, residual = profile.force(best_s), profile.residual(best_s)
    explained = 1 - least / float(np.sum((force - force.mean()) ** 2))
    if explained < MIN_EXPLAINED:
        raise RangeError(
            f"the motion explains {explained:.0%} of the force, {MIN_EXPLAINED:.0%} are needed: check the "
            "files"
        )
    freedom, inflation = _freedom(residual, profile.columns, profile.slope(best_s)[1])
    reach = float(student.ppf((1 + COVERAGE) / 2, freedom))
    allowed = least * (1 + reach**2 * inflation)
    inside = np.flatnonzero(left <= allowed)
    low = best_s if not len(inside) else min(best_s, float(coarse[inside[0]]))
    high = best_s if not len(inside) else max(best_s, float(coarse[inside[-1]]))
    if low <= coarse[0] or high >= coarse[-1]:
        raise RangeError(
            f"latencies of up to {1e3 * coarse[-1]:g} ms fit as well as {1e3 * best_s:.0f} ms; press harder"
        )
    step = float(coarse[1] - coarse[0])
    low, high = _crossing(profile, allowed, low, -step), _crossing(profile, allowed, high, step)
    sd = (high - low) / (2 * reach)
    return PressLatency(best_s, low, high, sd, freedom, told, explained, profile.rate_n_s)


def _crossing(profile: _Profile, allowed: float, inside: float, step: float) -> float:
    """Latency at which the profile exceeds the allowed squares, between two bounds."""
    outside = inside + step
    for _ in range(12):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if profile.squares(middle) <= allowed else (inside, middle)
    return (inside + outside) / 2


def _freedom(residual: Frames, columns: Columns, own: Frames) -> tuple[float, float]:
    """Independent residuals, and the ratio of the least squares that one standard deviation adds."""
    n, k = len(residual), columns.shape[1] - 1
    r = float(residual[1:] @ residual[:-1]) / max(float(residual @ residual), 1e-300)
    r = min(max(r + k / n, 0.0), MAX_CORRELATION)
    weight = (1 - r) / (1 + r)
    left = n - k - 1
    J = np.column_stack([own, columns[:, :-1]])
    leverage = np.clip(np.einsum("ij,ji->i", J, np.linalg.pinv(J)), 0.0, 0.99)
    by_frames = float(np.sum((own * residual / (1 - leverage)) ** 2))
    alike = float(own @ own) * float(residual @ residual) / left
    uneven = max(by_frames / alike, 1.0) if alike > 0 else 1.0
    return max(left * weight, 2.0), uneven / (left * weight)


def joined_latency(presses: Sequence[PressLatency]) -> Latency:
    """Return the latency by several presses with the scatter between them (DerSimonian and Laird)."""
    if not presses:
        raise InputError("no press; give one or more")
    if len(presses) == 1:
        one = presses[0]
        return Latency(one.seconds, one.low_s, one.high_s, one.sd_s)
    seconds, sd_s, between_s, agree_p = _pooled(presses)
    freedom = sum(one.freedom for one in presses) if between_s == 0 else len(presses) - 1
    reach = sd_s * float(student.ppf((1 + COVERAGE) / 2, freedom))
    found = Latency(seconds, seconds - reach, seconds + reach, sd_s, between_s, agree_p)
    rates = np.array([one.rate_n_s for one in presses])
    if rates.max() < MIN_RATIO * rates.min():
        return found
    fast = rates > math.sqrt(rates.min() * rates.max())
    slower, faster = ([p for p, is_ in zip(presses, fast, strict=True) if is_ == side] for side in (0, 1))
    slow, quick, chance = _apart(slower, faster)
    return replace(found, speeds=2, slow_s=slow, fast_s=quick, speeds_p=chance)


Told = tuple[float, float]


def _apart(slower: Sequence[PressLatency], faster: Sequence[PressLatency]) -> tuple[Told, Told, float]:
    """Latency and standard uncertainty of slow and of fast presses [s], and the p-value of a difference."""
    if min(len(slower), len(faster)) < 2:
        slow, fast = (_pooled(each)[:2] for each in (slower, faster))
        return slow, fast, float(2 * norm.sf(abs(slow[0] - fast[0]) / math.hypot(slow[1], fast[1])))
    a, b = (np.array([one.seconds for one in each]) for each in (slower, faster))
    slow, fast = ((float(x.mean()), float(x.std(ddof=1) / math.sqrt(len(x)))) for x in (a, b))
    return slow, fast, float(ttest_ind(a, b, equal_var=False).pvalue)


def _pooled(presses: Sequence[PressLatency]) -> tuple[float, float, float, float]:
    """Mean, standard uncertainty, and scatter between presses [s], and the p-value of differences."""
    tau = np.array([one.seconds for one in presses])
    w = 1 / np.array([one.sd_s for one in presses]) ** 2
    k = len(tau)
    Q = float(w @ (tau - (w @ tau) / w.sum()) ** 2)
    between = max(0.0, (Q - (k - 1)) / (w.sum() - (w @ w) / w.sum())) if k > 1 else 0.0
    v = 1 / (1 / w + between)
    chance = float(chi2.sf(Q, k - 1)) if k > 1 else math.nan
    return float(v @ tau / v.sum()), float(v.sum() ** -0.5), math.sqrt(between), chance


def disagreement(found: Latency) -> Refusal:
    """Return why presses have no common latency, `creep` or `differ`; false if they may have one."""
    slow, fast = found.slow_s, found.fast_s
    apart = slow is not None and fast is not None and abs(slow[0] - fast[0]) > MIN_APART_S
    if apart and found.speeds_p < UNLIKELY:
        assert slow is not None
        assert fast is not None
        return Refusal(
            "creep",
            f"slow presses say {1e3 * slow[0]:.0f} ms and fast ones {1e3 * fast[0]:.0f} ms: no constant "
            "delay alone, the tip's creep or friction lags behind the force as well; one speed has its own",
        )
    if found.between_s > MIN_APART_S and found.agree_p < UNLIKELY:
        return Refusal(
            "differ",
            f"presses differ by {1e3 * found.between_s:.0f} ms beyond their own uncertainty: no one latency; "
            "look whether frames and tables belong together, and whether the camera drops frames",
        )
    return NONE
