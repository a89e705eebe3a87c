"""A real stage with a virtual force sensor and camera, named in one rig's file: they follow its place."""

import time

import numpy as np
import pytest
from tests.rig.grbl_talk import Talk, fake, simulator
from tests.rig.test_grbl_two_firmwares import MOTION, SETTINGS

from palpate.core import DeviceError, InputError, ManualClock, Travel
from palpate.rig import open_rig
from palpate.rig.commissioning.bench import open_bench
from palpate.rig.virtual.followed_stage import FollowedWorld
from palpate.rig.virtual.virtual_camera import VirtualCamera
from palpate.rig.virtual.virtual_force import VirtualForce

MIXED = """
name = "tried"
design = "palm"
origin = "a bench"
origin_mm = [0, 0, 5]
[stage]
kind = "grbl"
port = "{port}"
require_homed = false
reference = [0, 0, 0]
steps_per_mm = [250, 250, 250]
direction_mask = 0
least_mm = [-30, -30, -30]
greatest_mm = [30, 30, 12]
latency_s = 0.05
boot_s = 0.2
reply_s = 20.0
stop_s = 20.0
[force]
kind = "virtual"
[camera]
kind = "virtual"
[limits]
least_mm = [-20, -20, -20]
greatest_mm = [20, 20, 10]
age_s = 0.5
overshoot_mm = 0.2
"""


class Placed:
    """A stage that says where it is told to say that it is."""

    travel = Travel((-0.03,) * 3, (0.03, 0.03, 0.02), 0.05, 0.5, 0.005)

    def __init__(self) -> None:
        self.place = (0.0, 0.0, 0.0)
        self.lost = False

    def position_m(self):
        if self.lost:
            raise DeviceError("its place is not known")
        return self.place

    def move_to(self, position_m, speed_m_s):
        self.place = position_m

    def moving(self):
        return False

    def stop(self):
        pass

    def close(self):
        pass


@pytest.fixture
def stage():
    return Placed()


@pytest.fixture
def world(stage):
    return FollowedWorld(stage, "palm", ManualClock(), (0.0, 0.0, 0.005), seed=0, askew_m=(0.0, 0.0, 0.0))


def pressed_n(world, stage, z_m: float) -> float:
    """Force along z after the stage has come to a height, less that in the air [N]."""
    force = VirtualForce(world)
    air = np.mean([one.force_n[2] for one in force.drain()])
    stage.place = (0.0, 0.0, z_m)
    world.clock.sleep(0.2)
    force.drain()
    world.clock.sleep(0.2)
    return float(np.mean([one.force_n[2] for one in force.drain()]) - air)


def test_a_probe_that_a_stage_brings_into_the_skin_is_felt_and_seen(world, stage):
    camera = VirtualCamera(world)
    air = camera.grab()[1].image.astype(float)
    assert pressed_n(world, stage, 0.0055) > 0.2
    assert np.abs(camera.grab()[1].image - air).max() > 30


def test_it_is_felt_at_the_depth_at_which_the_stage_stands(world, stage):
    force_n = pressed_n(world, stage, 0.0056)
    depth_m = world.touch_at(world.now_s - 0.05).depth_m
    assert depth_m == pytest.approx(0.6e-3, abs=0.1e-3)  # the surface varies from press to press
    assert force_n == pytest.approx(world.touch_at(world.now_s - 0.05).force_n[2], abs=0.02)


def test_a_stage_that_loses_its_place_leaves_the_probe_where_it_was(world, stage):
    pressed_n(world, stage, 0.0056)
    stage.lost = True
    world.clock.sleep(0.1)
    world.advance()
    assert world.touch_at(world.now_s).depth_m == pytest.approx(0.6e-3, abs=0.1e-3)


def test_between_two_looks_the_probe_went_straight(world, stage):
    world.advance()
    stage.place = (0.0, 0.0, 0.004)
    world.clock.sleep(1.0)
    world.advance()
    middle = world.touch_at(world.now_s - 0.5).depth_m
    assert middle == pytest.approx(-0.003, abs=0.1e-3)


def test_a_virtual_sensor_without_a_stage_is_refused(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(MIXED.format(port="/dev/none") + '[label_force]\nkind = "virtual"\n')
    with pytest.raises(InputError, match=r"label_force.*\[stage\]"):
        open_rig(str(path), supervised=False)


@pytest.fixture(params=["fake 1.1h", "real 1.1h", "real grblHAL"])
def mixed(request, tmp_path):
    """A rig's file whose stage is firmware, a fake or a simulator of a real one."""
    kind, firmware = request.param.split()
    with fake(firmware) if kind == "fake" else simulator(tmp_path, firmware) as port:
        with Talk(port) as talk:
            talk.wake()
            for line in (*SETTINGS, *MOTION, "$X"):
                assert talk.send(line)[-1] == "ok", line
        path = tmp_path / "rig.toml"
        path.write_text(MIXED.format(port=port))
        yield str(path)


def test_the_devices_of_a_mixed_rig_are_opened_one_by_one_as_well(mixed):
    with open_bench(mixed, position="reference") as bench:
        assert not bench.failed
        time.sleep(0.1)
        assert abs(bench.need_force().latest().force_n[2]) < 5
