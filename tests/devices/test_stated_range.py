"""A press is held against the stated range of stiffness, also where it is known late that it was sent."""

import pytest
from tests.devices.test_force_trust import BIAS, HZ, air, monitor

from palpate.core import NS_PER_S, Wrench
from palpate.devices.force_trust import Phase, StiffnessRange

SPEED_M_S, STEP_M = 2e-3, 0.2e-3
STIFFNESS_N_M = 1000.0
RANGE = StiffnessRange((0.25, 8.0), (800.0, 800.0), (1250.0, 1250.0))


def pressed(rng, gain: float, sending_s: float, depth_m: float = 4e-3) -> tuple[str, float]:
    """Press in steps onto a spring; what was doubted, and how deep it was then [m]."""
    samples = air(rng)
    made = monitor(samples)
    made.new_tool(RANGE)
    now_ns, z = samples[-1].time_ns, -0.3e-3
    period_ns = round(NS_PER_S / HZ)
    while z < depth_m:
        asked_ns, start = now_ns, z
        lasts_ns = round(STEP_M / SPEED_M_S * NS_PER_S)
        sent_ns = asked_ns + round(sending_s * NS_PER_S)
        made.begin(Phase.DOWN, SPEED_M_S, STEP_M, asked_ns, sent_ns)
        ends_ns = max(asked_ns + lasts_ns, sent_ns)
        while now_ns < ends_ns:
            now_ns += period_ns
            z = start + min((now_ns - asked_ns) / lasts_ns, 1.0) * STEP_M
            force_n = gain * STIFFNESS_N_M * max(z, 0.0)
            x, y, normal = (BIAS + 0.005 * rng.standard_normal(3)).tolist()
            if (doubt := made.take(Wrench(now_ns, (x, y, normal + force_n)))) is not None:
                return doubt.kind, z
        made.end(now_ns)
        if (doubt := made.arrived()) is not None:
            return doubt.kind, z
    return "", z


@pytest.mark.parametrize("sending_s", [0.0, 0.02, 0.06, 0.15])
@pytest.mark.parametrize("gain", [0.9, 1.0, 1.1])
def test_a_gain_inside_the_range_is_believed(rng, gain: float, sending_s: float) -> None:
    assert pressed(rng, gain, sending_s)[0] == ""


@pytest.mark.parametrize("sending_s", [0.0, 0.02, 0.06, 0.15])
@pytest.mark.parametrize(("gain", "kind"), [(0.5, "soft"), (2.0, "stiff")])
def test_a_gain_of_a_half_or_two_is_doubted_within_a_millimetre(
    rng, gain: float, kind: str, sending_s: float
) -> None:
    found, at_m = pressed(rng, gain, sending_s)
    assert found == kind
    assert at_m < 0.25e-3 / gain + 1e-3


def test_without_a_range_neither_is_doubted(rng, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.devices.test_stated_range.RANGE", None)
    assert [pressed(rng, gain, 0.0)[0] for gain in (0.5, 2.0)] == ["", ""]
