"""What a force sensor's noise, rate and stiffness under it say of whether it can be believed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import NS_PER_S, RangeError, Travel, Wrench
from palpate.devices import ForceBias, Limits, Reason, Tripped
from palpate.devices.force_trust import AirNoise, ForceMonitor, Phase, SampleDating, StiffnessCorridor
from palpate.devices.force_trust.air_noise import CHANCE, CHANCE_COARSE, MIN_RUN, period_of
from palpate.devices.force_trust.stiffness_corridor import WIDE_HIGH, WIDE_LOW, ForceClimb

TRAVEL = Travel((-20e-3,) * 3, (20e-3,) * 3, 50e-3, 0.5, 0.004)
LIMITS = Limits((-15e-3,) * 3, (15e-3,) * 3)
BIAS = np.array([0.31, -0.22, 1.7])
HZ = 200.0


def air(
    rng, count: int = 60, noise: float = 0.005, quantum: float = 1 / 320, scale: float = 1.0
) -> list[Wrench]:
    """Samples without contact, as a sensor of such a noise and quantum gives them."""
    force = scale * (BIAS + noise * rng.standard_normal((count, 3)))
    if quantum:
        force = np.round(force / quantum) * quantum
    return [Wrench(round(i / HZ * NS_PER_S), (x, y, z)) for i, (x, y, z) in enumerate(force.tolist())]


def monitor(samples: list[Wrench]) -> ForceMonitor:
    bias = ForceBias()
    made = ForceMonitor(bias, LIMITS, TRAVEL)
    bias.measure(samples)
    made.learn_air(samples, HZ)
    return made


def test_the_air_tells_noise_quantum_and_period(rng) -> None:
    learnt = AirNoise.of(air(rng, 4000, noise=0.02, quantum=0.01))
    assert learnt.quantum_n == pytest.approx(0.01)
    assert learnt.noise_n == pytest.approx((math.hypot(0.02, 0.01 / math.sqrt(12)),) * 3, rel=0.05)
    assert learnt.period_s == pytest.approx(1 / HZ, rel=1e-9)
    assert all(learnt.fine)


@pytest.mark.parametrize(("noise", "quantum"), [(0.005, 1 / 320), (0.02, 0.0625), (0.004, 0.01)])
def test_a_row_of_equal_samples_that_noise_makes_is_no_fault_and_a_dead_sensor_is_one_soon(
    rng, noise: float, quantum: float
) -> None:
    learnt = AirNoise.of(air(rng, 200, noise, quantum))
    later = AirNoise.of(air(rng, 20_000, noise, quantum))
    limit = learnt.run_limit()
    assert later.longest < limit
    shares = (later.repeats + 1) / later.count
    # Twice the row of the chance that is borne, and not more than that of twice the share of repeats.
    assert limit <= max(
        MIN_RUN,
        2 * learnt.longest,
        math.ceil(
            math.log(CHANCE if all(learnt.fine) else CHANCE_COARSE) / math.log(min(2 * shares + 0.03, 0.9))
        ),
    )


def test_a_sensor_that_repeats_all_in_the_air_is_dead_and_one_that_did_not_before_is_stuck(rng) -> None:
    same = [Wrench(round(i / HZ * NS_PER_S), (0.31, -0.22, 1.7)) for i in range(60)]
    with refused("force-dead", Tripped):
        monitor(same)
    alive = monitor(air(rng))
    with pytest.raises(Tripped) as now:
        alive.learn_air(same, HZ)
    assert now.value.reason is Reason.FORCE_STUCK
    one_axis = [Wrench(one.time_ns, one.force_n, (0.0, 0.0, 1e-4 * (i % 2))) for i, one in enumerate(same)]
    assert not AirNoise.of(one_axis).is_constant, "a single axis that moves is a sensor that measures"


@pytest.mark.parametrize(
    ("sent_hz", "trips"), [(HZ, False), (0.9 * HZ, False), (0.7 * HZ, True), (20.0, True)]
)
def test_a_sensor_slower_than_it_states_is_refused_in_the_air(rng, sent_hz: float, trips: bool) -> None:
    samples = [Wrench(round(i / sent_hz * NS_PER_S), one.force_n) for i, one in enumerate(air(rng))]
    if not trips:
        assert monitor(samples).air is not None
        return
    with pytest.raises(Tripped, match=f"states {HZ:g}") as caught:
        monitor(samples)
    assert caught.value.reason is Reason.FORCE_SLOW


@pytest.mark.parametrize(("scale", "trips"), [(1.0, False), (0.1, True), (0.9, True), (10.0, True)])
def test_a_scale_that_changed_between_two_zeros_is_told(rng, scale: float, trips: bool) -> None:
    learnt = monitor(air(rng))
    after = air(rng, scale=scale)
    if not trips:
        learnt.learn_air(after, HZ)
        return
    with refused("force-scaled", Tripped) as caught:
        learnt.learn_air(after, HZ)
    assert caught.value.reason is Reason.FORCE_SCALED


@pytest.mark.parametrize("far_n", [0.4, -0.4, 1.7])
def test_a_zero_that_drifts_along_the_greatest_axis_alone_is_no_change_of_scale(rng, far_n: float) -> None:
    aside = np.array([0.02, -0.015, 1.7]) - BIAS

    def drifted(by_n: float) -> list[Wrench]:
        moved = [np.array(one.force_n) + aside + (0, 0, by_n) for one in air(rng)]
        return [
            Wrench(round(i / HZ * NS_PER_S), (x, y, z))
            for i, (x, y, z) in enumerate(map(np.ndarray.tolist, moved))
        ]

    made = monitor(drifted(0.0))
    made.learn_air(drifted(far_n), HZ)


def arrivals(rng, count: int, hold_s: float = 0.0, hz: float = HZ) -> np.ndarray:
    """Stamps of arrival [s] of samples that are sent evenly, with a jitter of 0.2 ms; held back from 5 s
    on."""
    sent = np.arange(count) / hz
    came = sent + 2e-3 + 2e-4 * rng.random(count)
    late = sent > 5.0
    return np.where(late & (hold_s > 0), np.ceil(sent / max(hold_s, 1e-9)) * hold_s + 2e-3, came)


def test_samples_that_were_held_back_are_as_old_as_they_are(rng) -> None:
    """Dated to a few milliseconds, of up to 80; a box that states 1.4 % less than it sends is learnt."""
    came = arrivals(rng, 4000, hold_s=0.08)
    dating = SampleDating(HZ / 1.014)
    dated = np.array([dating.date_ns(i, round(t * NS_PER_S)) for i, t in enumerate(came)]) / NS_PER_S
    true = np.arange(4000) / HZ + 2e-3
    known = true > 3.0
    # The least delay is forgotten by 1 % of the time since, 0.8 ms from burst to burst.
    assert np.abs(dated - true)[known].max() < 4e-3
    assert np.abs(came - true)[known].max() > 0.07, "by their arrival they would be late by the whole"


def test_samples_in_time_are_never_late(rng) -> None:
    dating = SampleDating(HZ)
    late = [dating.late_s(i, round(t * NS_PER_S)) for i, t in enumerate(arrivals(rng, 20_000))]
    assert max(late) < 2e-3


def taught(slope: float, presses: int = 3, noise: float = 0.005) -> StiffnessCorridor:
    """A corridor of a skin whose stiffness is the slope [1/m] times the force: exponential in depth."""
    made = StiffnessCorridor()
    for _ in range(presses):
        for force in np.geomspace(0.05, 2.0, 200):
            made.feel(float(force), 1e-2 * force, 1e-2 / slope)
        made.learn(noise)
    return made


def spring(stiffness_n_m: float) -> StiffnessCorridor:
    """A corridor of a skin that is as stiff at any force."""
    made = StiffnessCorridor()
    for force in np.geomspace(0.05, 2.0, 200):
        made.feel(float(force), 1e-2 * force, 1e-2 * force / stiffness_n_m)
    made.learn(0.005)
    return made


def test_the_corridor_lies_about_what_was_felt_and_goes_on_beyond_it() -> None:
    made = taught(1000.0)
    for force in (0.1, 0.7, 1.5):
        stiffness = 1000.0 * force
        assert made.least_n_m(force) < stiffness < made.greatest_n_m(force)
        # Within a factor of two in force the median is one number.
        assert made.least_n_m(force) == pytest.approx(stiffness / WIDE_LOW, rel=0.5)
        assert made.greatest_n_m(force) < 3 * stiffness * WIDE_HIGH
    assert made.least_n_m(50.0) == made.least_n_m(1.5), "beyond, a skin may go on as a spring"
    assert made.greatest_n_m(50.0) > 50.0 / 2.0 * made.greatest_n_m(1.5) / 2, "or stiffen with its force"


@pytest.mark.parametrize(("asked_s", "doubted"), [(2.6, False), (None, False), (1.55, True)])
def test_a_skin_that_relaxes_at_a_stand_is_no_doubt_however_late_its_samples_are_taken_in(
    rng, asked_s: float | None, doubted: bool
) -> None:
    """A press to 1 N, which falls to 0.7 N at a stand; all of that is taken in when the next step has begun,
    or before anybody has seen that the press is over.

    If that step had begun first, the same samples would be of a tool that does not hold.
    """
    made = monitor(air(rng))
    made.corridor = taught(1000.0)
    zero = BIAS + 0.0

    def read(time_s: float, normal_n: float) -> Wrench:
        x, y, z = zero + (0, 0, normal_n) + 0.005 * rng.standard_normal(3)
        return Wrench(round(time_s * NS_PER_S), (x, y, z))

    def at(seconds: float) -> int:
        return round(seconds * NS_PER_S)

    made.begin(Phase.DOWN, 4e-3, 4.8e-3, at(0.3), at(0.3))
    for one in np.arange(0.3, 1.5, 1 / HZ):
        assert made.take(read(one, math.exp(4.0 * (one - 1.5)))) is None
    if asked_s is not None:
        made.end(at(1.5))
        made.begin(Phase.DOWN, 4e-3, 4e-3, at(asked_s), at(asked_s))
    stood = np.arange(1.5, 2.5, 1 / HZ)
    doubts = [made.take(read(one, 1.0 - 0.3 * (one - 1.5))) for one in stood]
    assert any(doubts) == doubted
    if doubted:
        assert next(filter(None, doubts)).kind == "flat"


def test_force_that_rises_while_the_stage_runs_on_after_a_stop_is_learnt_with_its_way(rng) -> None:
    """A touch on 4 N/mm, after which the stage runs on by 60 ms; all of that is taken in after the stop.

    Without the way of it, the skin would seem to be many times as stiff.
    """
    made, speed, stiff = monitor(air(rng)), 2e-3, 4000.0

    def press(begin_s: float, until_s: float, stop_s: float) -> None:
        for one in np.arange(begin_s, until_s, 1 / HZ):
            gone_m = max(min(one, stop_s) - 1.0, 0.0) * speed
            x, y, z = BIAS + (0, 0, stiff * gone_m) + 0.005 * rng.standard_normal(3)
            assert made.take(Wrench(round(one * NS_PER_S), (x, y, z))) is None

    made.begin(Phase.DOWN, speed, 1e-3, round(1.0 * NS_PER_S), round(1.0 * NS_PER_S))
    press(0.3, 1.04, stop_s=1.1)
    made.end(round(1.13 * NS_PER_S))
    made.stood(0.2 * speed)
    press(1.04, 1.3, stop_s=1.1)
    made.learn_press()
    assert made.corridor._median
    for force_n in (0.1, 0.2, 0.4):
        assert made.corridor.least_n_m(force_n) * WIDE_LOW == pytest.approx(stiff, rel=0.5)


def test_a_move_in_which_the_stage_paused_teaches_as_a_whole(rng) -> None:
    """From 1 to 1.8 N in 0.2 mm, with a pause of 100 ms in the middle: by time the second half has no way."""
    made, speed = monitor(air(rng)), 2e-3
    made.corridor = spring(4000.0)
    begin_s, end_s = 1.0, 1.21
    made.begin(Phase.DOWN, 0.5e-3, 0.25e-3, round(0.3 * NS_PER_S), round(0.3 * NS_PER_S))
    for one in np.arange(0.3, begin_s, 1 / HZ):
        force = BIAS + (0, 0, 4000.0 * min(0.5 * (one - 0.3), 0.25) * 1e-3) + 0.005 * rng.standard_normal(3)
        made.take(Wrench(round(one * NS_PER_S), tuple(force)))
    made.end(round(begin_s * NS_PER_S))
    made.forget_press()
    made.begin(Phase.DOWN, speed, 0.2e-3, round(begin_s * NS_PER_S), round(begin_s * NS_PER_S))
    for one in np.arange(begin_s, end_s, 1 / HZ):
        gone_s = min(one - begin_s, 0.05) + max(one - begin_s - 0.15, 0.0)
        force = BIAS + (0, 0, 1.0 + 4000.0 * min(gone_s * speed, 0.2e-3)) + 0.005 * rng.standard_normal(3)
        assert made.take(Wrench(round(one * NS_PER_S), tuple(force))) is None
    made.end(round(end_s * NS_PER_S))
    made.stood(0.2e-3)
    assert made.arrived() is None
    made.learn_press()
    assert made.corridor.least_n_m(1.2) * WIDE_LOW == pytest.approx(4000.0, rel=0.3)
    assert made.corridor.greatest_n_m(1.0) / WIDE_HIGH == pytest.approx(4000.0, rel=0.3)


def test_a_force_felt_over_less_way_than_the_stage_s_slack_teaches_nothing() -> None:
    """The mean still catches up after a stop: 14 mN over 3 um are no stiffness of 4.5 N/mm."""
    made = spring(1000.0)
    made.feel(0.05, 13.6e-3, 3e-6)
    made.learn(2e-3)
    assert made.greatest_n_m(0.05) < 4.6e3
    assert made.least_n_m(0.05) * WIDE_LOW <= 1000.0


def test_a_whole_move_is_held_against_the_least_stiffness_between_its_forces() -> None:
    corridor = StiffnessCorridor()
    for force, stiff in ((0.2, 3000.0), (0.4, 1000.0), (0.8, 5000.0)):
        corridor.feel(force, 0.5 * force, 0.5 * force / stiff)
    corridor.learn(0.001)
    assert corridor.least_n_m(0.2) > 2 * corridor.least_between_n_m(0.2, 0.9)
    assert corridor.least_between_n_m(0.2, 0.9) == pytest.approx(corridor.least_n_m(0.25))
    assert corridor.least_between_n_m(0.8, 0.8) == corridor.least_n_m(0.8)


def test_a_sensor_far_coarser_than_its_noise_is_refused_in_the_air(rng) -> None:
    samples = air(rng, 150, noise=0.1e-3)
    flickers = [
        replace(one, force_n=(BIAS[0] + 0.003 * (i % 2), *one.force_n[1:])) for i, one in enumerate(samples)
    ]
    with refused("force-coarse", Tripped):
        monitor(flickers)


def test_a_coarse_sensor_that_repeats_itself_while_it_is_pressed_at_a_stand_is_not_stuck(rng) -> None:
    made, speed = monitor(air(rng, 150, noise=1e-3, quantum=4e-3)), 2e-3
    assert made.air is not None
    assert not all(made.air.fine)
    made.corridor = spring(4000.0)
    x, y, z = (np.round((BIAS + np.array((0, 0, 1.0))) / 4e-3) * 4e-3).tolist()

    def doubt(begin_s: float, end_s: float) -> float | None:
        for one in np.arange(begin_s, end_s, 1 / HZ):
            if made.take(Wrench(round(one * NS_PER_S), (x, y, z))) is not None:
                return float(one)
        return None

    made.begin(Phase.DOWN, speed, 0.2e-3, round(0.75 * NS_PER_S), round(0.75 * NS_PER_S))
    for one in np.arange(0.75, 1.0, 1 / HZ):
        made.take(Wrench(round(one * NS_PER_S), (x, y, z - (1.0 - one) * 4.0)))
    made.end(round(1.0 * NS_PER_S))
    assert doubt(1.0, 10.0) is None
    made.begin(Phase.DOWN, speed, 0.2e-3, round(10.0 * NS_PER_S), round(10.0 * NS_PER_S))
    stuck_s = doubt(10.0, 10.2)
    assert stuck_s is not None
    assert stuck_s < 10.07


@pytest.mark.parametrize(
    ("forces", "rise"),
    [((3.0, 2.0, 2.5, 1.0), 0.5), ((1.0, 0.4, 2.0, 1.5), 1.6), ((3.0, 2.0, 1.0), 0.0), ((2.0,), 0.0)],
)
def test_a_climb_is_from_any_force_to_a_later_one(forces: tuple[float, ...], rise: float) -> None:
    climb = ForceClimb()
    for one in forces:
        climb.take(one)
    assert (climb.from_n, climb.rise_n) == (forces[0], pytest.approx(rise))


def test_a_press_that_is_forgotten_teaches_nothing() -> None:
    made = StiffnessCorridor()
    made.feel(1.0, 1.0, 1e-3)
    made.forget()
    made.learn(0.005)
    assert not made._median
    assert made.least_n_m(1.0) == 0.0


def test_a_limit_above_the_sensors_range_is_refused_with_both_numbers() -> None:
    Limits((-1.0,) * 3, (1.0,) * 3, force_n=30.0).check_range(30.0)
    with refused("limit-above-sensor", RangeError, match=r"1e\+09"):
        Limits((-1.0,) * 3, (1.0,) * 3, force_n=1e9).check_range(30.0)


class TestPeriod:
    """The time between two samples is the sensor's own, whatever the line does to their stamps."""

    def stamps(self, hz: float, n: int = 60, piece_s: float = 0.0, stall_s: float = 0.0) -> np.ndarray:
        times = 100.0 + np.arange(n) / hz
        if stall_s:
            times = np.maximum(times, times[0] + stall_s)
        return np.ceil(times / piece_s) * piece_s if piece_s else times

    @pytest.mark.parametrize("hz", [80.0, 200.0, 1000.0])
    @pytest.mark.parametrize("piece_s", [0.0, 0.01, 0.016])
    def test_a_line_that_delivers_in_pieces_changes_no_rate(self, hz: float, piece_s: float) -> None:
        assert period_of(self.stamps(hz, round(0.3 * hz) + 5, piece_s), hz) == 1 / hz

    @pytest.mark.parametrize("stall_s", [0.02, 0.05, 0.08, 0.2])
    def test_what_a_stall_held_back_changes_no_rate(self, stall_s: float) -> None:
        assert period_of(self.stamps(200.0, 60, stall_s=stall_s), 200.0) == 1 / 200

    @pytest.mark.parametrize("share", [0.9, 0.97, 1.03])
    def test_a_rate_that_is_another_than_stated_is_the_one_that_counts(self, share: float) -> None:
        assert period_of(self.stamps(200.0 * share), 200.0) == pytest.approx(1 / (200 * share), rel=1e-6)
