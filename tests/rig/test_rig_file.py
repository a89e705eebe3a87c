"""A rig from a file: what it says is opened, and what it says wrongly is refused by name."""

import math
import os
import random
import re
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.fakes.grbl_parameters import GrblParameters
from tests.fakes.netft_box import FakeNetFT, FakePage
from tests.fakes.ur_controller import PROTECTIVE, UrController, ur_modules
from tests.fakes.video_capture import FakeVideoCapture
from tests.refusals import refused
from tests.rig.lab_files import CAMERA, SOURCES
from tests.rig.rigs import plan, quick

from palpate.core import DeviceError, InputError, MonotonicClock
from palpate.core.provenance import Provenance
from palpate.devices.motion_limits import Reason
from palpate.devices.rpc import path_of
from palpate.rig import State, open_rig, record
from palpate.rig.commissioning.bench import bench_status, open_bench
from palpate.rig.commissioning.hand_motion import jog
from palpate.rig.commissioning.homing import home_clear
from palpate.rig.commissioning.setup_answers import toml_text
from palpate.rig.engine import manifest_of
from palpate.rig.plans import Listed
from palpate.rig.rig_file import GrblPart, UrArmPart, opened_rig, read_rig
from palpate.rig.rig_file.stage_parts import LimitsPart
from palpate.rig.service import rig_client, rig_name
from palpate.rig.virtual import virtual_rig
from palpate.rig.virtual.virtual_bench import REAL_TIME_AGE_S

REAL = """
name = "bench"
[stage]
kind = "grbl"
port = "/dev/no-such-stage"
[force]
kind = "netft"
host = "127.0.0.1"
axes = ["x", "y", "-z"]
rdt_port = {rdt}
http_port = {http}
[camera]
kind = "uvc"
address = "/dev/no-such-camera"
[limits]
least_mm = [-30, -30, -20]
greatest_mm = [30, 30, 8]
"""


def written(folder: Path, text: str) -> str:
    path = folder / "rig.toml"
    path.write_text(text)
    return str(path)


def test_a_virtual_rig_has_the_seed_limits_and_faults_of_its_file(tmp_path: Path) -> None:
    text = """
name = "trial"
[virtual]
seed = 3
faults = [{ kind = "layer-gone", after_s = 0.5 }]
[limits]
least_mm = [-30, -30, -20]
greatest_mm = [30, 30, 8]
force_N = 12
"""
    rig = open_rig(written(tmp_path, text))
    assert rig.seed == 3
    assert rig.limits.force_n == 12
    assert rig.limits.greatest_m == pytest.approx((0.03, 0.03, 0.008))
    outcome = record(
        rig, quick(places=Listed(kind="listed", at_mm=((0.0, 0.0),)), seek_mm=0.5), tmp_path / "run"
    )
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.NO_CONTACT)


@pytest.mark.parametrize(
    ("text", "code", "named"),
    [
        ("name = ", "toml", "TOML"),
        ('nam = "x"', "file-field", "nam"),
        ('name = "x"', "parts-missing", "stage"),
        ('name = "x"\n[virtual]\nsead = 1', "file-field", "sead"),
        ('name = "x"\n[virtual]\nfaults = [{ kind = "rain" }]', "file-field", "faults"),
        ('name = "x"\n[virtual]\n[stage]\nkind = "grbl"\nport = "p"', "parts-exclude", "virtual"),
        ('name = "x"\n[stage]\nkind = "klipper"\nport = "p"', "unknown-name", "stage.kind"),
        ('name = "x"\n[stage]\nkind = "marlin"\nport = "p"\nspeed = 1', "file-field", "stage.speed"),
        ('name = "x"\n[label_force]\nkind = "scales"', "unknown-name", "label_force.kind"),
        (
            'name = "x"\n[virtual]\n[limits]\nleast_mm = [0, 0, 0]\ngreatest_mm = [1, 1, 1]\nforce_N = -1',
            "file-field",
            "force_N",
        ),
    ],
)
def test_a_file_that_says_something_wrong_is_refused_by_name(tmp_path, text, code, named):
    with refused(code, InputError, match=named):
        open_rig(written(tmp_path, text))


def test_a_rig_that_is_neither_file_nor_name_is_refused() -> None:
    with pytest.raises(InputError, match="virtual:palm"):
        open_rig("virtual:hand")


def test_the_operators_page_opens_a_rig_by_its_file(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        'name = "b"\n[virtual]\nreal_time = true\n[[regions]]\nname = "rim"\nbox_px = [1, 2, 30, 40]',
    )
    assert rig_name(path) == str(Path(path).resolve())
    opened = rig_client.open_served_rig(path)
    assert opened.real_time
    assert opened.rig.regions == (("rim", (1, 2, 30, 40)),)
    assert opened.rig.limits.age_s == REAL_TIME_AGE_S
    opened.rig.close()
    plain = rig_client.open_served_rig(written(tmp_path, 'name = "b"\n[virtual]'))
    assert [region.name for region in plain.rig.regions] == ["fringes", "mirror"]
    assert plain.rig.is_simulated  # whatever its file calls it
    assert not plain.real_time
    plain.rig.close()


@pytest.mark.parametrize(
    ("provenance", "simulated"),
    [(None, True), (Provenance.SIMULATED, True), (Provenance.MEASURED, False), (Provenance.DERIVED, False)],
)
def test_a_rig_is_simulated_where_a_device_of_it_is_virtual_and_so_are_its_runs(provenance, simulated):
    made = virtual_rig()
    rig = replace(made, origin="shear was not measured", provenance=provenance or made.provenance)
    assert rig.is_simulated == simulated
    assert manifest_of(rig, plan()).is_simulated == simulated
    rig.close()


def test_a_rigs_process_is_found_by_its_files_whole_path_however_long(tmp_path: Path) -> None:
    assert rig_name("virtual:palm") == "virtual:palm"
    one, other = (path_of(f"/{first}{'x' * 300}/bench.toml", tmp_path).name for first in "ab")
    assert one != other
    assert len(one) < 120
    with refused("rig-unknown", InputError):
        rig_name("nowhere.toml")


def test_a_device_that_is_missing_is_told_and_those_opened_before_are_closed(tmp_path: Path) -> None:
    with FakeNetFT() as box:
        text = REAL.format(rdt=box.rdt_port, http=box.http_port)
        for _ in range(2):  # a box that was not let go of would have a client still
            with pytest.raises(DeviceError, match="no-such-camera"):
                open_rig(written(tmp_path, text))
        assert not box.was_biased


@pytest.mark.parametrize(
    ("field", "value", "most"),
    [
        ("force_N", "1e9", "50"),
        ("force_rate_N_s", "5001", "5000"),
        ("age_s", "0.6", "0.5"),
        ("overshoot_mm", "1.5", "1"),
        ("step_mm", "2", "1"),
    ],
)
def test_a_limit_beyond_its_ceiling_is_refused_with_both_numbers(tmp_path, field, value, most):
    text = 'name = "x"\n[virtual]\n[limits]\nleast_mm = [-1, -1, -1]\ngreatest_mm = [1, 1, 1]\n'
    said = re.escape(f"{field} is {float(value):g}, and {most} is the greatest")
    with pytest.raises(InputError, match=said):
        read_rig(Path(written(tmp_path, f"{text}{field} = {value}")))
    assert read_rig(Path(written(tmp_path, f"{text}{field} = {most}"))).limits is not None


@pytest.mark.parametrize(
    ("said", "named"),
    [
        ('require_homed = false\nreference = "counts"\nhome = true', "home"),
        ("reply_s = 31", "reply_s"),
        ("top_speed_mm_s = 201", "top_speed_mm_s"),
        ("baud = 300", "baud"),
        ('reference = "somewhere"', "reference"),
    ],
)
def test_a_stage_that_cannot_be_as_it_is_stated_is_refused_before_its_port_is_opened(tmp_path, said, named):
    with refused("file-field", InputError, match=named):
        read_rig(Path(written(tmp_path, f'name = "x"\n[stage]\nkind = "grbl"\nport = "p"\n{said}')))


def test_what_a_file_says_of_a_stage_without_switches_reaches_its_driver(grbl_bench: Any) -> None:
    bench = grbl_bench(GrblParameters(settings={20: 0, 22: 0}, homed=True), clock=MonotonicClock())
    part = GrblPart(
        kind="grbl", port=bench.terminal.path, require_homed=False, reference=(1.0, 2.0, 3.0),
        steps_per_mm=(250, 250, 250), direction_mask=0, least_mm=(-10, -10, -10), greatest_mm=(10, 10, 10),
        top_speed_mm_s=3.0, boot_s=0.05, reply_s=10.0,
    )  # fmt: skip
    stage = part.open(MonotonicClock(), position="reference")
    try:
        assert stage.position_m() == pytest.approx((1e-3, 2e-3, 3e-3))
        assert stage.travel.top_speed_m_s == pytest.approx(3e-3)
        assert stage.travel.greatest_m == pytest.approx((0.01,) * 3)
    finally:
        stage.close()


TOO_SMALL = [
    ("limits", "step_mm", 1e-9, "mm"), ("limits", "force_rate_N_s", 1e-9, "N/s"),
    ("limits", "overshoot_mm", 1e-9, "mm"), ("limits", "age_s", 1e-9, "s"),
    ("stage", "top_speed_mm_s", 1e-9, "mm/s"), ("stage", "latency_s", 1e-9, "s"),
    ("stage", "stop_s", 1e-9, "s"), ("force", "silence_s", 1e-9, "s"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "field", "value", "unit"), TOO_SMALL)
def test_a_value_too_small_to_record_with_is_refused_with_field_floor_and_unit(
    tmp_path, table, field, value, unit
):
    text = REAL.format(rdt=1, http=1).replace(f"[{table}]\n", f"[{table}]\n{field} = {value}\n")
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"{table}.*{field} is 1e-09.* {re.escape(unit)} or more"):
        read_rig(path)


@pytest.mark.parametrize("box", [[0, 0, -5, 5], [0, 0, 5, 0], [-1, 0, 5, 5]])
def test_a_region_without_a_size_or_outside_the_picture_is_refused(tmp_path: Path, box: list[int]) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(REAL.format(rdt=1, http=1) + f'[[regions]]\nname = "part"\nbox_px = {box}\n')
    with refused("file-field", InputError, match="'part'"):
        read_rig(path)


@pytest.mark.parametrize("host", ["\\u0000", "a\\u2028b", "x" * 300, ""])
def test_a_host_that_is_none_is_refused_by_its_field(tmp_path: Path, host: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(REAL.format(rdt=1, http=1).replace("127.0.0.1", host))
    with refused("file-field", InputError):
        read_rig(path)


@pytest.mark.parametrize(
    "limits",
    [
        {"least_mm": (-30.0, -30.0, -20.0), "greatest_mm": (30.0, 30.0, -25.0)},
        {"least_mm": (-3000.0, -30.0, -20.0), "greatest_mm": (30.0, 30.0, 8.0)},
        {"least_mm": (-1.0, -1.0, -1.0), "greatest_mm": (1.0, 1.0, 1.0), "force_N": 49.0},
    ],
    ids=["least above greatest", "outside the travel", "force above the range"],
)
def test_limits_that_cannot_be_kept_are_refused_before_the_stage_is_homed(monkeypatch, tmp_path, limits):
    moved: list[str] = []
    one = virtual_rig()
    monkeypatch.setattr(opened_rig, "home_clear", lambda *_, **__: moved.append("homed"))
    monkeypatch.setattr(
        opened_rig, "open_part", lambda role, *_: {"stage": one.stage, "force": SmallForce(one.force)}[role]
    )
    path = tmp_path / "rig.toml"
    path.write_text(REAL.format(rdt=1, http=1).replace("[stage]\n", "[stage]\nhome = true\n"))
    file = read_rig(path)
    sound = file.model_copy(update={"limits": LimitsPart(least_mm=(-1, -1, -1), greatest_mm=(1, 1, 1))})
    with ExitStack() as opened:
        opened_rig.open_guarded(sound, one.clock, opened)
    assert moved == ["homed"]
    wrong = file.model_copy(update={"limits": LimitsPart(**limits)})
    with pytest.raises(InputError, match="limits"), ExitStack() as opened:
        opened_rig.open_guarded(wrong, one.clock, opened)
    assert moved == ["homed"]


class SmallForce:
    """A force sensor that measures to 25 N."""

    range_n = (25.0, 25.0, 25.0)

    def __init__(self, force: Any) -> None:
        self._force = force

    def __getattr__(self, name: str) -> Any:
        return getattr(self._force, name)

    def close(self) -> None:
        pass


# A rig's file with an arm: what it refuses, and the rig's check on it.

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
