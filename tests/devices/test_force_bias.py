"""A sensor's own axes and bias are taken off: what is left is the force and torque on the skin."""

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core.device_protocols import Wrench
from palpate.core.errors import RangeError
from palpate.devices.force_bias import MIN_SAMPLES, ForceBias, Mounting
from palpate.devices.motion_limits import Reason, Tripped

FORCE, TORQUE = np.array([0.3, -0.2, 1.5]), np.array([0.01, -0.02, 0.04])


def sample(force=FORCE, torque=TORQUE, fault: str = "") -> Wrench:
    return Wrench(0, tuple(map(float, force)), tuple(map(float, torque)), fault)


def quiet(rng, count: int = 40) -> list[Wrench]:
    """Samples without contact: the bias, and noise of 0.02 N and 0.001 Nm."""
    return [
        sample(FORCE + 0.02 * rng.standard_normal(3), TORQUE + 0.001 * rng.standard_normal(3))
        for _ in range(count)
    ]


@pytest.mark.parametrize(
    ("axes", "turned"),
    [
        (("x", "y", "z"), (1.0, 2.0, 3.0)),
        (("x", "y", "-z"), (1.0, 2.0, -3.0)),
        (("-y", "+x", "z"), (-2.0, 1.0, 3.0)),
        (("z", "-x", "-y"), (3.0, -1.0, -2.0)),
    ],
)
def test_a_mounting_names_the_device_s_axis_behind_each_of_the_skin_s(axes, turned) -> None:
    assert Mounting(axes).to_skin((1.0, 2.0, 3.0)) == turned


@pytest.mark.parametrize("axes", [("x", "y", "y"), ("x", "y", "w"), ("x", "y", "--z"), ("x", "y", "")])
def test_a_mounting_that_is_none_is_refused(axes) -> None:
    with pytest.raises(RangeError, match="once each"):
        Mounting(axes)


@pytest.mark.parametrize("axes", [("x", "y", "z"), ("-y", "x", "-z")])
def test_a_load_after_the_tare_is_the_load(rng, axes) -> None:
    tare = ForceBias(Mounting(axes))
    tare.measure(quiet(rng))
    load, moment = np.array([0.4, 0.6, -2.0]), np.array([0.05, 0.03, -0.07])
    loaded = sample(FORCE + load, TORQUE + moment)
    np.testing.assert_allclose(tare.force(loaded), Mounting(axes).to_skin(load.tolist()), atol=0.015)
    np.testing.assert_allclose(tare.torque(loaded), Mounting(axes).to_skin(moment.tolist()), atol=0.00075)


def test_without_a_tare_the_sensor_is_believed() -> None:
    assert ForceBias().force(sample()) == tuple(FORCE)
    assert ForceBias().torque(sample()) == tuple(TORQUE)


def test_the_noise_is_that_along_z(rng) -> None:
    tare = ForceBias()
    tare.measure(quiet(rng, 400))
    assert tare.noise_n == pytest.approx(0.02, rel=0.15)  # four times the scatter of 400 samples' deviation


def test_faulty_samples_have_no_part_in_the_tare(rng) -> None:
    tare = ForceBias()
    tare.measure([*quiet(rng, MIN_SAMPLES), *[sample(100 * FORCE, fault="saturated")] * 5])
    np.testing.assert_allclose(tare.force_n, FORCE, atol=0.02)


def test_too_few_samples_are_refused_for_what_is_wrong_with_the_rest(rng) -> None:
    few = quiet(rng, MIN_SAMPLES - 1)
    with refused("force-stale", Tripped) as missing:
        ForceBias().measure(few)
    assert missing.value.reason is Reason.FORCE_STALE
    with pytest.raises(Tripped, match="saturated") as faulty:
        ForceBias().measure([*few, sample(fault="saturated")])
    assert faulty.value.reason is Reason.FORCE_FAULT
