"""A gentle touch before the first press of a run and after each change of tool: does the sensor feel it?

The probe goes down at the speed of the search for contact, until the force is a few times the threshold that
says contact, and back up. The force has to rise on the way down and to be gone afterwards, and to follow the
motion without a lag that its timestamps do not show (`force_lag`). What is felt on the way is the first that
the guard learns of the skin's stiffness, before any press goes deeper.

Lag of the force behind the motion, from one touch: the delay at which force is a function of depth.

A force sensor may state current timestamps for samples that it, a filter, or a link held back. Loading and
unloading then disagree: at the speed v a lag tau shifts the force deeper by v tau on the way down and
shallower by v tau on the way up. For each lag of a grid the force is fitted as a piecewise linear function of
the depth at t - tau; the residual is least at the true lag. A viscoelastic skin and friction dissipate, which
is the opposite hysteresis: they hide a few milliseconds of a lag and never imitate one.

Range of stiffness of a skin, from a run whose force was right, for the rig's file.

Force is taken over depth on the way down alone, in factors of two of the force, one stiffness for each press.
The range is that of all presses, widened by a margin for other places and speeds. From then on the guard
checks the first press of every run against it, so that a gain of the force sensor that has changed is found
before the press has gone deeper than planned.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace

import numpy as np

from palpate.core import NS_PER_S, Clock, Float, InputError, Position, Wrench, ndarray
from palpate.devices import ForceReached, Guard, Reason, Tripped
from palpate.devices.force_trust import StiffnessRange
from palpate.recordings import Run
from palpate.recordings.run_reader import VOID
from palpate.rig.plans.recording_plan import RecordingPlan
from palpate.rig.rig import Rig
from palpate.rig.run_progress import fields_of

LAGS_S = np.arange(-0.05, 0.3001, 0.005)
KNOTS_M = np.array([0.8, 0.6, 0.45, 0.3, 0.2, 0.1]) * 1e-3  # above the deepest position
SIGMAS = 5.0  # half width of the interval, in standard deviations: noise alone must not show a lag
GAP_S = 0.1  # longest interval between two positions in which a motion is interpolated
MOVED_M = 1e-6
MAX_SAMPLES = 1000  # more are averaged in blocks

Series = Float[ndarray, " n"]
Positions = Float[ndarray, " p"]


@dataclass(frozen=True, slots=True)
class ForceLag:
    """Lag of the force behind the reported position.

    Attributes:
        lag_s: the most likely [s].
        least_s, greatest_s: interval of five standard deviations; wider by the longest interval without a
            position in which the stage moved, if it exceeds `GAP_S` [s].
    """

    lag_s: float
    least_s: float
    greatest_s: float


def lag_of(force_s: Series, force_n: Series, position_s: Positions, depth_m: Positions) -> ForceLag | None:
    """Estimate the lag of a force behind a motion that goes into a skin, stands, and goes back.

    Args:
        force_s, force_n: samples of the normal force, in temporal order [s, N].
        position_s, depth_m: positions of the stage along the skin's normal, in temporal order [s, m].

    Returns:
        The lag, between -50 and 300 ms; None with fewer samples than the fit needs.

    Example:
        >>> t = np.arange(0.0, 1.4, 0.005)
        >>> depth = 1e-3 * np.interp(t, [0.0, 0.5, 0.7, 1.2], [-0.5, 0.5, 0.5, -0.5])
        >>> force = 1e3 * np.maximum(np.interp(t - 0.1, t, depth), 0.0)
        >>> round(lag_of(t, force, t, depth).lag_s, 3)
        0.1
    """
    if len(position_s) < 2:
        return None
    use = force_s >= position_s[0]  # before, the stage stood there
    blocks = max(1, -(-int(use.sum()) // MAX_SAMPLES))
    t, F = (_block_means(one[use], blocks) for one in (force_s, force_n))
    knots = depth_m.max() - KNOTS_M
    columns = 1 + len(knots)
    if len(t) <= 2 * columns:
        return None
    residual = np.array([_residual(np.interp(t - lag, position_s, depth_m), F, knots) for lag in LAGS_S])
    variance = residual.min() / (len(t) - columns)
    likely = LAGS_S[residual <= residual.min() + SIGMAS**2 * variance]
    gaps_s = np.diff(position_s)[np.abs(np.diff(depth_m)) > MOVED_M]
    gap_s = max((one for one in gaps_s.tolist() if one > GAP_S), default=0.0)
    return ForceLag(float(LAGS_S[residual.argmin()]), float(likely[0]) - gap_s, float(likely[-1]) + gap_s)


def _residual(depth_m: Series, force_n: Series, knots_m: Float[ndarray, " k"]) -> float:
    """Sum of squares that a piecewise linear function of depth leaves [N^2]."""
    A = np.column_stack([np.ones_like(depth_m), *(np.maximum(depth_m - one, 0.0) * 1e3 for one in knots_m)])
    coefficients = np.linalg.lstsq(A, force_n, rcond=None)[0]
    left = force_n - A @ coefficients
    return float(left @ left)


def _block_means(values: Series, size: int) -> Float[ndarray, " m"]:
    whole = len(values) // size * size
    return values[:whole].reshape(-1, size).mean(axis=1)


class TouchRecord:
    """Normal force and position in one touch.

    Args:
        guard: that moves; its samples and positions are recorded.
        clock: that both are stamped on.
    """

    def __init__(self, guard: Guard, clock: Clock) -> None:
        self._guard, self._clock = guard, clock
        self._force: list[tuple[float, float]] = []
        self._positions: list[tuple[float, float]] = []

    @contextmanager
    def recorded(self) -> Iterator[None]:
        """Record what passes within a ``with`` block."""
        with self._guard.samples.subscribed(self._feel), self._guard.positions.subscribed(self._at):
            yield

    def stand(self) -> None:
        """Record where the stage stands now."""
        self._at(self._guard.position_m(), self._clock.now_ns())

    def lag(self) -> ForceLag | None:
        """Estimate the lag of what was recorded; None where too little was."""
        if not self._force or not self._positions:
            return None
        (force_s, force_n), (position_s, depth_m) = (
            np.array(one).T for one in (self._force, self._positions)
        )
        return lag_of(force_s, force_n, position_s, depth_m)

    def _feel(self, samples: Sequence[Wrench]) -> None:
        self._force += [
            (one.time_ns / NS_PER_S, self._guard.skin_n(one)[2]) for one in samples if not one.fault
        ]

    def _at(self, at: Position, time_ns: int) -> None:
        self._positions.append((time_ns / NS_PER_S, at[2]))


MM = 1e-3
TIMES = 3.0  # the contact threshold
LIMIT_SHARE = 0.5  # of the limit of force, at most
REST_S = 0.1  # in the air
PRESSED_S = 0.25  # at the deepest, so that a late force comes to rest as well
LAG_SLACK_S = 0.01  # in the time of a reported position
LAG_LOOKS_AS = (Reason.FORCE_DEAD, Reason.FORCE_IMPLAUSIBLE, Reason.FORCE_NOISE)
"""Reasons that a late force may have, since it does not fall at once on the way back."""
LEFT = 0.5  # of the touch's force that may be left in the air, by a skin that clings


@dataclass(frozen=True, slots=True)
class FeltTouch:
    """What a gentle touch felt.

    Attributes:
        force_n: at its deepest [N].
        left_n: back in the air [N].
        z_mm: of its deepest, below the expected surface [mm].
        lag_s, least_s, greatest_s: lag of the force behind the motion and its interval, see `ForceLag`; None
            where too little was measured [s].
    """

    force_n: float
    left_n: float
    z_mm: float
    lag_s: float | None = None
    least_s: float | None = None
    greatest_s: float | None = None


def touch_gently(rig: Rig, plan: RecordingPlan, guard: Guard) -> FeltTouch:
    """Touch the skin below the probe, which hangs in the air with its zero measured, and come back.

    Raises:
        Tripped: `FORCE_LAG`, the force follows the motion later than the rig states; the force does not rise
            on the way down, or does not fall on the way back; nothing was felt at all; or what any guarded
            motion raises.
    """
    record = TouchRecord(guard, rig.clock)
    with record.recorded():
        record.stand()
        try:
            felt = _down_and_back(rig, plan, guard, record)
        except Tripped as e:
            if e.reason in LAG_LOOKS_AS:
                record.stand()
                lag = record.lag()
                if lag is not None and lag.greatest_s < LAGS_S[-1]:  # and one that is held falls never
                    _check_lag(rig, lag)
            raise
    lag = record.lag()
    _check_lag(rig, lag)
    return felt if lag is None else replace(felt, **asdict(lag))


def _down_and_back(rig: Rig, plan: RecordingPlan, guard: Guard, record: TouchRecord) -> FeltTouch:
    wanted_n = min(TIMES * plan.threshold_N, LIMIT_SHARE * rig.limits.force_n)
    x, y, z = guard.position_m()
    if guard.force_n[2] > plan.threshold_N:
        raise Tripped(Reason.TOUCHED_EARLY, "the probe is in contact at the clearance already")
    lowest = (x, y, rig.origin_m[2] + plan.seek_mm * MM)
    speed = plan.seek_mm_s * MM
    reached = guard.towards(lowest, speed, ForceReached(wanted_n, any_way=True))
    record.stand()
    if reached and guard.force_n[2] <= plan.threshold_N:
        raise Tripped(
            Reason.FORCE_REVERSED,
            f"the touch was felt with {guard.force_n[2]:.2f} N along the press and "
            f"{math.hypot(*guard.force_n):.2f} N in all: the axes in the rig's file are wrong",
        )
    if not reached and guard.force_n[2] <= plan.threshold_N:  # a soft specimen may not carry more
        raise Tripped(
            Reason.NO_CONTACT,
            f"a touch of {plan.threshold_N:g} N was not felt down to {plan.seek_mm:g} mm below the expected "
            "surface; is the layer there, and does the force sensor feel anything?",
        )
    guard.learn_press()
    pressed_n, deepest = _mean_n(guard, PRESSED_S), guard.position_m()[2]
    record.stand()
    guard.away((x, y, z), speed)
    left_n = _mean_n(guard, REST_S)
    if abs(left_n) > max(LEFT * pressed_n, plan.threshold_N):
        raise Tripped(
            Reason.FORCE_DEAD,
            f"a touch of {pressed_n:.3f} N left {left_n:.3f} N in the air: the force did not fall when the "
            "probe was lifted; does the sensor follow what it touches?",
        )
    return FeltTouch(pressed_n, left_n, (deepest - rig.origin_m[2]) / MM)


def allowed_lag_s(rig: Rig) -> float:
    """Greatest lag of the force behind the motion that a rig's limits and stage explain [s]."""
    return rig.limits.force_latency_s + rig.stage.travel.latency_s + LAG_SLACK_S


def _check_lag(rig: Rig, lag: ForceLag | None) -> None:
    allowed_s = allowed_lag_s(rig)
    if lag is None or lag.least_s <= allowed_s:
        return
    raise Tripped(
        Reason.FORCE_LAG,
        f"the force follows the motion {lag.lag_s * 1e3:.0f} ms late ({lag.least_s * 1e3:.0f} to "
        f"{lag.greatest_s * 1e3:.0f} ms), although its timestamps are current; {allowed_s * 1e3:.0f} ms are "
        "allowed. Remove the filter or the queue between sensor and computer, or state the true "
        "force_latency_s in [limits]",
        {**asdict(lag), "allowed_s": allowed_s},
    )


def _mean_n(guard: Guard, seconds: float) -> float:
    """Mean normal force while the probe stands [N]."""
    samples = guard.wait(seconds)
    good = [guard.skin_n(one)[2] for one in samples if not one.fault]
    return sum(good) / len(good) if good else guard.force_n[2]


MARGIN = 1.2  # by which the range is wider than the presses
MAX_RATIO = 2.5  # of greatest to least, above which a gain of two lies inside the range
NOISES = 20.0  # of the force, below which no stiffness is taken
FELT = 0.4  # of a factor of two in force that a press has to rise by
LEVEL_M = 1e-6
PAUSE_S = 0.1  # between two positions: longer, and the stage stood in between


@dataclass(frozen=True, slots=True)
class SkinStiffness:
    """Range of stiffness that presses met.

    Attributes:
        range: over the normal force.
        presses: that it was taken from, the gentle touches among them.
        ratio: of greatest to least at its widest. A gain that changes less than this is not found.
    """

    range: StiffnessRange
    presses: int
    ratio: float


def stiffness_of(run: Run, margin: float = MARGIN) -> SkinStiffness:
    """Return the range of stiffness that a run's presses met, all with one indenter.

    Args:
        run: recorded by a plan, without rejected presses.
        margin: factor by which the range is wider than what was met.

    Raises:
        InputError: rejected presses, several indenters, or no press that is deep enough.
    """
    if fields_of(run, VOID):
        raise InputError("the run has rejected presses; record one without them to find a stiffness")
    indenters = set(run.labels["indenter"].dropna()) if "indenter" in run.labels else set()
    if len(indenters) > 1:
        raise InputError(f"the run has {len(indenters)} indenters; a stiffness is of one. Record one each")
    force, stage, events = run.force(), run.stage(), run.events()
    begun_s = events["time_s"][events["kind"] == "tare"].to_numpy()
    at_s, xyz = stage["time_s"].to_numpy(), stage[["x_m", "y_m", "z_m"]].to_numpy()
    force_n = np.interp(at_s, force["time_s"].to_numpy(), force["fz_N"].to_numpy())
    presses = list(_presses(np.searchsorted(begun_s, at_s), at_s, xyz, force_n))
    by_bin: dict[int, list[float]] = defaultdict(list)
    noise_n = max((float(one["noise_n"]) for one in fields_of(run, "tare")), default=0.0)  # type: ignore[arg-type]
    for press in presses:
        for bin_, stiffness in press.items():
            if 2.0 ** (bin_ - 1) > NOISES * noise_n:
                by_bin[bin_].append(stiffness)
    if not by_bin:
        raise InputError("no press of the run rises over a factor of two in force; press deeper")
    bins = sorted(by_bin)
    forces = tuple(0.75 * 2.0**one for one in bins)
    least = tuple(min(by_bin[one]) / margin for one in bins)
    greatest = tuple(max(by_bin[one]) * margin for one in bins)
    ratio = float(max(high / low for low, high in zip(least, greatest, strict=True)))
    return SkinStiffness(StiffnessRange(forces, least, greatest), len(presses), ratio)


def _presses(
    numbers: ndarray, at_s: Series, xyz: Float[ndarray, "n 3"], force_n: Series
) -> Iterable[dict[int, float]]:
    """Yield the stiffness of each press by the binary exponent of the force [N/m]."""
    down = np.diff(xyz[:, 2]) > LEVEL_M
    straight = (np.abs(np.diff(xyz[:, :2], axis=0)) < LEVEL_M).all(axis=1)
    moves = down & straight & (np.diff(at_s) < PAUSE_S) & (np.diff(numbers) == 0)
    middle_n, rise_n, way_m = (force_n[1:] + force_n[:-1]) / 2, np.diff(force_n), np.diff(xyz[:, 2])
    for number in np.unique(numbers):
        sums: dict[int, list[float]] = defaultdict(lambda: [0.0, 0.0])
        for i in np.flatnonzero(moves & (numbers[1:] == number) & (middle_n > 0)):
            one = sums[math.frexp(middle_n[i])[1]]
            one[0] += float(rise_n[i])
            one[1] += float(way_m[i])
        found = {
            bin_: rise / way
            for bin_, (rise, way) in sums.items()
            if way > 0 and rise >= FELT * 2.0 ** (bin_ - 1)
        }
        if found:
            yield found


def stiffness_lines(indenter: str, found: SkinStiffness, day: str) -> str:
    """Return the table for the rig's file.

    Args:
        indenter: name of the indenter, as plans give it.
        found: range.
        day: date of the measurement, ISO 8601.
    """
    one = found.range
    per_mm = ((value * 1e-3 for value in values) for values in (one.least_n_m, one.greatest_n_m))
    rows = (", ".join(f"{value:.4g}" for value in values) for values in (one.force_n, *per_mm))
    names = ("force_N", "least_N_mm", "greatest_N_mm")
    lines = [f"{name} = [{row}]" for name, row in zip(names, rows, strict=True)]
    return "\n".join(["[[stiffness]]", f'indenter = "{indenter}"', *lines, f"measured_on = {day}"])
