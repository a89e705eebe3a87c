"""A rig from a file: what it says is opened, and what it says wrongly is refused by name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from tests.rig.rigs import plan

from palpate.core import MonotonicClock
from palpate.core.errors import DeviceError, InputError
from palpate.devices.motion_limits import Reason
from palpate.devices.rpc import path_of
from palpate.rig import State, open_rig, record
from palpate.rig.fakes.grbl_parameters import GrblParameters
from palpate.rig.fakes.netft_box import FakeNetFT
from palpate.rig.rig_file import GrblPart, read_rig
from palpate.rig.service import rig_name, served_rig
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
    outcome = record(rig, plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.NO_CONTACT)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name = ", "TOML"),
        ('nam = "x"', "nam"),
        ('name = "x"', r"\[stage\]"),
        ('name = "x"\n[virtual]\nsead = 1', "sead"),
        ('name = "x"\n[virtual]\nfaults = [{ kind = "rain" }]', "force-stalls"),
        ('name = "x"\n[virtual]\nfaults = [{ after = 1 }]', "after"),
        ('name = "x"\n[virtual]\n[stage]\nkind = "grbl"\nport = "p"', "leave one out"),
        ('name = "x"\n[stage]\nkind = "klipper"\nport = "p"', "stage.kind"),
        ('name = "x"\n[stage]\nkind = "marlin"\nport = "p"\nspeed = 1', "stage.speed"),
        ('name = "x"\n[label_force]\nkind = "scales"', "label_force.kind"),
        (
            'name = "x"\n[virtual]\n[limits]\nleast_mm = [0, 0, 0]\ngreatest_mm = [1, 1, 1]\nforce_N = -1',
            "force_N",
        ),
        (
            'name = "x"\n[virtual]\n[limits]\nleast_mm = [0, 0, 0]\ngreatest_mm = [1, 1, 1]\nforce_N = 1e9',
            r"1e\+09, and 50 is the greatest",
        ),
    ],
)
def test_a_file_that_says_something_wrong_is_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
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
    opened = served_rig.open_served_rig(path)
    assert opened.real_time
    assert opened.rig.regions == (("rim", (1, 2, 30, 40)),)
    assert opened.rig.limits.age_s == REAL_TIME_AGE_S
    opened.rig.close()
    plain = served_rig.open_served_rig(written(tmp_path, 'name = "b"\n[virtual]'))
    assert [region.name for region in plain.rig.regions] == ["fringes", "mirror"]
    assert not plain.real_time
    plain.rig.close()


def test_a_rigs_process_is_found_by_its_files_whole_path_however_long(tmp_path: Path) -> None:
    assert rig_name("virtual:palm") == "virtual:palm"
    one, other = (path_of(f"/{first}{'x' * 300}/bench.toml", tmp_path).name for first in "ab")
    assert one != other
    assert len(one) < 120
    with pytest.raises(InputError, match="no such file"):
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
def test_a_limit_beyond_its_ceiling_is_refused_with_both_numbers(
    tmp_path: Path, field: str, value: str, most: str
) -> None:
    text = 'name = "x"\n[virtual]\n[limits]\nleast_mm = [-1, -1, -1]\ngreatest_mm = [1, 1, 1]\n'
    said = re.escape(f"{field} is {float(value):g}, and {most} is the greatest")
    with pytest.raises(InputError, match=said):
        read_rig(Path(written(tmp_path, f"{text}{field} = {value}")))
    assert read_rig(Path(written(tmp_path, f"{text}{field} = {most}"))).limits is not None


@pytest.mark.parametrize(
    ("said", "refused"),
    [
        ("require_homed = false", "reference"),
        ('require_homed = false\nreference = "counts"\nhome = true', "switches"),
        ("reply_s = 31", "31.*30"),
        ("top_speed_mm_s = 201", "201.*200"),
        ("baud = 300", "baud"),
        ('reference = "somewhere"', "reference"),
    ],
)
def test_a_stage_that_cannot_be_as_it_is_stated_is_refused_before_its_port_is_opened(
    tmp_path: Path, said: str, refused: str
) -> None:
    with pytest.raises(InputError, match=refused):
        read_rig(Path(written(tmp_path, f'name = "x"\n[stage]\nkind = "grbl"\nport = "p"\n{said}')))


def test_what_a_file_says_of_a_stage_without_switches_reaches_its_driver(grbl_bench: Any) -> None:
    bench = grbl_bench(GrblParameters(settings={20: 0, 22: 0}, homed=True), clock=MonotonicClock())
    part = GrblPart(
        kind="grbl",
        port=bench.terminal.path,
        require_homed=False,
        reference=(1.0, 2.0, 3.0),
        least_mm=(-10, -10, -10),
        greatest_mm=(10, 10, 10),
        top_speed_mm_s=3.0,
        boot_s=0.05,
        reply_s=10.0,
    )
    stage = part.open(MonotonicClock())
    try:
        assert stage.position_m() == pytest.approx((1e-3, 2e-3, 3e-3))
        assert stage.travel.top_speed_m_s == pytest.approx(3e-3)
        assert stage.travel.greatest_m == pytest.approx((0.01,) * 3)
    finally:
        stage.close()
