"""The supervisor's process: it guards as one process does, and lifts whatever becomes of its client."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.refusals import refused
from tests.rig import supervised_bench
from tests.rig.conftest import until
from tests.slow_params import mostly_slow

from palpate.core.errors import DeviceError
from palpate.devices import ForceBias, ForceReached, OperatorCommand, OperatorControl, Reason, Tripped
from palpate.devices.motion_guard import Clearance
from palpate.devices.rpc import supervisor_name
from palpate.devices.rpc_client import RpcClient
from palpate.devices.supervisor import SupervisedGuard, guard_supervisor, process_link
from palpate.rig import open_rig
from palpate.rig.commissioning.bench import stop_rig
from palpate.rig.plans import Listed, StepHold
from palpate.rig.rig import Rig
from palpate.rig.service.rig_client import RigClient, launch, open_served_rig, rig_name
from palpate.rig.service.rig_service import RigService

MM = 1e-3
REPOSITORY = Path(__file__).resolve().parents[2]
FREE_M = -1.5e-3  # the clearance
RIG = """
name = "supervised"
design = "palm"
[stage]
kind = "supervised_bench:BenchStage"
log = "{log}"
{stage}
[force]
kind = "supervised_bench:BenchForce"
[camera]
kind = "supervised_bench:BenchCamera"
{camera}
[limits]
least_mm = [-5, -5, -5]
greatest_mm = [5, 5, 4]
force_N = 6
"""
PLAN = StepHold(
    taps=0, name="small", places=Listed(kind="listed", at_mm=((0.0, 0.0), (1.0, 0.0))), depth_mm=1.0,
    step_mm=0.5, frames=2, reference_frames=1, clearance_mm=1.5, seek_mm=1.0, travel_mm_s=15.0,
    press_mm_s=2.0, seek_mm_s=2.0, cycles=1,
)  # fmt: skip


class Supervised:
    """A rig's file, and what its stage noted on disk."""

    def __init__(self, folder: Path, stage: str = "", camera: str = "") -> None:
        self.path, self.log = folder / "rig.toml", folder / "stage.jsonl"
        self.path.write_text(RIG.format(log=self.log, stage=stage, camera=camera))

    def opens_at_once(self) -> None:
        """From now on: for whoever opens it next."""
        self.path.write_text(RIG.format(log=self.log, stage="", camera=""))

    def noted(self, what: str) -> list[dict[str, Any]]:
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return [one for one in map(json.loads, lines) if one["what"] == what]

    def z_m(self) -> float:
        """Where it stood when it was closed."""
        return float(self.noted("close")[-1]["place"][2])


@pytest.fixture
def supervised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Supervised]:
    monkeypatch.syspath_prepend(str(Path(supervised_bench.__file__).parent))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return lambda **fields: Supervised(tmp_path, **fields)


def guarded(rig: Rig, control: OperatorControl | None = None) -> SupervisedGuard:
    """A guard that has measured its zero, its clearance stated."""
    assert rig.supervisor is not None
    guard = SupervisedGuard(rig.supervisor, rig.force, ForceBias(rig.mounting), control or OperatorControl())
    guard.clearance = Clearance(FREE_M, 15 * MM)
    guard.tare(rig.force.rate_hz)
    return guard


def test_who_subscribed_is_told_and_a_force_reached_its_limit_and_an_exception_end_a_move(supervised) -> None:
    with opened(supervised()) as rig:
        guard = guarded(rig)
        samples: list[int] = []
        places: list[float] = []
        guard.samples.subscribe(lambda batch: samples.extend(one.time_ns for one in batch))
        guard.positions.subscribe(lambda at, time_ns: places.append(at[2]))
        assert guard.towards((0.0, 0.0, 3 * MM), 2 * MM, ForceReached(2.0))
        assert guard.position_m()[2] == pytest.approx(1.0 * MM, abs=0.1 * MM)
        assert samples == sorted(set(samples)), "in order, and none twice"
        gaps_ms = [(b - a) / 1e6 for a, b in pairwise(samples)]
        assert max(gaps_ms) < 2.01, "none is missing"
        assert len(places) > 20
        guard.lift()
        assert guard.position_m()[2] == pytest.approx(FREE_M)
        with refused("force-limit", Tripped, match="6 N"):
            guard.towards((0.0, 0.0, 4 * MM), 2 * MM, step_m=4 * MM)
        guard.lift()

        def full(*seen: object) -> None:
            if places[-1] > -0.5 * MM:
                raise OSError("no space left")

        guard.looks.subscribe(full)
        with pytest.raises(OSError, match="no space"):
            guard.towards((0.0, 0.0, 2 * MM), 2 * MM, step_m=5 * MM)
        assert FREE_M < guard.position_m()[2] < 2 * MM, "under way, where nothing else ends a motion"
        guard.looks.unsubscribe(full)
        guard.lift()


@pytest.mark.parametrize(
    "command", mostly_slow([OperatorCommand.ABORT, OperatorCommand.ESTOP], lambda i: i == 1)
)
def test_a_command_acts_in_the_supervisor_while_who_asked_hangs(supervised, command) -> None:
    bench = supervised()
    with opened(bench) as rig:
        control = OperatorControl()
        guard = guarded(rig, control)
        asked_ns: list[int] = []

        def hang(*seen: object) -> None:
            if not asked_ns and guard.position_m()[2] > 0.2 * MM:
                asked_ns.append(time.monotonic_ns())
                control.ask(command)
                time.sleep(0.5)  # the client's one thread that records

        guard.looks.subscribe(hang)
        with pytest.raises(BaseException, match=command.value):
            guard.towards((0.0, 0.0, 3 * MM), 2 * MM, step_m=5 * MM)
        stopped = [one for one in bench.noted("stop") if one["time_ns"] > asked_ns[0]]
        assert (stopped[0]["time_ns"] - asked_ns[0]) / 1e6 < 300, "before the client awoke"


def test_a_client_that_hangs_in_a_motion_is_left_and_the_probe_is_lifted(supervised) -> None:
    bench = supervised()
    with opened(bench) as rig:
        guard = guarded(rig)

        hung: list[int] = []

        def hang(*seen: object) -> None:
            if not hung:
                hung.append(1)
                time.sleep(guard_supervisor.MOVING_S + 1.0)

        guard.looks.subscribe(hang)
        with refused("client-silent", Tripped):
            guard.towards((0.0, 0.0, 3 * MM), 0.5 * MM, step_m=5 * MM)
        assert guard.position_m()[2] == pytest.approx(FREE_M)


CHILD = """
import sys, time
sys.path[:0] = [{repository!r}, {folder!r}]
from tests.rig.test_supervisor import guarded, MM
from palpate.rig import open_rig
rig = open_rig(sys.argv[1])
guard = guarded(rig)
guard.towards((0.0, 0.0, 1 * MM), 2 * MM)
print("in", flush=True)
{then}
"""
MOVES = "guard.towards((0.0, 0.0, 3 * MM), 0.2 * MM, step_m=5 * MM)"


@pytest.mark.parametrize(
    "then",
    mostly_slow(["time.sleep(60)", MOVES], lambda i: i == 1),
    ids=["standing in the skin", "moving into it"],
)
def test_a_client_that_is_killed_leaves_no_probe_in_the_skin(supervised, then: str) -> None:
    bench = supervised()
    with child(bench, then) as client:
        time.sleep(0.4)
        client.kill()
        until(lambda: bench.noted("close"))
    assert bench.z_m() == pytest.approx(FREE_M)


@pytest.mark.slow
def test_a_client_that_stops_saying_anything_in_the_skin_is_not_waited_for(supervised, monkeypatch) -> None:
    bench = supervised()
    with child(bench, "time.sleep(60)") as client:
        os.kill(client.pid, signal.SIGSTOP)
        begun_s = time.monotonic()
        until(lambda: bench.noted("move")[-1]["place"][2] == FREE_M)
        assert time.monotonic() - begun_s > guard_supervisor.STANDING_S - 1
        client.kill()
        until(lambda: bench.noted("close"))


def test_a_supervisor_that_dies_is_told_at_once_and_by_name(supervised) -> None:
    with opened(supervised()) as rig:
        guard = guarded(rig)
        assert rig.supervisor is not None
        os.kill(rig.supervisor.pid, signal.SIGKILL)
        begun_s = time.monotonic()
        with refused("supervisor", Tripped):
            guard.towards((0.0, 0.0, 1 * MM), 1 * MM)
        assert time.monotonic() - begun_s < 2.0


@contextmanager
def hanging(bench: Supervised):
    """A rig whose supervisor hangs, and a guard that was taught before."""
    rig = open_rig(str(bench.path))
    assert rig.supervisor is not None
    control = OperatorControl()
    guard = guarded(rig, control)
    os.kill(rig.supervisor.pid, signal.SIGSTOP)
    try:
        yield rig, guard, control
    finally:
        os.kill(rig.supervisor.pid, signal.SIGCONT)
        gone = Path(f"/proc/{rig.supervisor.pid}")
        until(lambda: not gone.exists() and not lingering())


@pytest.mark.slow
def test_a_supervisor_that_hangs_is_told_once_within_seconds_and_then_at_once(supervised) -> None:
    bench = supervised()
    with hanging(bench) as (rig, guard, _):
        with refused("stop-not-confirmed", DeviceError):
            stop_rig(str(bench.path))  # it opens no second stage
        assert not bench.noted("stop")
        begun_s = time.monotonic()
        with pytest.raises(Tripped, match="rig's switch") as tripped:
            guard.towards((0.0, 0.0, 1 * MM), 1 * MM)
        first_s = time.monotonic() - begun_s
        assert tripped.value.reason is Reason.SUPERVISOR
        for ask in (guard.lift, guard.position_m, guard.halt):
            with pytest.raises(Tripped, match="rig's switch"):
                ask()
        with pytest.raises(DeviceError, match="switch"):
            rig.close()
        assert time.monotonic() - begun_s < first_s + 5.0, "after the first silence nothing is waited for"
        assert first_s < 15.0


@pytest.mark.slow
def test_a_supervisor_whose_device_is_slow_is_not_taken_for_one_that_hangs(supervised, monkeypatch) -> None:
    monkeypatch.setattr(process_link, "PROBE_S", 0.1)
    monkeypatch.setattr(process_link, "SILENT_S", 1.0)
    with opened(supervised(stage="moving_s = 2.5")) as rig:
        assert rig.supervisor is not None
        assert rig.supervisor.ask("moving") is False


def test_anybody_of_the_same_user_may_stop_it_past_its_client(supervised) -> None:
    bench = supervised()
    with child(bench, MOVES) as client, RpcClient(supervisor_name(str(bench.path))) as anybody:
        assert anybody.reached(5.0)
        asked = anybody.ask("estop")
        assert (asked["stood_ns"] - asked["asked_ns"]) / 1e6 < 200
        z = float(bench.noted("stop")[-1]["place"][2])
        client.wait(10)
        until(lambda: bench.noted("close"))
    assert z > 1 * MM
    assert bench.z_m() == pytest.approx(z, abs=1e-6), "an emergency stop moves nothing, also not away"


@pytest.mark.parametrize("name", ["SIGKILL", "SIGSTOP"])
@pytest.mark.cases(1)
def test_the_stop_command_reaches_the_stage_while_the_recording_process_is_dead_or_hangs(supervised, name):
    bench = supervised()
    with child(bench, MOVES) as client:
        client.send_signal(getattr(signal, name))
        begun_ns = time.monotonic_ns()
        command = [sys.executable, "-m", "palpate.cli", "rig", "stop", str(bench.path), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done
        found = json.loads(done.stdout)
        assert found["code"] in ("stopped", "stopped-on-port")
        assert bench.noted("stop")
        if found["code"] == "stopped":  # else the supervisor had stopped and lifted by itself already
            assert found["stood_ns"] > begun_ns
            assert [one["name"] for one in found["processes"]] == [supervisor_name(str(bench.path))]
        client.kill()
        client.wait(10)
        until(lambda: bench.noted("close"))


@pytest.mark.slow
@pytest.mark.parametrize("ends", [signal.SIGKILL, signal.SIGINT, None], ids=["killed", "Ctrl-C", "rig stop"])
def test_whatever_ends_a_client_while_a_stage_homes_ends_that_as_well(supervised, ends) -> None:
    bench = supervised(stage="opens_s = 60.0")
    with subprocess.Popen([sys.executable, "-c", code_of(""), str(bench.path)], cwd=REPOSITORY) as client:
        until(lambda: bench.noted("opens"))
        bench.opens_at_once()
        if ends:
            client.send_signal(ends)
        else:
            done = stop_rig(str(bench.path))
            assert ([one.code for one in done.holders], done.code) == (["opening-ended"], "stopped-on-port")
        until(lambda: bench.noted("abandoned"))
        assert client.wait(20) != 0


def lingering() -> list[str]:
    return [one.name for one in threading.enumerate() if one.name == "palpate-supervisor-end"]


def code_of(then: str) -> str:
    return CHILD.format(repository=str(REPOSITORY), folder=str(Path(__file__).parent), then=then)


def opened(bench: Supervised) -> Any:
    return closing(open_rig(str(bench.path)))


def child(bench: Supervised, then: str) -> Any:
    """A process that records, killed at the latest when the block ends."""

    @contextmanager
    def running():
        code = code_of(then)
        with subprocess.Popen(
            [sys.executable, "-c", code, str(bench.path)], stdout=subprocess.PIPE, text=True
        ) as one:
            assert one.stdout is not None
            try:
                assert one.stdout.readline() == "in\n"
                yield one
            finally:
                one.kill()

    return running()


@pytest.mark.slow
def test_the_studios_process_records_through_the_supervisor_and_stops_it(supervised, tmp_path: Path) -> None:
    bench = supervised()
    service = RigService(open_served_rig(str(bench.path)), tmp_path / "runs")
    try:
        service.plan(PLAN.model_dump(mode="json"))
        service.start("one")
        until(lambda: service.status()["position_mm"] and service.status()["position_mm"][2] > 0.2)
        stood = service.estop()
        assert (stood["stood_ns"] - stood["asked_ns"]) / 1e6 < 200
        until(lambda: not service.recording)
        z = float(bench.noted("stop")[-1]["place"][2])
        assert z > FREE_M, "an emergency stop does not lift"
        assert service.status()["state"] == "e-stopped"
        service.release()
        service.start("one")
        until(lambda: not service.recording)
        assert (service.status()["state"], service.status()["shots"]) == ("done", service.status()["planned"])
        assert service.status()["force_n"] is not None
    finally:
        service.close()
    assert bench.z_m() <= FREE_M + 1e-5


@pytest.mark.slow
def test_the_pages_emergency_stop_passes_a_recorder_that_hangs(supervised, tmp_path, monkeypatch) -> None:
    bench = supervised()
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(Path(supervised_bench.__file__).parent), *sys.path])
    )
    process, _ = launch(str(bench.path), tmp_path / "runs")
    try:
        with RigClient(rig_name(str(bench.path))) as page:
            assert page.reached(20.0)
            page.plan(PLAN.model_dump(mode="json"))
            page.start("one")
            until(lambda: any(one["place"][2] > 0.2 * MM for one in bench.noted("move")))
            os.kill(process.pid, signal.SIGSTOP)
            asked_ns = time.monotonic_ns()
            stood = page.estop()
            assert (stood["stood_ns"] - asked_ns) / 1e6 < 300
            moves = len(bench.noted("move"))
            time.sleep(0.3)
            assert len(bench.noted("move")) == moves, "held, and nobody moves it"
    finally:
        process.kill()
        process.wait()
    until(lambda: bench.noted("close"))
    assert bench.z_m() > FREE_M
