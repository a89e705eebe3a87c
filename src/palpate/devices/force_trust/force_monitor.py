"""Monitor of a force sensor: whether its samples can be the force of a probe that moves as commanded.

The monitor learns the sensor's noise in air and the rise of force with depth in each press. It compares every
sample with the previous ones and with the commanded travel. `fault_names` then names the fault from the
samples at rest.

| plausibility fault | what is implausible |
|---|---|
| repeats | more equal samples in a row, on all six axes, than noise explains |
| jump | a change between two samples that no travel explains |
| pull | a tensile force on the way down |
| flat, steep | a force that rises less, or more, with depth than in earlier presses |
| soft, stiff | a force that rises less, or more, with depth than the rig states |
| holds | a force that does not fall on the way back |
| lost | contact that ends without motion away |
| quiet | noise that has fallen |
| late, gap | a sample after its turn; no sample at all |
| rise, struck | a force that rises while the probe moves away, or to the clearance |

Sequential sums (Page 1954, doi:10.1093/biomet/41.1-2.100) detect a rise that is too small, wherever it began.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from palpate.core import NS_PER_S, Travel, Wrench
from palpate.devices.force_bias import Force, ForceBias
from palpate.devices.force_trust.air_noise import (
    AirNoise,
    SampleDating,
    Six,
    check_fineness,
    check_pace,
    check_same_air,
    constant_air,
    six_of,
)
from palpate.devices.force_trust.stiffness_corridor import ForceClimb, StiffnessCorridor, StiffnessRange
from palpate.devices.motion_limits import Limits

BLIND_M = 0.08e-3  # of way on one sample
MIN_PERIODS = 4  # of samples that may be missing, however fast the stage moves
MIN_TURN = 5  # equal samples of a coarse sensor whose force should have moved by more than a step
CONTACT = 8.0  # noises from which a force is a contact
GONE = 2.0  # and below which it is none any more
PULLED = (
    5.0  # noises that the mean of a few samples lies below zero, under a pull: ten of the mean, for drift
)
PULLED_COARSE = 3.5  # and of a coarse sensor: more than one step of its quantum
JUMP = 8.5  # noises between two samples: six of their difference
JUMP_SHARE = 0.1  # of the force that may come and go between two samples: a skin that slips or snaps
SLIDE_SHARE = 0.5  # while the probe slides
DEFICIT = 4.5  # noises by which force may lag behind the least rise: nine of the mean that is looked at
EXCESS = 6.0  # and run ahead of the greatest
HELD = 10.0  # noises from which a force has to fall on the way back
HELD_SHARE = 0.2  # of the force at which the way back began; below, a skin that lags has long tails
SLACK_M = 20e-6  # of a stage that turns round
TURN_S = 0.015  # after the stage turns round, in which the force still goes the old way
SLACK_SHARE = 0.01  # of the force
LAG_S = 0.03  # after a move, in which the force still follows
REPORT_S = 0.25  # by which a stage's report may be late
SMOOTH = 0.4  # weight of the newest sample in the mean that is looked at
SETTLED = 6  # samples on the move after first contact, until that mean has risen over the way that it went
QUIET = 0.12  # of the noise's square, over `QUIET_SAMPLES`
QUIET_SAMPLES = 24
KEPT = 12  # samples before a doubt, for its name
AIRS = 8  # tares that are remembered


class Phase(Enum):
    """What the stage does."""

    STAND = "stand"
    DOWN = "down"
    ASIDE = "aside"
    UP = "up"  # at a speed at which it can be stopped
    LIFT = "lift"  # faster: away from the skin, which nothing stops


@dataclass(frozen=True, slots=True)
class Doubt:
    """Doubt about a force.

    Attributes:
        kind: see the module.
        text: what was read and what was expected, with units.
        before: the last samples that were believed: their times [ns] and all six axes.
        numbers: what was measured and what is allowed, by name with the unit.
    """

    kind: str
    text: str
    before: tuple[tuple[int, Six], ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)


class ForceMonitor:
    """Holds each sample against noise, motion and stiffness. It doubts nothing before it was taught in the
    air.

    Attributes:
        air: what the sensor reads in the air; None before it is learnt.
        corridor: of stiffness, for the tool at hand.
    """

    def __init__(self, bias: ForceBias, limits: Limits, travel: Travel) -> None:
        self._bias, self._limits, self._travel = bias, limits, travel
        self.air: AirNoise | None = None
        self.corridor = StiffnessCorridor()
        self._airs: deque[AirNoise] = deque(maxlen=AIRS)
        self._before: deque[tuple[int, Six]] = deque(maxlen=KEPT)
        self._phase, self._turned_n, self._turned_ns = Phase.STAND, 0.0, 0
        self._ended_ns: int | None = 0
        self._felt: list[tuple[float, float, float]] | None = []
        self.restart()
        self.begin(Phase.STAND, 0.0, 0.0, 0, 0)
        self._ended_ns = 0

    def new_tool(self, stated: StiffnessRange | None = None) -> None:
        """Another tool or skin: what was learnt of stiffness is forgotten, and a stated range counts."""
        self.corridor = StiffnessCorridor(stated)

    def learn_air(self, samples: Sequence[Wrench], stated_hz: float) -> None:
        """Learn noise, quantum and rate from good samples in the air; the press before is learnt from as
        well.
        """
        times = [one.time_ns / NS_PER_S for one in samples]
        check_pace(times, stated_hz)
        air = AirNoise.of(samples, stated_hz)
        if self.air is not None:
            check_same_air(self.air, air)
        if air.is_constant:
            raise constant_air(air, self.air is not None)
        check_fineness(air, self._bias.mounting.normal)
        self.learn_press()
        self._airs.append(air)
        self.air = air
        self._noise_n = self._normal_noise(air)
        self._run_limit = air.run_limit(list(self._airs)[:-1])
        self.restart()
        for one in samples:
            self._dating.late_s(self._count, one.time_ns)
            self._count += 1

    def learn_press(self) -> None:
        """Learn from the way down that went well just now."""
        if self.air is not None:
            self._feel_move()
            self.corridor.learn(self._normal_noise(self.air))

    def forget_press(self) -> None:
        """Forget the way down that is not to be learnt from."""
        self._felt = []
        self.corridor.forget()

    def _feel_move(self) -> None:
        """Take the steps of the last move among those of the press; samples that come later add to them."""
        for step in self._felt or ():
            self.corridor.feel(*step)
        self._felt = None if self._felt is None else []

    def _normal_noise(self, air: AirNoise) -> float:
        return air.noise_n[self._bias.mounting.normal]

    def restart(self) -> None:
        """Forget the samples before: they belong to another time or zero, or were not judged."""
        period_s = self.air.period_s if self.air else 1.0
        self._dating, self._count = SampleDating(1.0 / period_s, heard_s=0.0), 0
        self._six: Six | None = None
        self._six_before: Six | None = None
        self._row, self._row_way_m, self._row_moved = 1, 0.0, 0
        self._time_ns, self._normal_n, self._level_n = 0, 0.0, 0.0
        self._touched, self._moved = False, 0
        self._deficit = self._excess = self._held = 0.0
        self._soft = self._stiff = 0.0  # of the stated range, since contact began
        self._began_touched = self._counts = False
        self._quiet: deque[float] = deque(maxlen=QUIET_SAMPLES)
        self._quiet_sum = 0.0
        self._before.clear()

    def begin(self, phase: Phase, speed_m_s: float, length_m: float, asked_ns: int, sent_ns: int) -> None:
        """A move has begun: how fast and how far [m/s, m], and between which times [ns]."""
        if phase is Phase.LIFT:
            self.restart()
        if self._phase is not phase:
            self._turned_ns = sent_ns + round(TURN_S * NS_PER_S)
        if phase in (Phase.UP, Phase.LIFT) and self._phase is not phase:
            self._touched, self._held, self._turned_n = False, 0.0, self._level_n
        self._phase, self._speed, self._length_m, self._begun_ns = phase, speed_m_s, length_m, sent_ns
        self._asked_ns, self._ended_before_ns = asked_ns, self._ended_ns
        self._sending_s = (sent_ns - asked_ns) / NS_PER_S
        self._way_m, self._ended_ns = 0.0, None
        self._reported_m: float | None = None
        self._feel_move()
        self._felt = []
        self._stood_m: float | None = None
        self._way_felt_m, self._felt_m, self._felt_step_m, self._went = 0.0, 0.0, 0.0, False
        self._is_over = False  # the way is gone, whether or not anybody has seen that the stage stands
        self._climb = ForceClimb()
        self._began_touched = self._counts = self._touched
        self._behind_n = self._held if phase is Phase.UP else self._deficit if self._touched else 0.0

    def reported(self, way_m: float) -> None:
        """Way that the stage says it has gone in this move [m]."""
        self._reported_m = way_m

    def end(self, now_ns: int) -> None:
        """The stage stands."""
        self._ended_ns = now_ns
        if self._phase is Phase.LIFT:
            self._phase = Phase.STAND

    def stood(self, way_m: float) -> None:
        """Way from the start of this move to where the stage stands now [m].

        A stage that was stopped has run on meanwhile, which the samples that are still to come were
        measured on.
        """
        self._stood_m = way_m
        if way_m < self._way_m - SLACK_M:
            self._felt = None  # it began late or paused: where it was at a sample is not known by time

    def arrived(self) -> Doubt | None:
        """Hold what the force changed by in a move against its length, once the stage stands at its target.

        Where the call that sent the stage was blocked, no sample of the move had a way of its own.
        """
        if self._took_longer:
            self._felt = None  # as in `stood`
        if self.air is None or self._climb.from_n is None:
            return None
        from_n, rise_n = self._climb.from_n, self._climb.rise_n
        if self._phase is Phase.UP:
            if self._is_let_go:
                return None
            least = self.corridor.least_n_m(self._level_n) / 2
            self._held = self._behind(self._held, least, rise_n)
            return self._lags("holds", self._held, least)
        if self._began_touched and (doubt := self._outside(self._length_m - self._way_m, 0.0)) is not None:
            return doubt
        if from_n < CONTACT * self._noise_n:
            return None
        if self._way_m == 0 or self._felt is None:
            self._felt = None
            self.corridor.feel(from_n + rise_n / 2, rise_n, self._length_m)
        least = self.corridor.least_between_n_m(from_n, from_n + rise_n)
        self._deficit = self._behind(self._deficit, least, rise_n)
        return self._lags("flat", self._deficit, least)

    def _behind(self, summed_n: float, least_n_m: float, climb_n: float) -> float:
        """Force that is missing after a whole move: by its samples, less what may have gone before the stage
        was sent for certain, or by its length, whichever is more [N].
        """
        by_samples_n = summed_n - least_n_m * self._speed * self._early_s
        return max(by_samples_n, self._behind_n + least_n_m * self._length_m - climb_n, 0.0)

    @property
    def _took_longer(self) -> bool:
        """Whether the move took more time than its length explains."""
        if self._ended_ns is None or self._speed == 0:
            return False
        due_s = self._length_m / self._speed + self._speed / self._travel.acceleration_m_s2
        return (self._ended_ns - self._begun_ns) / NS_PER_S > due_s + LAG_S

    @property
    def _early_s(self) -> float:
        """Time by which the stage may have moved before that was known [s]."""
        return min(self._sending_s, self._length_m / self._speed) if self._speed > 0 else 0.0

    @property
    def oldest_s(self) -> float:
        """Age of the oldest sample on which the move that is under way goes on [s]."""
        if self.air is None or self._ended_ns is not None or self._speed == 0:
            return self._limits.age_s
        return min(self._limits.age_s, max(BLIND_M / self._speed, MIN_PERIODS * self.air.period_s))

    def gap(self, age_s: float) -> Doubt:
        """Doubt about a sensor whose newest sample is so old [s]."""
        text = f"no force came for {age_s * 1e3:.0f} ms at {self._speed * 1e3:g} mm/s"
        return self._doubt("gap", text, age_s=age_s, allowed_s=self.oldest_s)

    def rise(self, start: Force, force: Force, up: bool) -> Doubt:
        """Doubt about a force that rises while the probe moves away, up, or through the air [N]."""
        where = "while moving away" if up else "on the way to the clearance"
        to_n, from_n = math.hypot(*force), math.hypot(*start)
        change_n = math.dist(force, start)
        return self._doubt(
            "rise" if up else "struck",
            f"the force changed by {change_n:.2f} N {where}, from {from_n:.2f} N to {to_n:.2f} N",
        )

    def take(self, sample: Wrench) -> Doubt | None:
        """Hold a good sample against those before, in the order in which they came."""
        if self.air is None or self._phase is Phase.LIFT:
            return None
        six = six_of(sample)
        normal_n = self._bias.force(sample)[2]
        if self._six is None:
            doubt, self._level_n = None, normal_n
            self._count += 1
        else:
            doubt = self._test(sample.time_ns, six, normal_n)
        self._six_before, self._six = self._six, six
        self._time_ns, self._normal_n = sample.time_ns, normal_n
        if doubt is None:
            self._before.append((sample.time_ns, six))
        return doubt

    def _test(self, time_ns: int, six: Six, normal_n: float) -> Doubt | None:
        phase, step_m = self._step(time_ns)
        level_before_n = self._level_n
        self._level_n += SMOOTH * (normal_n - self._level_n)
        if time_ns < self._turned_ns:
            self._level_n = level_before_n = normal_n
        return (
            self._late(time_ns)
            or self._repeats(six, step_m)
            or self._jump(time_ns, normal_n, phase)
            or self._way(phase, step_m, self._level_n - level_before_n, time_ns)
            or self._quietened(six)
        )

    def _step(self, time_ns: int) -> tuple[Phase, float]:
        """What the stage does at a sample's time, and how far it went since the last one [m]."""
        # A busy computer takes in samples of the stand before this move only once it has begun.
        ended_ns = self._ended_before_ns if time_ns < self._asked_ns else self._ended_ns
        if ended_ns is not None and time_ns > ended_ns + LAG_S * NS_PER_S:
            self._felt_step_m = 0.0
            return Phase.STAND, 0.0
        gone_s = max(time_ns - self._begun_ns, 0) / NS_PER_S
        v, a = self._speed, self._travel.acceleration_m_s2
        way_m = a * gone_s**2 / 2 if gone_s * a < v else v * gone_s - v**2 / (2 * a)
        way_m = min(way_m, self._length_m)
        if self._reported_m is not None:
            way_m = min(way_m, self._reported_m + v * REPORT_S)
        felt_m = way_m if self._ended_ns is None else min(way_m, self._stood_m or 0.0)
        self._felt_step_m = self._smoothed_step(felt_m, time_ns)
        step_m = max(way_m - self._way_m, 0.0) if self._ended_ns is None else 0.0
        self._way_m += step_m
        self._is_over = step_m == 0.0 and v * (gone_s - v / a - LAG_S) > self._length_m <= self._way_m
        return self._phase, step_m

    def _smoothed_step(self, way_m: float, time_ns: int) -> float:
        """Step of the way after the same mean as the force, so that what is learnt lags alike in both [m]."""
        self._went = way_m > self._way_felt_m
        self._way_felt_m = max(self._way_felt_m, way_m)
        weight = 1.0 if time_ns < self._turned_ns else SMOOTH
        step_m = weight * (self._way_felt_m - self._felt_m)
        self._felt_m += step_m
        return step_m

    def _late(self, time_ns: int) -> Doubt | None:
        late_s = self._dating.late_s(self._count, time_ns)
        self._count += 1
        if late_s <= self.oldest_s:
            return None
        return self._doubt(
            "late",
            f"a force came {late_s * 1e3:.0f} ms after its turn; {self.oldest_s * 1e3:.0f} ms are allowed",
            late_s=late_s,
            allowed_s=self.oldest_s,
        )

    def _repeats(self, six: Six, step_m: float) -> Doubt | None:
        if six != self._six:
            self._row, self._row_way_m, self._row_moved = 1, 0.0, 0
            return None
        self._row += 1
        self._row_way_m += step_m
        self._row_moved += step_m > 0
        if self._is_coarse and self._level_n > CONTACT * self._noise_n:
            row, limit = self._row_moved, self._pressed_limit()
        else:
            row, limit = self._row, self._run_limit
        if row < limit:
            return None
        return self._doubt("repeats", f"{self._row} samples in a row are the same on all six axes")

    def _pressed_limit(self) -> int:
        """Equal samples on the move that are no chance any more, of a coarse sensor that is pressed."""
        due_n = self.corridor.least_n_m(self._level_n) * self._row_way_m
        air = self.air
        if air is None or due_n <= air.quantum_n:
            return 3 * self._run_limit
        return max(MIN_TURN, self._run_limit // 2, math.ceil(LAG_S / air.period_s))

    @property
    def _is_coarse(self) -> bool:
        return self.air is not None and not all(self.air.fine)

    def _jump(self, time_ns: int, normal_n: float, phase: Phase) -> Doubt | None:
        rise_n = normal_n - self._normal_n
        if abs(rise_n) <= JUMP * self._noise_n:
            return None
        force_n = max(abs(normal_n), abs(self._normal_n))
        share = SLIDE_SHARE if phase is Phase.ASIDE else JUMP_SHARE
        period_s = self.air.period_s  # type: ignore[union-attr]
        due_s = max(time_ns - self._time_ns, 0) / NS_PER_S + 2 * period_s
        way_m = 0.0 if phase is Phase.STAND else self._speed * due_s
        stiff = self.corridor.greatest_n_m(max(normal_n, self._normal_n, CONTACT * self._noise_n))
        allowed_n = JUMP * self._noise_n + share * min(abs(normal_n), abs(self._normal_n)) + stiff * way_m
        if abs(rise_n) <= allowed_n or force_n == 0:
            return None
        return self._doubt(
            "jump",
            f"the normal force went from {self._normal_n:.3f} to {normal_n:.3f} N from one sample to the "
            f"next, over at most {way_m * 1e3:.3f} mm of way",
        )

    def _way(self, phase: Phase, step_m: float, rise_n: float, time_ns: int) -> Doubt | None:
        """Hold the force against the way: it rises on the way down and falls on the way up."""
        noise_n, level_n = self._noise_n, self._level_n
        sent = time_ns >= self._begun_ns  # before, nobody knows whether the stage moved already
        if phase in (Phase.UP, Phase.DOWN) and time_ns >= self._asked_ns:
            self._climb.take(-level_n if phase is Phase.UP else level_n)
        if phase is Phase.UP:
            return None if self._is_over else self._on_the_way_back(step_m, rise_n, sent)
        if self._touched and level_n < GONE * noise_n:
            return self._doubt("lost", f"the force fell to {level_n:.3f} N though nothing moved away")
        if phase is not Phase.DOWN:
            return None
        if not self._touched:
            if level_n < -(PULLED_COARSE if self._is_coarse else PULLED) * noise_n:
                return self._doubt("pull", f"the probe goes down and is pulled by {-level_n:.3f} N")
            self._touched = level_n > CONTACT * noise_n
            self._deficit = self._excess = self._soft = self._stiff = 0.0
            self._moved = 0
            self._counts = sent
            return None
        return None if self._is_over else self._on_the_way_down(step_m, rise_n, sent)

    def _on_the_way_down(self, step_m: float, rise_n: float, sent: bool) -> Doubt | None:
        """Hold a sample's rise against its way; before the stage was `sent` for certain, only an excess."""
        force_n = max(self._level_n, CONTACT * self._noise_n)
        self._moved += self._went
        least, greatest = self.corridor.least_n_m(force_n), self.corridor.greatest_n_m(force_n)
        self._excess = max(self._excess + rise_n - greatest * step_m, 0.0)
        if not sent:
            self._deficit = max(self._behind_n - self._climb.rise_n, 0.0)
        else:
            self._feel(force_n, rise_n)
            self._deficit = max(self._deficit + least * step_m - rise_n, 0.0)
        if (
            doubt := self._outside(step_m, rise_n) or self._lags("flat", self._deficit, least, self._early_s)
        ) is not None:
            return doubt
        if self._excess > self._slack_n(EXCESS, greatest, self._sending_s):
            return self._doubt(
                "steep", f"{self._level_n:.3f} N rises more steeply on the way down than it did before"
            )
        return None

    def _feel(self, force_n: float, rise_n: float) -> None:
        """Keep a sample's rise and way to learn from; none once the stage stands where nobody said."""
        is_known = self._ended_ns is None or self._stood_m is not None
        # The mean lags: what rises first belongs to the way before contact.
        if self._felt is not None and is_known and self._moved > SETTLED:
            self._felt.append((force_n, rise_n, self._felt_step_m))

    def _outside(self, way_m: float, rise_n: float) -> Doubt | None:
        """Hold the rise of force since contact began against the range of stiffness that the rig states."""
        least, greatest = self.corridor.stated_n_m(self._level_n)
        if not self._counts or least == 0:
            return None
        self._soft += least * way_m - rise_n
        self._stiff += rise_n - greatest * way_m
        early_s = self._early_s
        for kind, sum_n, bound, noises in (
            ("soft", self._soft, least, DEFICIT),
            ("stiff", self._stiff, greatest, EXCESS),
        ):
            if sum_n > (slack_n := self._slack_n(noises, bound, early_s)):
                return self._doubt(
                    kind,
                    f"at {self._level_n:.3f} N the force rises {'less' if kind == 'soft' else 'more'} with "
                    f"depth than the {least * 1e-3:.3g} to {greatest * 1e-3:.3g} N/mm that the rig states",
                    force_N=self._level_n,
                    beyond_N=sum_n,
                    allowed_N=slack_n,
                    least_N_mm=least * 1e-3,
                    greatest_N_mm=greatest * 1e-3,
                )
        return None

    def _lags(self, kind: str, behind_n: float, least_n_m: float, early_s: float = 0.0) -> Doubt | None:
        """Doubt about a force that follows less than the least stiffness, down or back."""
        if behind_n <= self._slack_n(DEFICIT, least_n_m, early_s):
            return None
        does = "rise on the way down" if kind == "flat" else "fall on the way back"
        return self._doubt(kind, f"{self._level_n:.3f} N does not {does} as it did before")

    def _on_the_way_back(self, step_m: float, rise_n: float, sent: bool) -> Doubt | None:
        if self._is_let_go:
            self._held = 0.0
            return None
        least = self.corridor.least_n_m(self._level_n) / 2
        summed_n = self._held + least * step_m + rise_n if sent else self._behind_n - self._climb.rise_n
        self._held = max(summed_n, 0.0)
        return self._lags("holds", self._held, least, self._early_s)

    @property
    def _is_let_go(self) -> bool:
        """Whether so little force is left on the way back that it need not fall any more."""
        return self._level_n < max(HELD * self._noise_n, HELD_SHARE * self._turned_n)

    def _slack_n(self, noises: float, stiffness_n_m: float, early_s: float = 0.0) -> float:
        """Force by which it may differ from a stiffness: noise, and what stage and sensor are late by [N]."""
        v, travel = self._speed, self._travel
        late_s = max(self.air.period_s if self.air else 0.0, self._limits.force_latency_s)
        slack_m = SLACK_M + v * (travel.latency_s + late_s + early_s) + v**2 / (2 * travel.acceleration_m_s2)
        return noises * self._noise_n + stiffness_n_m * slack_m + SLACK_SHARE * self._level_n

    def _quietened(self, six: Six) -> Doubt | None:
        """Hold the noise against that of the air, by second differences, which no steady motion makes."""
        if self._six is None or self._six_before is None or self.air is None or not any(self.air.fine):
            return None
        energy, axes = 0.0, 0
        for i in range(3):
            if self.air.fine[i]:
                second = six[i] - 2 * self._six[i] + self._six_before[i]
                energy += second * second / (6 * self.air.noise_n[i] ** 2)
                axes += 1
        if len(self._quiet) == QUIET_SAMPLES:
            self._quiet_sum -= self._quiet[0]
        self._quiet.append(energy / axes)
        self._quiet_sum += energy / axes
        if len(self._quiet) < QUIET_SAMPLES or self._quiet_sum >= QUIET * QUIET_SAMPLES:
            return None
        share = math.sqrt(max(self._quiet_sum, 0.0) / QUIET_SAMPLES)
        return self._doubt("quiet", f"the noise has fallen to {share:.2f} of what it was in the air")

    def _doubt(self, kind: str, text: str, **numbers: float) -> Doubt:
        return Doubt(kind, text, tuple(self._before), numbers)
