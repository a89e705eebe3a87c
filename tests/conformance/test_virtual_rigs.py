"""The virtual rig of every sensor passes the public check of a rig."""

from dataclasses import replace

import pytest

from palpate.core.sensor import SENSORS
from palpate.rig.plans.plan_files import plan_of_sensor
from palpate.rig.rig_check import NOISE_TOLERANCE, SIGMAS, CheckResult, check_rig
from palpate.rig.rig_file import open_rig
from palpate.rig.virtual import Fault, virtual_rig
from palpate.rig.virtual.virtual_bench import default_variation

SMALL = {"palm": "palm-debug"}  # a tenth of the pixels each way is the same design


def force_noise(found: list[CheckResult]) -> list[CheckResult]:
    return [one for one in found if one.code.startswith("force.noise-")]


@pytest.mark.parametrize("name", SENSORS.names())
@pytest.mark.cases(1)
def test_the_rig_of_every_virtual_sensor_passes_its_check(name: str) -> None:
    found = check_rig(open_rig(f"virtual:{SMALL.get(name, name)}", supervised=False))
    assert [one for one in found if not one.ok] == []
    assert "stage.touched-nothing" in {one.code for one in found}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.cases(1)
def test_force_noise_is_limited_by_what_the_sensor_states(seed: int) -> None:
    rig = virtual_rig("tactip", seed=seed)
    assert rig.noise_n is not None
    assert rig.design is not None
    noise = force_noise(check_rig(rig))
    assert all(one.ok for one in noise)
    assert len(noise) == 3
    assert [one.allowed for one in noise] == pytest.approx([NOISE_TOLERANCE * rig.noise_n] * 3)
    assert rig.noise_n < plan_of_sensor(rig.design).threshold_N / SIGMAS


def test_force_noise_twice_the_stated_one_fails() -> None:
    sound = virtual_rig("tactip")
    assert sound.design is not None
    vary = default_variation(sound.design, "virtual:tactip")
    noisy = virtual_rig("tactip", variation=replace(vary, force_noise_n=2.5 * vary.sample_noise_n))
    noise = force_noise(check_rig(replace(noisy, noise_n=sound.noise_n)))
    assert [one.ok for one in noise] == [False, False, False]


def test_without_a_stated_noise_the_plans_threshold_limits_it() -> None:
    rig = replace(virtual_rig("tactip"), noise_n=None)
    assert [one.allowed for one in force_noise(check_rig(rig))] == pytest.approx([0.5 / SIGMAS] * 3)


def test_a_stated_threshold_below_five_standard_deviations_fails() -> None:
    rig = replace(virtual_rig("tactip"), noise_n=None)
    assert not all(one.ok for one in force_noise(check_rig(rig, threshold_n=0.05)))


def test_a_force_sensor_that_grows_noisy_keeps_the_stage_at_rest() -> None:
    found = check_rig(virtual_rig("tactip", faults=(Fault("force-noisy", 0.2),)))
    assert "stage.was-moved" in {one.code for one in found if not one.ok}
