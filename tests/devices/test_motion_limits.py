"""The rig's limits: what is inside is let pass, to the last digit, and what is outside is refused."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
from tests.refusals import refused

from palpate.core.device_protocols import Travel
from palpate.core.errors import RangeError
from palpate.devices.motion_limits import Limits, Reason, Tripped

LOW, HIGH = (-10e-3, -8e-3, -5e-3), (10e-3, 8e-3, 6e-3)
LIMITS = Limits(LOW, HIGH, overshoot_m=0.1e-3)


def travel(top_speed_m_s: float = 1.0, low=LOW, high=HIGH, latency_s: float = 0.01) -> Travel:
    return Travel(low, high, top_speed_m_s, 0.2, latency_s)


@pytest.mark.parametrize("force_s", [1e-9, 0.01, 0.1])
@pytest.mark.parametrize("latency_s", [0.0, 0.01, 0.1])
def test_the_fastest_speed_runs_on_by_just_what_is_allowed(latency_s: float, force_s: float) -> None:
    stage, limits = travel(latency_s=latency_s), replace(LIMITS, force_latency_s=force_s)
    fastest = limits.fastest_m_s(stage)
    runs_on = fastest * force_s + fastest * latency_s + fastest**2 / (2 * 0.2)
    assert runs_on == pytest.approx(LIMITS.overshoot_m, rel=1e-9)
    limits.check_speed(fastest * (1 - 1e-9), stage)
    with pytest.raises(Tripped, match="runs on") as caught:
        limits.check_speed(fastest * (1 + 1e-6), stage)
    assert caught.value.reason is Reason.TOO_FAST


def test_the_fastest_speed_is_no_more_than_the_stage_s_own() -> None:
    assert LIMITS.fastest_m_s(travel(1e-4)) == 1e-4


@pytest.mark.parametrize("speed", [0.0, -1e-3, math.nan, math.inf])
def test_a_speed_that_is_none_is_refused(speed: float) -> None:
    with refused("too-fast", Tripped):
        LIMITS.check_speed(speed, travel())


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_target_is_let_pass_to_the_limits_and_refused_beyond(axis: int) -> None:
    def target(value: float) -> tuple[float, ...]:
        return tuple(value if k == axis else 0.0 for k in range(3))

    for inside in (LOW[axis], 0.0, HIGH[axis]):
        LIMITS.check_target(target(inside))
    for outside in (LOW[axis] - 1e-9, HIGH[axis] + 1e-9, math.nan):
        with pytest.raises(Tripped, match=f"^{'xyz'[axis]} = ") as caught:
            LIMITS.check_target(target(outside))
        assert caught.value.reason is Reason.SOFT_LIMIT


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_soft_limits_lie_within_the_travel(axis: int) -> None:
    def moved(end, by: float) -> tuple[float, ...]:
        return tuple(value + by * (k == axis) for k, value in enumerate(end))

    LIMITS.check_within(travel())
    LIMITS.check_within(travel(low=moved(LOW, -1e-3), high=moved(HIGH, 1e-3)))
    for narrow in (travel(low=moved(LOW, 1e-6)), travel(high=moved(HIGH, -1e-6))):
        with refused("limits-outside-travel", RangeError, match=f"of {'xyz'[axis]}"):
            LIMITS.check_within(narrow)


@pytest.mark.parametrize(
    "name",
    ["force_n", "force_rate_n_s", "rate_window_s", "age_s", "force_latency_s", "overshoot_m", "step_m"],
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_limit_that_is_none_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(RangeError, match=f"limit {name} is"):
        Limits(LOW, HIGH, **{name: value})


@pytest.mark.parametrize("ends", [(1e-3, 1e-3), (2e-3, 1e-3), (math.nan, 1e-3), (-1e-3, math.inf)])
def test_soft_limits_that_enclose_nothing_are_refused(ends) -> None:
    with refused("limits-order", RangeError):
        Limits((LOW[0], ends[0], LOW[2]), (HIGH[0], ends[1], HIGH[2]))


def sensor(rate_hz: float, **also: float) -> SimpleNamespace:
    return SimpleNamespace(rate_hz=rate_hz, **also)


def test_a_force_sensor_guards_only_if_its_newest_sample_is_never_older_than_allowed() -> None:
    LIMITS.check_sensor(sensor(10.0 + 1e-9))  # a period of 0.1 s is what age_s allows
    LIMITS.check_sensor(sensor(80.0, delay_s=0.05))
    LIMITS.check_sensor(object())  # states no rate
    for slow in (sensor(9.9), sensor(80.0, delay_s=0.09), sensor(10.0, delay_s=0.4)):
        with refused("force-stale", Tripped) as caught:
            LIMITS.check_sensor(slow)
        assert caught.value.reason is Reason.FORCE_STALE
