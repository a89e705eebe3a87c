"""Devices by the name of their class: opened where they keep the interface, refused by the law they break."""

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.installed_packages import lay_package
from tests.refusals import refused

from palpate.core.clock import MonotonicClock
from palpate.core.errors import DeviceError, InputError, PluginError
from palpate.devices import open_device
from palpate.devices.device_plugins import check_kind
from palpate.rig import open_rig
from palpate.rig.rig_file import RigFile, rig_from

GOOD = '''
import numpy as np
from palpate.core import DeviceError, Frame, MonotonicClock, Travel, Wrench


class Stage:
    """A stage that stands."""

    opened = []
    travel = Travel((-0.05, -0.05, -0.03), (0.05, 0.05, 0.02), 0.02, 0.5, 0.02)

    def __init__(self, port="COM3"):
        self.port, self.closed = port, False
        Stage.opened.append(self)

    def position_m(self):
        return (0.0, 0.0, -0.01)

    def move_to(self, position_m, speed_m_s):
        pass

    def moving(self):
        return False

    def stop(self):
        pass

    def close(self):
        self.closed = True


class Force:
    rate_hz, range_n = 1000.0, (20.0, 20.0, 60.0)
    opened = []

    def __init__(self, *, clock, gain=1.0):
        self.clock, self.gain, self.closed = clock, gain, False
        Force.opened.append(self)

    def latest(self):
        return Wrench(self.clock.now_ns(), (0.1, 0.2, 0.3 * self.gain))

    def drain(self):
        return [self.latest()]

    def close(self):
        self.closed = True


class Camera:
    rate_hz, size_px = 30.0, (64, 48)
    opened = []

    def __init__(self, clock):
        self.clock, self.closed = clock, False
        Camera.opened.append(self)

    def grab(self, timeout_s=1.0):
        time_ns = self.clock.now_ns()
        return time_ns, Frame(np.zeros((48, 64), np.uint8), time_ns / 1e9)

    def drain(self):
        return [self.grab()]

    def close(self):
        self.closed = True
'''

BROKEN = {
    # role, what is changed in the good one, and the law that this breaks
    "no stop": ("Stage", "del Broken.stop", "protocol-members"),
    "move_to without a speed": (
        "Stage",
        "Broken.move_to = lambda self, position_m: None",
        "protocol-arguments",
    ),
    "travel in millimetres": (
        "Stage",
        "Broken.travel = Travel((-50.0,) * 3, (50.0,) * 3, 20.0, 500.0, 0.02)",
        "travel-plausible",
    ),
    "position in millimetres": (
        "Stage",
        "Broken.position_m = lambda self: (0.0, 0.0, -10.0)",
        "position-in-travel",
    ),
    "position of two axes": ("Stage", "Broken.position_m = lambda self: (0.0, 0.0)", "position-type"),
    "moving as a word": ("Stage", "Broken.moving = lambda self: 'idle'", "moving-type"),
    "no drain": ("Force", "del Broken.drain", "protocol-members"),
    "no rate": ("Force", "Broken.rate_hz = 0.0", "rate-stated"),
    "range of one axis": ("Force", "Broken.range_n = (20.0,)", "range-stated"),
    "bare numbers": ("Force", "Broken.latest = lambda self: (0.0, 0.0, 0.1)", "sample-type"),
    "stamps in seconds": (
        "Force",
        "Broken.latest = lambda self: Wrench(int(self.clock.now_ns() / 1e9), (0.0, 0.0, 0.1))",
        "host-clock",
    ),
    "force in millinewtons": (
        "Force",
        "Broken.latest = lambda self: Wrench(self.clock.now_ns(), (100.0, 200.0, 300.0))",
        "force-in-range",
    ),
    "size as one number": ("Camera", "Broken.size_px = (3072,)", "size-stated"),
    "rows and columns changed over": ("Camera", "Broken.size_px = (48, 64)", "frame-size"),
    "a bare image": (
        "Camera",
        "Broken.grab = lambda self, timeout_s=1.0: np.zeros((48, 64), np.uint8)",
        "frame-type",
    ),
    "an exception of its own": (
        "Camera",
        "def grab(self, timeout_s=1.0):\n    raise KeyError('lens')\nBroken.grab = grab",
        "unexpected-error",
    ),
    "an exit": (
        "Force",
        "import sys\nBroken.latest = lambda self: sys.exit(0)",
        "unexpected-error.*SystemExit: 0, from bench_broken",
    ),
    "an exit of the camera": (
        "Camera",
        "import sys\nBroken.grab = lambda self, timeout_s=1.0: sys.exit(0)",
        "unexpected-error.*SystemExit: 0, from bench_broken",
    ),
    "no sample": ("Force", "Broken.latest = lambda self: None", "sample-type"),
}
ROLES: dict[str, Any] = {"Stage": "stage", "Force": "force", "Camera": "camera"}


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on Python's path, with a module of good devices in it."""
    before = set(sys.modules)
    (tmp_path / "bench_devices.py").write_text(GOOD)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if name.startswith("bench_"):
            del sys.modules[name]


@pytest.mark.parametrize("role", ROLES)
def test_a_class_that_keeps_the_interface_is_opened_by_its_name(bench: Path, role: str) -> None:
    device = open_device(ROLES[role], f"bench_devices:{role}", {}, MonotonicClock())
    assert type(device).__name__ == role
    assert not device.closed


@pytest.mark.parametrize(("role", "change", "law"), BROKEN.values(), ids=BROKEN)
def test_what_breaks_the_interface_is_refused_by_its_law_and_closed(
    bench: Path, role: str, change: str, law: str
) -> None:
    text = GOOD.replace(f"class {role}:", "class Broken:").replace(f"{role}.opened", "Broken.opened")
    (bench / "bench_broken.py").write_text(f"{text}\n\n{change}\n")
    with refused("protocol-broken", InputError, match=law):
        open_device(ROLES[role], "bench_broken:Broken", {}, MonotonicClock())
    import bench_broken  # type: ignore[import-not-found]

    assert [one.closed for one in bench_broken.Broken.opened] == [True]


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        ("bench_nowhere:Stage", "plugin-import"),
        ("bench_devices:Gantry", "plugin-import"),
        ("bench_raises:Stage", "plugin-import"),
        ("bench_devices:np.pi", "not-callable"),
    ],
)
def test_what_does_not_import_is_refused_by_name(bench: Path, kind: str, code: str) -> None:
    (bench / "bench_raises.py").write_text("raise OSError('this machine has no driver')\n")
    with refused(code, InputError, match=f"'{kind}'"):
        open_device("stage", kind, {}, MonotonicClock())


def test_an_option_that_a_device_does_not_take_is_refused_before_it_is_opened(bench: Path) -> None:
    with refused("device-options", InputError, match="'prot'"):
        open_device("stage", "bench_devices:Stage", {"prot": "COM4"}, MonotonicClock())
    import bench_devices  # type: ignore[import-not-found]

    assert not bench_devices.Stage.opened


def test_a_device_that_says_what_is_wrong_says_it_unchanged(bench: Path) -> None:
    (bench / "bench_gone.py").write_text(
        "from palpate.core import DeviceError\ndef stage():\n    raise DeviceError('no answer on COM3')\n"
    )
    with refused("device", DeviceError, match="COM3$"):
        open_device("stage", "bench_gone:stage", {}, MonotonicClock())
    (bench / "bench_rude.py").write_text("def stage():\n    raise KeyError('COM3')\n")
    with refused("plugin-import", InputError):
        open_device("stage", "bench_rude:stage", {}, MonotonicClock())
    (bench / "bench_leaves.py").write_text("import sys\ndef stage():\n    sys.exit(0)\n")
    with refused("plugin-import", InputError, match="bench_leaves:stage"):
        open_device("stage", "bench_leaves:stage", {}, MonotonicClock())


def test_an_installed_package_registers_a_device_by_a_name(bench: Path) -> None:
    lay_package(bench, "bench_gantry", "palpate.stages", "gantry", "bench_devices:Stage")
    check_kind("stage", "gantry", ("grbl",))
    assert open_device("stage", "gantry", {"port": "COM9"}, MonotonicClock()).port == "COM9"
    with refused("unknown-name", InputError, match="'gantry'"):
        check_kind("camera", "gantry", ("uvc",))


def test_a_package_that_takes_an_existing_name_is_refused_by_name(bench: Path) -> None:
    lay_package(bench, "bench_one", "palpate.stages", "grbl", "bench_devices:Stage")
    with refused("name-taken", InputError, match="'grbl'"):
        check_kind("stage", "grbl", ("grbl",))
    lay_package(bench, "bench_two", "palpate.stages", "gantry", "bench_devices:Stage")
    lay_package(bench, "bench_three", "palpate.stages", "gantry", "bench_other:Stage")
    with refused("name-taken", InputError, match="'gantry'"):
        check_kind("stage", "gantry", ("grbl",))


FILE = """
name = "own bench"
[stage]
kind = "bench_devices:Stage"
port = "COM7"
[force]
kind = "bench_devices:Force"
axes = ["x", "-y", "-z"]
gain = 2.0
[camera]
kind = "bench_devices:Camera"
[limits]
least_mm = [-30, -30, -20]
greatest_mm = [30, 30, 8]
"""


def test_a_rigs_file_names_ones_own_devices_and_their_options(bench: Path) -> None:
    path = bench / "rig.toml"
    path.write_text(FILE)
    rig = open_rig(str(path), supervised=False)
    assert rig.stage.port == "COM7"  # type: ignore[attr-defined]
    assert rig.force.latest().force_n[2] == pytest.approx(0.6)
    assert rig.mounting.axes == ("x", "-y", "-z")
    assert rig.camera.size_px == (64, 48)
    rig.close()


def test_a_device_that_leaves_python_when_closed_is_told_and_the_others_are_closed(bench: Path) -> None:
    path = bench / "rig.toml"
    path.write_text(FILE)
    rig = open_rig(str(path), supervised=False)
    rig.force.close = lambda: sys.exit(0)  # type: ignore[method-assign]
    with refused("plugin-import", PluginError):
        rig.close()
    assert rig.camera.closed  # type: ignore[attr-defined]


def test_the_same_devices_are_named_from_python(bench: Path) -> None:
    file = RigFile.model_validate(
        {
            "name": "own bench",
            "stage": {"kind": "bench_devices:Stage"},
            "force": {"kind": "bench_devices:Force"},
            "camera": {"kind": "bench_devices:Camera"},
            "limits": {"least_mm": (-30, -30, -20), "greatest_mm": (30, 30, 8)},
        }
    )
    rig = rig_from(file, supervised=False)
    assert not rig.stage.moving()
    rig.close()


@pytest.mark.parametrize(
    ("before", "after", "code", "named"),
    [
        ("bench_devices:Camera", "bench_broken:Camera", "plugin-import", "'bench_broken:Camera'"),
        ("bench_devices:Camera", "webcam", "unknown-name", "camera.kind:"),
        ('port = "COM7"', "prot = 1", "device-options", "'prot'"),
        ('axes = ["x", "-y", "-z"]', 'axes = ["x", "-y"]', "file-field", "force.axes"),
        ('kind = "bench_devices:Stage"', 'kind = "grbl"\nspeed = 3', "file-field", "stage.speed"),
    ],
)
def test_a_file_that_names_a_device_wrongly_is_refused_and_nothing_stays_open(
    bench: Path, before: str, after: str, code: str, named: str
) -> None:
    path = bench / "rig.toml"
    path.write_text(textwrap.dedent(FILE.replace(before, after)))
    with refused(code, InputError, match=named):
        open_rig(str(path), supervised=False)
    import bench_devices

    opened = [*bench_devices.Force.opened, *bench_devices.Camera.opened, *bench_devices.Stage.opened]
    assert all(one.closed for one in opened)
