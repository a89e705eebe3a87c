"""Live sensors: what they told is kept for seconds, and drawn with its doubt; first sessions go on."""

import math
import re
import sys
import time

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.refusals import refused

from palpate.core import DeviceError, InputError
from palpate.studio.live.live_desk import MAX_SENSORS, SPAN_S, LiveDesk, LiveProcesses, LiveSample, LiveSensor
from palpate.studio.live.live_drawing import overlay_svg, place_svg, reading_svg
from palpate.studio.live.live_page import facts_html, head_html, live_address
from palpate.studio.live.start_desk import StartDesk


def reading(value=3.2, half=0.4, valid=True, why="", unit="N", limits=(0.0, 20.0)):
    """A reading as a live process tells it."""
    low, high = (value - half, value + half) if valid and not isinstance(value, str) else (None, None)
    return {
        "value": value,
        "unit": unit,
        "low": low,
        "high": high,
        "range": limits,
        "valid": valid,
        "why": why,
    }


def told(serial, time_s, value=3.2, **changed):
    """A live process's status."""
    return {
        "serial": serial, "state": "live", "why": "", "advice": "", "rate_hz": 29.97, "p50_ms": 4.0,
        "p95_ms": 6.1, "p99_ms": 8.0, "frames": 120, "dropped": 0, "lost": 0, "broken": 0, "force_N": None,
        "reading": {"frame": "7", "time_s": time_s, "readings": {"force_N": reading(value)}},
        **changed,
    }  # fmt: skip


class MadeUpConnection:
    """Stands for `LiveClient`."""

    def __init__(self):
        self.status, self.picture, self.told_s, self.asked = None, None, None, []

    def ask(self, do, **fields):
        self.asked.append(do)
        if do == "breaks":
            raise DeviceError("gone")

    def close(self):
        self.asked.append("close")


def test_each_frame_is_kept_once_and_for_the_seconds_that_are_plotted():
    connection = MadeUpConnection()
    sensor = LiveSensor("live x", connection)
    for k in range(300):
        connection.status = told(k, 0.1 * (k // 3), value=float(k // 3))  # each frame is told three times
        sensor.listen(100.0 + 0.1 * (k // 3))
    assert [one.readings["force_N"]["value"] for one in sensor.samples] == [float(k) for k in range(100)]
    sensor.listen(100.0 + 9.9 + SPAN_S - 1.0)
    assert sensor.samples[0].at_s >= 100.0 + 9.9 - 1.0
    sensor.listen(1e6)
    assert not sensor.samples


def test_a_sensor_that_says_nothing_grows_old():
    sensor = LiveSensor("live x", MadeUpConnection())
    assert sensor.age_s(50.0) is None
    sensor.connection.told_s = 40.0
    assert sensor.age_s(50.0) == 10.0


class MadeUpProcesses(LiveProcesses):
    """Stands for the processes of live sensors."""

    def __init__(self):
        super().__init__()
        self.made, self.launched = {}, []

    def connect(self, name):
        self.made[name] = MadeUpConnection()
        return self.made[name]

    def running(self):
        return sorted(name for name, one in self.made.items() if one.status is not None)

    def launch(self, name, options):
        self.launched.append((name, dict(options)))
        self.made[name].status = told(0, 0.0)


def test_a_desk_begins_a_process_once_and_ends_it_when_asked():
    processes = MadeUpProcesses()
    with LiveDesk(processes) as desk:
        desk.begin("live a", {"camera": "a"})
        desk.begin("live a", {"camera": "a"})
        assert processes.launched == [("live a", {"camera": "a"})]
        desk.end("live a")
        desk.end("live a")
        assert processes.made["live a"].asked == ["shutdown", "close"]
        for k in range(MAX_SENSORS):
            desk.begin(f"live {k}", {})
        with pytest.raises(InputError):
            desk.begin("live more", {})
        processes.made["live 0"].status = None  # its process has ended: it takes no place any more
        desk.begin("live more", {})
        assert desk.names == [*(f"live {k}" for k in range(1, MAX_SENSORS)), "live more"]
    assert processes.made["live 1"].asked == ["close"]  # the server's end ends no sensor


@pytest.mark.parametrize("name", ["", "x" * 500, "live\nb", "virtual:palm", "virtual:palm supervisor"])
def test_no_other_process_than_a_live_sensors_is_addressed(name):
    processes = MadeUpProcesses()
    processes.connect(name).status = told(0, 0.0)  # it runs
    with LiveDesk(processes) as desk:
        with pytest.raises(InputError):
            desk.sensor(name)
        with pytest.raises(InputError):
            desk.begin(name, {})
        desk.end(name)
    assert (processes.made[name].asked, processes.launched) == ([], [])


def samples(values, valid=True, step_s=0.1):
    return [
        LiveSample(50.0 + step_s * k, k, {"force_N": reading(v, valid=valid)}, None)
        for k, v in enumerate(values)
    ]


def polyline(svg):
    points = re.search(r'<polyline points="([^"]+)"', svg).group(1).split()
    return [tuple(map(float, point.split(","))) for point in points]


def test_a_curve_rises_with_the_value_and_ends_now():
    svg = reading_svg(samples([0.0, 1.0, 2.0, 3.0]), "force_N", "N", now_s=50.3)
    points = polyline(svg)
    assert [y for _, y in points] == sorted((y for _, y in points), reverse=True)
    assert points[-1][0] == max(x for x, _ in points) == 550.0
    per_s = (points[-1][0] - points[0][0]) / 0.3
    assert per_s == pytest.approx(500 / SPAN_S, rel=0.01)
    assert "<polygon" in svg
    assert "now, valid" in svg


def test_the_place_lies_where_it_was_read_and_is_nowhere_without_one():
    readings = {
        "x_mm": reading(5.0, 1.0, unit="mm", limits=(-10, 10)),
        "y_mm": reading(-2.0, unit="mm", limits=(-10, 10)),
    }
    svg = place_svg(readings)
    assert "−2.0 mm" in svg
    assert 'x="4.000"' in svg  # the interval's left end
    assert place_svg({"x_mm": readings["x_mm"]}) == ""
    bare = place_svg({"x_mm": reading(None, valid=False, limits=(-10, 10)), "y_mm": readings["y_mm"]})
    assert "no place" in bare
    assert "<path" not in bare
    assert re.search("viewBox=[^>]*", bare).group() == re.search("viewBox=[^>]*", svg).group()  # as high
    pushed = place_svg(
        readings | {"force_x_N": reading(2.0, limits=(-4, 4)), "force_y_N": reading(0.0, limits=(-4, 4))}
    )
    assert "l2.000 0.000" in pushed  # half of the largest, a fifth of the width


def test_states_rates_and_addresses_are_said_and_nothing_is_taken_for_markup():
    assert "no connection" in head_html("live <x>", None)
    assert "&lt;x&gt;" in head_html("live <x>", told(0, 0.0, state="lost", why="unplugged"))
    assert "simulated" in head_html("live x", told(0, 0.0, simulated=True))
    assert "simulated" not in head_html("live x", told(0, 0.0, simulated=False))
    facts = facts_html(told(0, 0.0, image={"noise": 1.234, "clipped": 0.012}))
    assert all(
        part in facts for part in ("30.0", "95 % within 6.1", "0 dropped", "noise 1.23", "1.2 % clipped")
    )
    assert live_address(["live a&b", "live c"]) == "/live?sensor=live%20a%26b&sensor=live%20c"
    assert live_address([]) == "/live"
    assert overlay_svg({"centre_px": [10.0, 20.0]}, (400, 300)).count("<circle") == 2
    assert overlay_svg(None, (400, 300)) == ""


def arrows(moves, times=2.0):
    """An overlay of marks on a circle that moved so [px]."""
    at = [(100.0 + 50 * math.cos(k), 100.0 + 50 * math.sin(k)) for k in range(len(moves))]
    shapes = [
        {"role": "mark", "start": list(p), "end": [p[0] + times * m[0], p[1] + times * m[1]]}
        for p, m in zip(at, moves, strict=True)
    ]
    return {"lines": [], "dots": [], "arrows": shapes, "arrow_times": times}


SESSION = """
import json, sys
def say(**told): print(json.dumps(told), flush=True)
say(session={"step": "collect", "args": sys.argv[1:]}, progress=["presses", 1, 40])
say(picture="aGVsbG8=", collect={"presses": 1})
weight = json.loads(sys.stdin.readline())["force_N"]
say(said=f"got {weight}")
if weight > 5: say(error="too heavy"); sys.exit(2)
sys.stdin.readline()
"""


@pytest.fixture
def starts():
    with StartDesk((sys.executable, "-c", SESSION)) as desk:
        yield desk


def until(holds):
    end_s = time.monotonic() + 20
    while not holds() and time.monotonic() < end_s:
        time.sleep(0.02)
    return holds()


def test_a_session_is_heard_weighed_stopped_and_gone_on_with(starts, tmp_path):
    folder = tmp_path / "mine"
    run = starts.begin(folder, "0", "typed", 12, seed=3)
    assert until(lambda: run.collect)
    assert run.session["args"] == [
        str(folder),
        "--camera",
        "0",
        "--scale",
        "typed",
        "--presses",
        "12",
        "--seed",
        "3",
    ]
    assert (run.step, run.done, run.total, run.picture) == ("presses", 1, 40, (1, b"hello"))
    with refused("session-running", InputError):
        starts.begin(folder, "0", "typed", 12)
    run.weigh(1.5)
    assert until(lambda: run.said == "got 1.5")
    run.close()
    assert not run.running
    assert "go on" in run.why
    again = starts.begin(folder, "0", "typed", 12)
    again.weigh(9.0)
    assert until(lambda: not again.running)
    assert again.why == "too heavy"
    assert starts.run(folder) is again
    assert starts.run(tmp_path) is None


def test_no_more_sessions_go_on_than_are_allowed_and_none_outlives_the_server(tmp_path):
    with StartDesk((sys.executable, "-c", SESSION)) as desk:
        runs = [desk.begin(tmp_path / str(k), "0", "typed", 10) for k in range(2)]
        with refused("too-many-sessions", InputError):
            desk.begin(tmp_path / "third", "0", "typed", 10)
    assert not any(run.running for run in runs)
