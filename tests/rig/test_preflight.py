"""A real rig before its first motion: what is not as stated is named while all stands."""

import re
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from tests.refusals import refused
from tests.rig.lab_files import SOURCES, LabFile, lab_file
from tests.rig.test_rig_setup import LABS
from tests.slow_params import mostly_slow

from palpate.core.errors import PalpateError
from palpate.devices.long_running import SleepWatch
from palpate.devices.motion_limits import Reason, Tripped
from palpate.rig.engine import record
from palpate.rig.plans import Listed, StepHold
from palpate.rig.preflight import check_ready
from palpate.rig.rig_file import open_rig
from palpate.rig.run_progress import State

pytest.importorskip("serial", reason="a stage's port needs pyserial")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal needs POSIX")
SATURATED, ANALOG, COLD = 0x80020000, 1 << 31 | 1 << 28, 1 << 31 | 1 << 8
RAIL = (2**31 - 1,) * 6


def small() -> StepHold:
    places = Listed(kind="listed", at_mm=((0.0, 0.0),))
    return StepHold(name="small", places=places, cycles=1, depth_mm=0.4, step_mm=0.2, frames=1, taps=0)


def rejects(lab: LabFile, run: Path, **tables: dict[str, object]) -> str:
    """What recording on this rig's file says; nothing was sent that moves, and no run was made."""
    with pytest.raises(PalpateError) as told, closing(open_rig(lab.write(**tables), supervised=False)) as rig:
        record(rig, small(), run)
    assert not lab.jogged
    assert not run.exists()
    return str(told.value)


def spoiled(lab: LabFile, run: Path, spoil: Callable[[LabFile], None]) -> str:
    """The same, of devices that go wrong once the rig is open."""
    with closing(open_rig(lab.write())) as rig:
        spoil(lab)
        time.sleep(0.05)
        with pytest.raises(Tripped) as told:
            record(rig, small(), run)
    assert not lab.jogged
    assert not run.exists()
    return f"{told.value.reason.value}: {told.value}"


def test_a_rig_whose_devices_give_what_they_state_is_ready(tmp_path: Path) -> None:
    with lab_file(tmp_path) as lab, closing(open_rig(lab.write(), supervised=False)) as rig:
        check_ready(rig)


@pytest.mark.parametrize(("status", "said"), [(ANALOG, "analog board")])
def test_a_force_box_that_reports_its_load_missing_is_named_as_it_is_opened(tmp_path, status, said):
    with lab_file(tmp_path) as lab:
        lab.box.status = status
        message = rejects(lab, tmp_path / "run")
    assert said in message


def _status(lab: LabFile) -> None:
    lab.box.status = SATURATED


def _rail(lab: LabFile) -> None:
    lab.box.counts = RAIL


def _constant(lab: LabFile) -> None:
    lab.box.counts = (1000, 2000, 3000, 1, 2, 3)


def _offset(lab: LabFile) -> None:
    before = lab.force
    lab.box.force = lambda t: tuple(a + b for a, b in zip(before(t), (0.0, 0.0, 50.0), strict=True))


def _slow(lab: LabFile) -> None:
    lab.box.sent_hz = 50.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (_status, "force-fault: .*load cell plugged in"),
        (_rail, "force-fault: .*rail.*load cell plugged in"),
        (_constant, "force-stuck: .*equal samples.*load cell plugged in"),
        (_offset, r"force-fault: .*reads (49|50)\.\d+ N.*measures to 60 N.*15 N"),
        (_slow, r"force-slow: .*gave \d\d\.\d samples/s, and 500 are stated"),
    ],
)
def test_a_force_box_with_its_load_unplugged_is_named_before_the_first_motion(tmp_path, spoil, said):
    with lab_file(tmp_path) as lab:
        found = spoiled(lab, tmp_path / "run", spoil)
    assert re.match(said, found), found


def test_a_camera_at_half_its_rate_is_named_before_the_first_press_with_both_rates(tmp_path: Path) -> None:
    with lab_file(tmp_path) as lab:
        SOURCES[str(tmp_path)]._rate_hz = 10.0
        message = rejects(lab, tmp_path / "run")
    assert "camera" in message
    rate = float(message.split("gave ")[1].split()[0])
    assert rate == pytest.approx(10.0, rel=0.25)
    assert "20 are" in message


@pytest.mark.parametrize(
    ("tables", "said"),
    mostly_slow(
        [
            ({"stage": {"top_speed_mm_s": 100.0}}, r"100 mm/s is stated.*20 mm/s"),
            ({"stage": {"least_mm": [-150, 0, 0], "greatest_mm": [0, 100, 100]}}, r"-0\.15 to 0.*0\.1 m"),
            ({"limits": {"greatest_mm": [-10, 90, 135]}}, r"10 to 135 mm.*0 to 100 mm"),
            ({"limits": {"force_N": 45.0}, "force": {"axes": ["z", "y", "x"]}}, r"45 N.*30 N"),
            ({"limits": {"force_latency_s": 0.001}}, r"0\.001 s.*500 samples.*0\.002"),
            ({"force": {"silence_s": 0.001}}, r"0\.001.*500 records.*0\.006"),
            ({"camera": {"rate_hz": 40.0}}, r"gave \d\d\.\d.*40 are stated"),
        ],
        lambda i: i in (0, 4),
    ),
)
def test_a_file_that_promises_more_than_its_devices_do_is_refused_with_both_numbers(tmp_path, tables, said):
    with lab_file(tmp_path) as lab:
        message = rejects(lab, tmp_path / "run", **tables)
    assert re.search(said, message), message


def test_a_plan_faster_than_the_stages_acceleration_allows_is_refused_with_both_numbers(tmp_path) -> None:
    fast = small().model_copy(update={"press_mm_s": 15.0})
    with (
        lab_file(tmp_path) as lab,
        closing(open_rig(lab.write(), supervised=False)) as rig,
        refused("too-fast", Tripped),
    ):
        record(rig, fast, tmp_path / "run")


def test_the_computers_sleep_trips_once_and_steps_of_no_other_clock_do() -> None:
    slept = iter([100.0, 100.001, 130.0, 130.0, 130.0])
    watch = SleepWatch(lambda: next(slept))
    watch.look()
    with refused("clocks", Tripped, match=r"30\.0 s"):
        watch.look()
    watch.look()
    watch.look()
    silent = SleepWatch(lambda: None)
    silent.look()


@pytest.mark.slow
def test_a_small_plan_on_the_lab_is_done_and_one_through_which_the_computer_slept_stops_and_lifts(
    tmp_path, monkeypatch
):
    with lab_file(tmp_path) as lab:
        monkeypatch.setitem(LABS, "lab", lab)
        kind = "tests.rig.test_rig_setup:LabForce"  # on a busy machine the box's thread sends late
        lab.fields["force"] = {"kind": kind, "lab": "lab", "axes": ["x", "y", "-z"]}
        with closing(open_rig(lab.write(), supervised=False)) as rig:
            outcome = record(rig, small(), tmp_path / "run")
        assert outcome.state is State.DONE, outcome
        slept = iter([0.0] * 400 + [30.0] * 100_000)
        monkeypatch.setattr("palpate.rig.engine.SleepWatch", lambda: SleepWatch(lambda: next(slept)))
        with closing(open_rig(lab.write(), supervised=False)) as rig:
            outcome = record(rig, small(), tmp_path / "second")
        assert outcome.state is State.FAILED
        assert outcome.reason is Reason.CLOCKS
        assert "30.0 s" in outcome.message
        assert "not lifted" not in outcome.message
        assert -lab.stage.place_mm[2] < 30.0  # in the air


def test_steps_of_the_wall_clock_do_not_matter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hours = iter(range(0, 10**9, 3600))
    monkeypatch.setattr(time, "time", lambda: 1e9 - next(hours))  # each look finds it an hour further back
    with lab_file(tmp_path) as lab, closing(open_rig(lab.write(), supervised=False)) as rig:
        check_ready(rig)
        at = rig.stage.position_m()
        rig.stage.move_to((at[0] + 1e-3, at[1], at[2]), 5e-3)
        while rig.stage.moving():
            time.sleep(0.01)
        assert rig.stage.position_m()[0] == pytest.approx(at[0] + 1e-3, abs=1e-5)
