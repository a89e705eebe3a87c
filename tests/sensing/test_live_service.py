"""The process of a live sensor: it outlives who watches, keeps what it records, and names what is wrong."""

from __future__ import annotations

import signal
import socket
import time

import cv2
import numpy as np
import pytest
from tests.refusals import refused
from tests.sensing.live_stand_ins import until

from palpate.core import CertificateError, DeviceError, InputError, SafetyError
from palpate.devices.rpc import Address, encode_message, publish
from palpate.recordings import Run
from palpate.sensing.live_client import LiveClient, launch_live
from palpate.sensing.live_loop import LiveState
from palpate.sensing.live_service import LiveOptions, LiveServer, LiveService
from palpate.sensors.owned import sensor_preset


@pytest.fixture
def video(tmp_path):
    """Twenty frames of 32 x 24 px at 50 Hz; the first fifteen are untouched."""
    path, rng = tmp_path / "taps.avi", np.random.default_rng(0)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 50.0, (32, 24), isColor=True)
    for i in range(20):
        picture = rng.integers(95, 105, (24, 32, 3), dtype=np.uint8)
        picture[8:16, 8:16] += np.uint8(80 if i >= 15 else 0)
        writer.write(picture)
    writer.release()
    return path


@pytest.fixture
def served(video, tmp_path):
    """A service in this process and a client of it."""
    runs = tmp_path / "runs"
    runs.mkdir()
    service = LiveService(
        "live taps", LiveOptions(camera=str(video), runs=str(runs), paced=True, repeat=True)
    )
    server = LiveServer(service)
    service.start()
    publish(Address("live taps", server.port, server.token, 1), tmp_path)
    client = LiveClient("live taps", tmp_path)
    assert client.reached(10.0)
    yield service, server, client, runs
    client.close()
    service.close()
    server.close()


def test_a_client_is_told_ten_times_a_second_with_a_picture(served) -> None:
    service, _, client, _ = served
    client.wait_for(lambda status: status["state"] == "live" and status["frames"] > 20, 10.0)
    first, begun_s = client.status["serial"], time.monotonic()
    time.sleep(0.5)
    pushes = (client.status["serial"] - first) / (time.monotonic() - begun_s)
    assert pushes >= 8  # ten where nothing else runs
    _, jpeg, size_px = client.picture
    assert size_px == (32, 24)
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == (24, 32, 3)
    wanted = {"state", "why", "source", "calibration", "rate_hz", "p50_ms", "p95_ms", "p99_ms", "frames"}
    wanted |= {"dropped", "lost", "broken", "drift", "advice", "reading", "force_N", "image", "collect"}
    assert wanted <= set(client.status)
    assert client.status["simulated"] is False
    assert client.status["rate_hz"] == pytest.approx(50.0, rel=0.1)
    assert service.loop.state is LiveState.LIVE


def test_a_recording_is_whole_when_it_has_ended_and_stays_in_its_folder(served) -> None:
    _, _, client, runs = served
    client.wait_for(lambda status: status["state"] == "live", 10.0)
    client.record("first")
    with pytest.raises(SafetyError, match="under way"):
        client.record("second")
    client.wait_for(lambda status: status["record"], 5.0)
    time.sleep(0.3)
    kept = client.record_stop()
    run = Run.open(runs / "first")
    assert len(run) >= 8
    assert not run.damage
    assert kept["run"] == str(runs / "first")
    with pytest.raises(InputError, match="no slash"):
        client.record("../elsewhere")
    with refused("no-recording", SafetyError):
        client.record_stop()


def skin_of(status: dict) -> set[tuple[float, float]] | None:
    """Corners of the skin's region, as they are drawn over the picture."""
    overlay = (status["image"] or {}).get("overlay")
    if overlay is None:
        return None
    return {tuple(at) for one in overlay["lines"] if one["role"] == "skin" for at in one["points"]}


@pytest.mark.parametrize("named", ["by its camera"])
def test_the_picture_is_looked_at_where_the_sensors_preset_says_its_skin_is(
    video, tmp_path, monkeypatch, named
) -> None:
    x, y, wide, high = sensor_preset("gelsight-mini").region_px((32, 24))
    assert (wide, high) != (32, 24)
    if named == "by its camera":
        known = {str(video): sensor_preset("gelsight-mini")}
        monkeypatch.setattr("palpate.sensing.live_service.preset_of_camera", known.get)
    preset = "gelsight-mini" if named == "by its option" else ""
    options = LiveOptions(camera=str(video), paced=True, repeat=True, preset=preset)
    service = LiveService("live gel", options)
    service.start()
    try:
        until(lambda: skin_of(service.status()) is not None)
        seen = skin_of(service.status())
    finally:
        service.close()
    assert seen == {(x, y), (x + wide, y), (x + wide, y + high), (x, y + high)}
    with pytest.raises(InputError, match="nonesuch"):
        LiveService("live gel", LiveOptions(camera=str(video), preset="nonesuch"))


def test_presses_are_collected_beside_and_their_run_is_whole(served) -> None:
    _, _, client, runs = served
    client.wait_for(lambda status: status["state"] == "live", 10.0)
    with refused("no-force-sensor", InputError):
        client.collect("presses")
    client.collect("presses", scale="typed", asked=3)
    status = client.wait_for(lambda status: status["collect"], 5.0)
    assert status["collect"]["asked"] == 3
    with refused("weight-range", InputError):
        client.label(-1.0)
    assert client.collect_stop()["presses"] == 0
    assert not Run.open(runs / "presses").damage
    with pytest.raises(SafetyError, match="no presses"):
        client.label(1.0)


def test_a_client_that_stops_reading_holds_nobody_up(served) -> None:
    service, server, client, _ = served
    deaf = socket.create_connection(("127.0.0.1", server.port))
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.sendall(encode_message({"token": server.token, "id": 0}))
    time.sleep(0.3)
    before = service.loop.stats.frames
    told = client.status["frames"]
    time.sleep(0.6)
    assert service.loop.stats.frames > before + 10
    assert client.status["frames"] > told + 10
    deaf.close()


def test_a_wrong_token_is_told_nothing(served) -> None:
    _, server, _, _ = served
    with socket.create_connection(("127.0.0.1", server.port)) as stranger:
        stranger.sendall(encode_message({"token": "guess", "id": 0}))
        stranger.settimeout(5.0)
        assert b"token" in stranger.recv(4096)
        assert stranger.recv(4096) == b""


def test_no_camera_and_a_calibration_that_is_none_have_a_name_each(tmp_path) -> None:
    service = LiveService("live none", LiveOptions(camera="NOSUCHSERIAL"))
    service.start()
    until(lambda: service.status()["state"] == "lost", 20.0)
    status = service.status()
    assert "serial number" in status["why"]
    assert any("lost" in line["text"] for line in status["log"])
    with refused("camera-missing", SafetyError):
        LiveService.record(service_with_runs(service, tmp_path), "run")
    with refused("card-missing", CertificateError):
        service.use(str(tmp_path))
    assert service.status()["state"] == "lost"
    service.close()


def service_with_runs(service: LiveService, runs) -> LiveService:
    service.options = LiveOptions(camera="NOSUCHSERIAL", runs=str(runs))
    return service


def test_the_process_outlives_its_clients_and_leaves_its_recording_whole(video, tmp_path) -> None:
    runs = tmp_path / "runs"
    runs.mkdir()
    options = {"camera": str(video), "runs": str(runs), "paced": True, "repeat": True}
    process, _ = launch_live("live process", options, folder=tmp_path)
    try:
        with LiveClient("live process", tmp_path) as first:
            first.wait_for(lambda status: status["state"] == "live", 20.0)
            first.record("kept")
        time.sleep(0.3)
        with LiveClient("live process", tmp_path) as second:
            status = second.wait_for(lambda status: status["record"], 20.0)
            assert status["record"]["run"] == str(runs / "kept")
            with refused("process-not-started", DeviceError):
                launch_live("live process", options, folder=tmp_path)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    finally:
        process.kill()
    run = Run.open(runs / "kept")
    assert len(run) > 10
    assert not run.damage
