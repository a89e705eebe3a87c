"""A rig's file with an arm: what it refuses, and the rig's check on it."""

import math
import os
import random
import sys
from pathlib import Path

import pytest
from tests.fakes.netft_box import FakeNetFT, FakePage
from tests.fakes.ur_controller import PROTECTIVE, UrController, ur_modules
from tests.fakes.video_capture import FakeVideoCapture
from tests.rig.lab_files import CAMERA, SOURCES

from palpate.core import DeviceError, InputError, MonotonicClock
from palpate.rig.commissioning.bench import bench_status, open_bench
from palpate.rig.commissioning.hand_motion import jog
from palpate.rig.commissioning.homing import home_clear
from palpate.rig.commissioning.setup_answers import toml_text
from palpate.rig.rig_file import UrArmPart, open_rig, read_rig

HOST = "127.{}.{}.1".format(*divmod(os.getpid() % 60_000, 250))  # an arm has one holder
STAGE = {
    "kind": "ur-arm", "host": HOST, "rotation": [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
    "zero_mm": [400.0, 100.0, 200.0], "tool_rotvec_rad": [math.pi, 0.0, 0.0],
    "least_mm": [-30.0, -30.0, -40.0], "greatest_mm": [30.0, 30.0, 9.0],
}  # fmt: skip
HANGS = (0.4, 0.1, 0.212, math.pi, 0.0, 0.0)  # 12 mm above the skin
STIFFNESS_N_M = 4000.0
NOISE_N = 0.002


class ArmLab:
    """Arm, force box and camera, all fakes, and the file that names them."""

    def __init__(self, folder: Path, arm: UrController, box: FakeNetFT) -> None:
        self.path, self.arm, self._folder = folder / "rig.toml", arm, folder
        self.fields = {
            "name": "arm",
            "stage": STAGE,
            "force": {
                "kind": "netft", "host": box.host, "rdt_port": box.rdt_port, "http_port": box.http_port,
                "silence_s": 0.5, "axes": ["x", "y", "-z"],
            },
            "camera": {"kind": CAMERA, "lab": str(folder)},
            "limits": {
                "least_mm": [-25, -25, -30],
                "greatest_mm": [25, 25, 8],
                "force_N": 15.0,
                "age_s": 0.4,
            },
        }  # fmt: skip

    def write(self, **stage) -> str:
        self.path.write_text(toml_text({**self.fields, "stage": {**STAGE, **stage}}))
        return str(self.path)


@pytest.fixture
def lab(tmp_path, monkeypatch):
    arm = UrController(HANGS, MonotonicClock())
    for name, module in ur_modules(arm).items():
        monkeypatch.setitem(sys.modules, name, module)
    SOURCES[str(tmp_path)] = FakeVideoCapture(rate_hz=20.0)

    def force(t: float) -> tuple[float, float, float]:
        depth_m = max(0.2 - arm.true_pose()[2], 0.0)  # the skin lies at the rig's zero, 200 mm above the base
        x, y, z = (random.gauss(0.0, NOISE_N) for _ in "xyz")
        return x, y, z - STIFFNESS_N_M * depth_m

    with FakeNetFT(page=FakePage(ranges="30;30;60;3;3;3")) as box:
        box.force = force
        yield ArmLab(tmp_path, arm, box)
    SOURCES.pop(str(tmp_path))


@pytest.mark.parametrize(
    ("field", "says"),
    [
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "rotation mirrors"),
        ({"rotation": [[1, 0, 0], [0, -1, 0], [0, 0, -0.9]]}, "not orthonormal"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "180 degrees"),
        ({"top_speed_mm_s": 251.0}, "top_speed_mm_s is"), ({"stop_mm_s2": 50.0}, "stop_mm_s2 is"),
        ({"tilt_deg": 5.0}, "tilt_deg is"), ({"host": "a host"}, "no host"),
        ({"greatest_mm": [-30.0, 30.0, 9.0]}, "box along"), ({"home": True}, "stage.home: Extra"),
    ],
)  # fmt: skip
def test_a_file_that_says_an_arm_wrongly_is_refused_by_field(lab, field, says) -> None:
    with pytest.raises(InputError, match=says):
        read_rig(Path(lab.write(**field)))


def test_a_file_of_an_arm_needs_its_frame_and_box(lab) -> None:
    for missing in ("rotation", "zero_mm", "tool_rotvec_rad", "least_mm", "greatest_mm"):
        fields = {name: value for name, value in STAGE.items() if name != missing}
        lab.path.write_text(toml_text({**lab.fields, "stage": fields}))
        with pytest.raises(InputError, match=f"stage.{missing}: Field"):
            read_rig(lab.path)


def test_the_numbers_of_a_file_are_the_drivers(lab) -> None:
    part = read_rig(Path(lab.write(top_speed_mm_s=20.0, stop_mm_s2=800.0))).stage
    assert isinstance(part, UrArmPart)
    spec = part.spec()
    assert (spec.top_speed_m_s, spec.stop_m_s2, spec.rate_hz) == (0.02, 0.8, 125.0)
    assert spec.frame.base_m((0.0, 0.0, 0.01)) == pytest.approx((0.4, 0.1, 0.19))


def test_an_arm_has_no_homing_is_jogged_by_its_limits_and_its_status_tells_a_stop(lab) -> None:
    bench = open_bench(lab.write())
    found = bench_status(bench)
    assert found["stage_says"] == "running"
    assert found["position_mm"] == pytest.approx([0.0, 0.0, -12.0], abs=1e-3)
    stage = bench.need_stage()
    with pytest.raises(DeviceError, match="no homing"):
        home_clear(stage, bench.force, bench.mounting, bench.clock)
    x, y, z = stage.position_m()
    jog(
        stage, bench.force, bench.mounting, bench.limits, bench.clock,
        axis="z", distance_m=-1e-3, speed_m_s=2e-3,
    )  # fmt: skip
    assert stage.position_m() == pytest.approx((x, y, z - 1e-3), abs=3e-5)
    lab.arm.stop_for_safety(PROTECTIVE)
    bench.clock.sleep(0.02)
    assert "protective stop" in bench_status(bench)["problems"]["stage"]
    bench.close()


LIBRARY = """
import math
from palpate.core import MonotonicClock
from tests.fakes.ur_controller import UrController, ur_modules
ARM = UrController({pose}, MonotonicClock())
MODULES = ur_modules(ARM)
"""


def test_an_arm_is_moved_by_its_supervisors_process(lab, tmp_path, monkeypatch) -> None:
    folder = tmp_path / "library"
    folder.mkdir()
    (folder / "fake_arm.py").write_text(LIBRARY.format(pose=list(HANGS)))
    interfaces = {"rtde_control": "RTDEControlInterface", "rtde_receive": "RTDEReceiveInterface"}
    for name, interface in interfaces.items():
        (folder / f"{name}.py").write_text(
            f"from fake_arm import MODULES\n{interface} = MODULES[{name!r}].{interface}\n"
        )
    monkeypatch.syspath_prepend(folder)  # which the process is given
    rig = open_rig(lab.write())
    try:
        assert rig.supervisor is not None
        assert rig.stage.position_m() == pytest.approx((0.0, 0.0, -0.012), abs=1e-6)
        assert rig.stage.travel.acceleration_m_s2 == 1.0
        assert not lab.arm.uploads  # it is another process's
    finally:
        rig.close()
