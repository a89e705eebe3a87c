"""The virtual twin: its motion, its skin, its force sensor and camera keep to their own laws."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.rig.grbl_talk import Talk, fake, simulator
from tests.rig.rigs import IDEAL
from tests.rig.test_grbl_two_firmwares import MOTION, SETTINGS

from palpate.calibration.compliance.compliance_calibration import ReferenceSpecimen, calibrate_compliance
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_cues import cues_of
from palpate.core import DeviceError, InputError, ManualClock, Travel
from palpate.core.clock import NS_PER_S
from palpate.core.errors import RangeError
from palpate.core.sensor import sensor
from palpate.recordings.exchange.frame_sequences import TiffFrames
from palpate.recordings.exchange.press_export import export_presses
from palpate.recordings.exchange.press_folder import PressFolder, press_folder
from palpate.recordings.exchange.press_table import read_press_table
from palpate.recordings.run_reader import Run
from palpate.rig import PLANS, State, open_rig, record
from palpate.rig.commissioning.bench import open_bench
from palpate.rig.rig import Rig
from palpate.rig.virtual import Variation, virtual_rig
from palpate.rig.virtual.linear_rig import Motion
from palpate.rig.virtual.virtual_bench import FollowedWorld
from palpate.rig.virtual.virtual_sensors import VirtualCamera, VirtualForce
from palpate.rig.virtual.virtual_world import ViscoelasticSkin
from palpate.sensors import palm
from palpate.sensors.palm.palm_sensor import Palm

SPEC = palm.cropped(palm.palm(), 16, "tiny")
LAW = Palm(SPEC).force_law(palm.parse_probe("sphere:10"))


def rig(**kwargs: object) -> Rig:
    return virtual_rig(**{"sensor": Palm(SPEC), "clock": ManualClock(NS_PER_S), "variation": IDEAL, **kwargs})


@given(length=st.floats(1e-6, 0.1), speed=st.floats(1e-4, 0.1), a=st.floats(0.05, 5), stop=st.floats(0, 2))
def test_a_move_ends_on_its_target_and_a_stop_within_its_bound(length, speed, a, stop):
    motion = Motion((0, 0, 0), (0, 0, length), speed, a, 0.0)
    ends = motion.at(np.array([motion.ends_s, motion.ends_s + 1]))[:, 2]
    assert ends == pytest.approx(length, rel=1e-9)
    at = stop * motion.ends_s
    halted = Motion((0, 0, 0), (0, 0, length), speed, a, 0.0, stopped_s=at)
    before, after = motion.at(np.array([at]))[0, 2], halted.at(np.array([at + 1e3]))[0, 2]
    assert -1e-12 <= after - before <= speed**2 / (2 * a) + 1e-12


def test_a_skin_without_memory_carries_what_the_table_says() -> None:
    depth = np.array([0.0, 1e-3, 3e-3])
    force, elastic = ViscoelasticSkin(LAW, ()).force(depth, 0.01)
    wanted = [palm.press(SPEC, palm_pose(d)).force_n for d in depth]
    assert force == pytest.approx(wanted, rel=1e-4, abs=1e-9)
    assert (force == elastic).all()


def palm_pose(depth_m: float):
    from palpate.core import Pose

    return Pose(0.0, 0.0, float(depth_m))


@pytest.mark.parametrize("step_s", [0.001, 0.005])
def test_a_held_press_relaxes_by_its_shares_whatever_the_step(step_s: float) -> None:
    branches = ((0.1, 0.2), (0.05, 5.0))
    times = np.arange(0, 4, step_s)
    depth = np.minimum(times / 0.01, 1.0) * 2e-3
    force, elastic = ViscoelasticSkin(LAW, branches).force(depth, step_s)
    held = times > 0.02
    law = elastic[-1] * (1 + sum(g * np.exp(-(times[held] - 0.006) / tau) for g, tau in branches))
    # The ramp of 10 ms weighs the early part of a 3/2 power less: a quarter of a percent.
    assert force[held] == pytest.approx(law, rel=2.5e-3)


def test_a_stage_refuses_what_it_cannot_do() -> None:
    stage = rig().stage
    with pytest.raises(RangeError, match="travel"):
        stage.move_to((0, 0, 1), 1e-3)
    with pytest.raises(RangeError, match="mm/s"):
        stage.move_to((0, 0, 0), 10)
    stage.move_to((0, 0, 1e-3), 1e-3)
    with pytest.raises(DeviceError, match="moving already"):
        stage.move_to((0, 0, 0), 1e-3)


def test_a_frame_is_exposed_after_it_was_asked_for_and_shows_the_depth_there_was() -> None:
    r = rig()
    r.stage.move_to((0, 0, 3e-3), 10e-3)
    while r.stage.moving():
        r.clock.sleep(0.01)
    asked_ns = r.clock.now_ns()
    time_ns, frame = r.camera.grab()
    assert time_ns - asked_ns > SPEC.exposure_s * NS_PER_S
    assert r.truth(time_ns)["true_depth_mm"] == pytest.approx(3.0, abs=1e-9)
    wanted = palm.render_clean(palm.press(SPEC, palm_pose(3e-3)), SPEC)[0]
    dark = palm.render_clean(palm.press(SPEC, palm_pose(0.0)), SPEC)[0]
    seen = frame.image[:, :16].astype(float)
    assert np.corrcoef(seen.ravel(), wanted.ravel())[0, 1] > 0.9
    assert (
        np.corrcoef(seen.ravel(), wanted.ravel())[0, 1] > np.corrcoef(seen.ravel(), dark.ravel())[0, 1] + 0.2
    )


def test_a_press_leaves_a_dent_that_fades_and_is_nowhere_else() -> None:
    law = LAW
    skin = ViscoelasticSkin(law, ((0.1, 2.0),))
    skin.force(np.full(10_000, 4e-3), 0.005)  # 50 s: the branch has come to all of the depth
    assert skin.leave() == pytest.approx((0.1 / 1.1 * 4e-3,))
    assert skin.leave() == (0.0,)
    again, depth = ViscoelasticSkin(law, ((0.1, 2.0),)), np.array([0.0, 1e-4, 2e-4])
    np.testing.assert_array_equal(skin.force(depth, 0.005)[0], again.force(depth, 0.005)[0])


@pytest.mark.parametrize(("aside_m", "wait_s"), [(0.0, 0.0), (0.0, 3.0), (12e-3, 0.0)])
@pytest.mark.cases(1)
def test_a_place_that_was_pressed_is_touched_deeper_soon_afterwards(aside_m: float, wait_s: float) -> None:
    share, fades_s, depth_m = 0.1, 3.0, 4e-3
    bench = rig(variation=replace(IDEAL, relaxation=((share, fades_s),)))

    def go(x: float, z: float) -> None:
        bench.stage.move_to((x, 0.0, z), 20e-3)
        while bench.stage.moving():
            bench.clock.sleep(0.002)

    go(0.0, depth_m)
    bench.clock.sleep(60.0)
    go(0.0, -1e-3)
    left_s = bench.clock.now_ns()
    bench.clock.sleep(wait_s)
    go(aside_m, -1e-3)
    go(aside_m, 1e-3)
    touched_s = (bench.clock.now_ns() - left_s) / NS_PER_S
    bench.clock.sleep(0.1)  # a frame's time tells of a little before
    deep_mm = bench.truth(bench.clock.now_ns())["true_depth_mm"]
    dent_mm = 1e3 * share / (1 + share) * depth_m * math.exp(-touched_s / fades_s) if aside_m == 0 else 0.0
    # The skin recovers a little while the probe is on its way up, and down again: 0.2 s of its 3 s.
    assert 1.0 - deep_mm == pytest.approx(dent_mm, abs=0.05)


def test_light_relaxes_as_the_force_does() -> None:
    lagging = rig(variation=replace(IDEAL, relaxation=((0.5, 1.0),)))
    at_once = seen_under_3_mm(lagging)
    lagging.clock.sleep(10.0)
    later, relaxed = mean_frame(lagging), seen_under_3_mm(rig())
    assert np.abs(later - relaxed).mean() < 0.3 * np.abs(at_once - relaxed).mean()


def seen_under_3_mm(bench: Rig) -> np.ndarray:
    bench.stage.move_to((0.0, 0.0, 3e-3), 20e-3)
    while bench.stage.moving():
        bench.clock.sleep(0.01)
    return mean_frame(bench)


def mean_frame(bench: Rig) -> np.ndarray:
    """Of a few, so that the camera's noise counts less."""
    return np.mean([bench.camera.grab()[1].image.astype(float) for _ in range(4)], axis=0)


def test_the_same_seed_makes_the_same_rig_and_another_does_not() -> None:
    def measured(seed: int) -> tuple[bytes, list[float]]:
        r = rig(seed=seed, variation=Variation())
        r.stage.move_to((1e-3, 0, 2e-3), 10e-3)
        while r.stage.moving():
            r.clock.sleep(0.01)
        return r.camera.grab()[1].image.tobytes(), [one.force_n[2] for one in r.force.drain()]

    assert measured(3) == measured(3)
    assert measured(3)[0] != measured(4)[0]


def test_incidental_lateral_forces_are_of_the_size_of_the_reports() -> None:
    from palpate.rig.virtual.disturbances import approach_of

    depths = np.arange(1, 51) * 1e-4
    force = np.array([palm.press(SPEC, palm_pose(d)).force_n for d in depths])
    leans = [approach_of(Variation(), 0, 1e-3 * i, 0.0, k).lean for i in range(37) for k in range(5)]
    x, y = (np.outer([lean[axis] for lean in leans], force).ravel() for axis in (0, 1))
    assert x.std() == pytest.approx(0.07, rel=0.3)
    assert y.std() == pytest.approx(0.29, rel=0.3)


# The virtual rig drives the TacTip: presses on specimens come back from the run as compliance reads them.

TACTIP = sensor("tactip")
FEW = PLANS["tactip"].model_copy(update={"indenters": ("rigid", "S3=1.1?"), "cycles": 1, "wait_s": 0.0})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """One press on a rigid plate and one on the softest specimen."""
    out = tmp_path_factory.mktemp("tactip") / "run"
    rig = virtual_rig("tactip", seed=2)
    try:
        outcome = record(rig, FEW, out)
    finally:
        rig.close()
    assert outcome.state is State.DONE, outcome.message
    export_presses(Run.open(out))
    return Run.open(out)


@pytest.mark.slow
def test_force_position_and_area_of_a_press_are_those_of_its_contact(run: Run) -> None:
    for one, words in zip(press_folder(run.path).specimens, FEW.indenters, strict=True):
        tiff, path = one.presses[0]
        with TiffFrames(tiff) as pages:
            table = read_press_table(path, len(pages))
        assert 5.0 < table.force_n.max() < 5.4
        assert table.area_m2 is not None
        body = TACTIP.force_law(TACTIP.probe(words), TACTIP.specimen(words))
        at = table.frame_sample[table.force_n[table.frame_sample] > 1.0]
        law_n = np.interp(table.area_m2[at], math.pi * body.radius_m**2, body.force_n)
        # Noise of 0.02 N in steps of 1/16 N, and a force that moves on by 0.1 N while a frame is exposed.
        assert np.abs(table.force_n[at] - law_n).max() < 0.25
        assert np.abs(np.median(table.force_n[at] - law_n)) < 0.03


@pytest.mark.slow
def test_the_stiffness_of_a_specimen_is_read_from_a_recorded_run(tmp_path: Path) -> None:
    rig = virtual_rig("tactip", seed=1)
    assert record(rig, PLANS["tactip"], tmp_path / "run").state is State.DONE
    folder = export_presses(Run.open(tmp_path / "run"))
    assert folder is not None
    trials = _trials(folder)
    references = [
        ReferenceSpecimen(one.name, one.stiffness_n_m, trials[one.name])
        for one in folder.specimens
        if one.stiffness_n_m is not None
    ]
    touch = read_touch(calibrate_compliance(references), [one.press for one in trials["new"]], "new")
    assert touch.stiffness.in_unit("N_per_mm").value == pytest.approx(5.3, rel=0.03)


def _trials(folder: PressFolder):
    found = {}
    for one in folder.specimens:
        cues = []
        for tiff, path in one.presses:
            with TiffFrames(tiff) as pages:
                cues.append(cues_of(list(pages), read_press_table(path, len(pages))))
        found[one.name] = tuple(one.trial for one in cues)
    return found


# A real stage with a virtual force sensor and camera, named in one rig's file: they follow its place.

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
