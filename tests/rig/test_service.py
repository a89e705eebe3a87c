"""The hardware loop as a process of its own: over real sockets, with a virtual rig."""

import json
import math
import os
import signal
import socket
import stat
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress

import pytest
from hypothesis import given, strategies as st
from tests.refusals import refused

from palpate.cli.study.study_verbs import _leave as leave_rig
from palpate.core import InputError, RecordingError
from palpate.core.errors import DeviceError, ProtocolError, SafetyError
from palpate.devices.device_proxies import StageProxy
from palpate.devices.operator_control import OperatorInterrupt
from palpate.devices.rpc import ASKED_BYTES, Address, Lines, decode_message, find, publish
from palpate.recordings import Run
from palpate.rig.plans import plan_from
from palpate.rig.run_progress import done_in
from palpate.rig.service import RigClient, RigServer, RigService, launch, open_served_rig

RIG = "virtual:palm"
HALT_S = 0.05  # from the client's call until the stage stands, of a press into the skin
MAX_S = 30.0  # for anything to come about, however busy the machine


def tiny(**changed):
    """One place, two shots."""
    fields = {
        "name": "tiny", "places": {"kind": "listed", "at_mm": [[0.0, 0.0]]}, "cycles": 1, "depth_mm": 0.5,
        "step_mm": 0.5, "frames": 1, "reference_frames": 1, "taps": 0, "seek_mm_s": 5.0,
    }  # fmt: skip
    return fields | changed


TWICE = {"kind": "listed", "at_mm": [[0.0, 0.0], [2.0, 0.0]]}


@contextmanager
def served(tmp_path, *, accelerated):
    opened = open_served_rig(RIG, accelerated=accelerated)
    service = RigService(opened, tmp_path / "runs")
    server = RigServer(service)
    publish(Address(RIG, server.port, server.token, os.getpid()), tmp_path / "at")
    with RigClient(RIG, tmp_path / "at") as client:
        try:
            client.wait_for(lambda status: True, MAX_S)
            yield client, server, opened.rig
        finally:
            service.close()
            server.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("quick")


@pytest.fixture(scope="module")
def quick(folder):
    """Time runs as fast as it is asked to; shared, so every test names its own run."""
    with served(folder, accelerated=True) as found:
        yield found


@pytest.fixture
def real(tmp_path):
    """Time is the machine's."""
    with served(tmp_path, accelerated=False) as found:
        yield found


def raw(server, *lines):
    """A connection that has sent these bytes."""
    connection = socket.create_connection(("127.0.0.1", server.port), 5)
    connection.sendall(b"".join(lines))
    return connection


def known(server, *lines):
    """A connection that has said the token, and then these bytes."""
    return raw(server, json.dumps({"token": server.token, "id": 0}).encode() + b"\n", *lines)


def replies(connection, count):
    """The next replies; what is pushed is left out."""
    found, lines = [], Lines(1 << 24)
    while len(found) < count and (data := connection.recv(1 << 16)):
        found += [m for line in lines.feed(data) if line and "push" not in (m := decode_message(line))]
    return found


def ended(status):
    return not status["recording"] and status["state"] not in ("ready", "running")


def record(client, name, plan):
    client.plan(plan)
    client.start(name)
    return client.wait_for(ended, MAX_S)


def shots_of(path):
    return done_in(Run.open(path))


def planned(fields):
    plan = plan_from(fields)
    return {
        shot.key: frozenset(range(frames)) for press in plan.presses() for shot, frames in plan.shots(press)
    }


WHOLE = tiny(places=TWICE, frames=2)


@pytest.fixture(scope="module")
def whole(quick):
    """The last status of a run that was asked for over the socket."""
    return record(quick[0], "whole", WHOLE)


def test_a_run_asked_for_over_the_socket_holds_exactly_the_plans_shots(quick, whole, folder):
    client, last = quick[0], whole
    assert (last["state"], last["shots"], last["planned"]) == ("done", 4, 4)
    assert shots_of(folder / "runs" / "whole") == planned(WHOLE)
    assert client.picture is not None
    assert client.picture[1].startswith(b"\xff\xd8")  # a JPEG
    assert [one["name"] for one in last["devices"]] == ["stage", "force sensor", "camera"]
    assert last["simulated"]
    assert last["tared"]
    series = last["series"]
    assert all(0 <= age <= 20.1 for age in series["age_s"])
    labelled = Run.open(folder / "runs" / "whole").labels["force_N"].max()
    # At the deepest stand the label is a mean over an exposure; of the series each bin's greatest is told,
    # and the skin relaxes while it is looked at: a little above the label, never below.
    assert labelled - 0.05 < max(series["z"]) < 1.1 * labelled + 0.05
    # Lifted again and its zero taken off: noise of 5 mN, and a zero that drifts by 10 mN in a minute.
    assert last["force_n"] == pytest.approx([0, 0, 0], abs=0.06)


HOSTILE = [
    b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"\x00\xff\xfe\n", b"[]\n", b"null\n", b"[" * 100_000 + b"\n",
    b'{"do": NaN}\n', b'{"do": ["estop"]}\n', b'{"do": "plan"}\n',
    b'{"do": "plan", "plan": {"cycles": 1e999}}\n',
    b'{"do": "plan", "plan": {"places": {"kind": "scattered", "count": 100000}}}\n',
    b'{"do": "plan", "plan": {"cycles": 1000000}}\n',
    b'{"do": "plan", "plan": {"depth_mm": 1.0, "step_mm": 1e-300}}\n',
    b'{"do": "start", "out": "a\\u0000b"}\n', b'{"do": "start", "out": "\\ud800"}\n',
    b'{"do": "start", "out": "../x"}\n', b'{"do": "start", "out": ""}\n', b'{"do": "start", "out": 7}\n',
    b'{"do": "resume", "id": 1e400}\n', b'{"do": "pause", "id": {}}\n',
]  # fmt: skip


def test_whatever_is_sent_is_answered_with_an_error_and_changes_nothing(quick, folder):
    client, server, _ = quick
    runs = set(folder.glob("runs/*"))
    before = client.ask_status()
    for line in HOSTILE:
        with closing(known(server, line)) as connection:
            said = replies(connection, 2)
            assert said[0]["ok"]
            assert not said[1]["ok"], line[:60]
            assert said[1]["error"]
    after = client.ask_status()
    assert not after["recording"]
    assert after["plan"] == before["plan"]
    assert after["position_mm"] == before["position_mm"]
    assert set(folder.glob("runs/*")) == runs


def test_a_line_without_an_end_is_refused_and_not_kept(quick):
    client, server, _ = quick
    with closing(known(server, b"x" * (3 * ASKED_BYTES) + b"\n" + b'{"do":"status","id":5}\n')) as connection:
        _, long, status = replies(connection, 3)
    assert (long["ok"], long["kind"]) == (False, "ProtocolError")
    assert (status["ok"], status["id"]) == (True, 5)
    lines = Lines(100)
    for _ in range(1000):
        assert list(lines.feed(b"y" * 99)) == []
    assert len(lines._line) <= 100
    assert list(lines.feed(b"\nok\n")) == [None, b"ok"]
    assert client.ask_status()


@given(st.binary(max_size=300))
def test_a_line_is_a_message_or_a_protocol_error(data):
    with suppress(ProtocolError):
        assert isinstance(decode_message(data), dict)


def test_who_does_not_say_the_token_moves_nothing_and_is_told_nothing(quick):
    client, server, _ = quick
    client.plan(tiny())
    for token in (b'{"token": "wrong"}\n', b'{"token": 7}\n', b'{"token": ""}\n', b'{"do": "estop"}\n'):
        with closing(raw(server, token, b'{"do": "start", "out": "theirs"}\n')) as connection:
            said = b""
            while data := connection.recv(1 << 16):
                said += data
        assert said.count(b"\n") == 1
        assert b"token first" in said
    status = client.ask_status()
    assert not status["recording"]
    assert not status["held"]


def test_it_listens_to_this_machine_alone_and_its_token_is_the_users_alone(quick, folder):
    _, server, _ = quick
    assert server._admission._listener.getsockname()[0] == "127.0.0.1"
    path = next((folder / "at").glob("*.json"))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert len(server.token) >= 32


def test_an_address_that_is_none_is_as_good_as_no_address(tmp_path):
    assert find(RIG, tmp_path) is None
    path = publish(Address(RIG, 1, "t", 1), tmp_path)
    assert find(RIG, tmp_path) == Address(RIG, 1, "t", 1)
    for damaged in (b"", b"{}", b"[1]", b"\xff" * 10_000, b'{"rig":1,"port":"x","token":2,"pid":3}'):
        path.write_bytes(damaged)
        assert find(RIG, tmp_path) is None


def test_clients_that_leave_or_read_nothing_and_an_emergency_stop_at_rest_change_no_run(quick, folder):
    client, server, _ = quick
    client.estop()
    with refused("emergency-stop", SafetyError):
        client.start("never")
    assert client.ask_status()["devices"][0]["state"] == "held"
    client.release()
    client.plan(tiny())
    with closing(known(server, b'{"do":"status","id":1}\n' * 3000)):
        with RigClient(RIG, folder / "at") as starter:
            starter.wait_for(lambda status: True, MAX_S)
            starter.start("left")
        client.wait_for(lambda status: status["run"] == "left", MAX_S)
        assert client.wait_for(ended, MAX_S)["state"] == "done"
    assert shots_of(folder / "runs" / "left") == planned(tiny())


def test_what_is_refused_says_why_as_if_it_were_asked_here(quick, whole):
    client, _, _ = quick
    with refused("plan-unknown", InputError, match="'x'"):
        client.plan("x")
    with refused("probe-too-wide", InputError):
        client.plan(tiny(places={"kind": "grid", "probe_mm": 60.0}))
    with pytest.raises(SafetyError, match="soft limits"):
        client.plan(tiny(depth_mm=11.0, step_mm=1.0))
    with refused("no-recording", SafetyError):
        client.pause()
    client.plan(tiny(frames=3))
    with pytest.raises(RecordingError, match="another plan"):
        client.start("whole")
    assert not client.ask_status()["recording"]


@pytest.mark.slow
def test_a_paused_or_aborted_recording_waits_lifted_and_goes_on(real, tmp_path):
    client, _, rig = real
    plan = tiny(depth_mm=1.0, places=TWICE)
    client.plan(plan)
    client.start("paused")
    client.wait_for(lambda status: status["state"] == "running", MAX_S)
    client.abort()
    assert client.wait_for(ended, MAX_S)["state"] == "aborted"
    client.start("paused")
    client.wait_for(lambda status: status["shots"] >= 1, MAX_S)
    client.pause()
    client.wait_for(lambda status: status["state"] == "paused", MAX_S)
    stood = rig.stage.position_m()
    assert stood[2] == pytest.approx(-1e-3, abs=1e-5)  # the plan's clearance
    pictured = client.picture[0]
    time.sleep(1.0)
    assert rig.stage.position_m() == stood
    assert client.picture[0] > pictured  # the camera is still watched
    client.resume()
    assert client.wait_for(ended, MAX_S)["state"] == "done"
    assert shots_of(tmp_path / "runs" / "paused") == planned(plan)


def moves(rig, *, speed_m_s):
    """Wait for a move of this speed into the skin that has a while to go."""
    world, end_s = rig.stage._world, time.monotonic() + MAX_S
    while time.monotonic() < end_s:
        motion = world.motion
        deeper = motion.target_m[2] > motion.start_m[2] and motion.start_m[2] > 0
        left_s = motion.ends_s - world.now_s
        if motion.speed_m_s == speed_m_s and left_s > 0.03 and deeper:
            return
        time.sleep(0.001)
    raise AssertionError("no such move came")


def stopped(rig):
    """When the stage stood after it was stopped [s]."""
    world = rig.stage._world
    return [motion for motion in world._motions if math.isfinite(motion.stopped_s)][-1].ends_s


@pytest.mark.parametrize("halt_s", [MAX_S, pytest.param(HALT_S, marks=pytest.mark.slow)])
def test_an_emergency_stop_halts_a_press_in_time_and_nothing_moves_after(real, tmp_path, halt_s):
    client, _, rig = real
    client.plan(tiny())
    client.start("estop")
    with pytest.raises(SafetyError, match="under way"):
        client.start("another")
    moves(rig, speed_m_s=2e-3)
    asked_s = time.monotonic()
    said = client.estop()
    stands_s = stopped(rig)
    assert stands_s - asked_s < halt_s
    assert said["stood_ns"] / 1e9 >= stands_s - 1e-6  # what is told is not too early
    stood = rig.stage.position_m()
    last = client.wait_for(ended, MAX_S)
    assert (last["state"], last["held"]) == ("e-stopped", True)
    time.sleep(0.3)
    assert rig.stage.position_m() == stood  # not lifted either
    with refused("emergency-stop", SafetyError):
        client.start("estop")
    client.release()
    client.start("estop")
    assert client.wait_for(ended, MAX_S)["state"] == "done"
    assert shots_of(tmp_path / "runs" / "estop") == planned(tiny())


def test_a_held_stage_takes_no_move_from_anybody():
    rig = open_served_rig(RIG, accelerated=True).rig
    stage = StageProxy(rig.stage, rig.clock)
    stage.hold()
    with pytest.raises(OperatorInterrupt):
        stage.move_to((0.0, 0.0, 0.0), 1e-3)
    with pytest.raises(OperatorInterrupt):
        stage.moving()
    assert stage.position_m() == (0.0, 0.0, -5e-3)
    stage.release()
    stage.move_to((0.0, 0.0, 0.0), 1e-3)


@pytest.mark.slow
def test_the_process_outlives_its_client_and_lifts_the_probe_when_it_is_told_to_end(tmp_path):
    folder = tmp_path / "at"
    process, address = launch(RIG, tmp_path / "runs", folder=folder)
    with process:
        try:
            with RigClient(RIG, folder) as client:
                client.wait_for(lambda status: True, MAX_S)
                client.plan(tiny(places=TWICE, frames=3))
                client.start("night")
                with refused("already-driven", DeviceError):
                    launch(RIG, tmp_path / "runs", folder=folder)
            with RigClient(RIG, folder) as client:
                status = client.wait_for(lambda status: status["shots"] >= 1, MAX_S)
                assert status["recording"]
                asked_s = time.monotonic()
                said = client.estop()
                assert said["stood_ns"] / 1e9 - asked_s < HALT_S
                client.wait_for(ended, MAX_S)
                client.release()
                client.start("night")
                client.wait_for(lambda status: status["state"] == "running", MAX_S)
                process.send_signal(signal.SIGTERM)
                assert process.wait(MAX_S) == 0
                with pytest.raises(DeviceError):
                    client.ask_status()
        finally:
            process.kill()
    assert find(RIG, folder) is None
    found = shots_of(tmp_path / "runs" / "night")
    assert 0 < len(found) < 4
    assert address.token not in (folder / "devices-virtual-palm.log").read_text()


def test_of_pages_that_end_at_once_the_last_ends_the_rig_s_process(tmp_path) -> None:
    with served(tmp_path, accelerated=True) as (client, server, _), ExitStack() as stack:
        others = [stack.enter_context(RigClient(RIG, tmp_path / "at")) for _ in range(3)]
        for one in others:
            one.wait_for(lambda status: True, MAX_S)
        with ThreadPoolExecutor(4) as pool:
            stay = list(pool.map(lambda one: one.leave(), [client, *others[:2]]))
        assert sorted(stay) == [1, 2, 3]
        assert not server.ended.is_set()
        assert "process ends" in leave_rig(others[2], RIG)
        assert server.ended.wait(MAX_S)
