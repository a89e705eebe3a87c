"""Live sensors: what they told is kept for seconds, and drawn with its doubt; first sessions go on."""

import io
import math
import re
import sys
import time
from argparse import Namespace
from contextlib import suppress

import pytest
from tests.rig.hand_scale import HandScale
from tests.rig.serial_terminal import FakeTerminal

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.refusals import refused

from palpate.core import DeviceError, InputError
from palpate.studio.library.job_process import JobVoice
from palpate.studio.live.live_desk import (
    MAX_SENSORS,
    SPAN_S,
    LiveDesk,
    LiveProcesses,
    LiveSample,
    LiveSensor,
    edge_readings,
)
from palpate.studio.live.live_drawing import (
    overlay_svg,
    place_svg,
    reading_svg,
)
from palpate.studio.live.live_page import facts_html, head_html, live_address
from palpate.studio.live.reading_rows import softness_html, values_html
from palpate.studio.live.start_desk import StartDesk, kept_session
from palpate.studio.live.start_page import (
    UNITS,
)
from palpate.studio.live.start_process import run_session
from palpate.workflows import start_session


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


def test_the_force_sensor_beside_is_drawn_dashed_and_only_beside_newtons():
    beside = [
        LiveSample(50.0 + 0.1 * k, k, {"force_N": reading(1.0), "x_mm": reading(unit="mm")}, 2.0)
        for k in range(3)
    ]
    assert reading_svg(beside, "force_N", "N", 50.2).count("stroke-dasharray") == 1
    assert "sensor beside" in reading_svg(beside, "force_N", "N", 50.2)
    assert "dashed" not in reading_svg(beside, "x_mm", "mm", 50.2).replace("stroke-dasharray", "")
    assert "stroke-dasharray" not in reading_svg(beside, "x_mm", "mm", 50.2)


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


def test_a_value_says_its_interval_or_why_it_is_not_valid_in_words_and_shape():
    good = values_html({"force_N": reading(-3.21, 0.4)}, {})
    assert "−3.2" in good
    assert "± 0.40" in good
    assert "●" in good
    bad = values_html({"force_N": reading(3.2, valid=False, why="beyond the <range>")}, {"force_N": 1.0})
    assert "✕" in bad
    assert "the &lt;range&gt" in bad
    assert "±" not in bad
    assert "1.00 N" in bad
    assert "–" in values_html({"force_N": reading(None, valid=False, why="x")}, {})


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


def test_lengths_and_angles_are_shown_in_mm_and_degrees_with_all_that_surrounds_them():
    found = edge_readings(
        {
            "x_m": reading(0.011, 0.001, unit="m", limits=(-0.02, 0.02)),
            "edge_rad": reading(None, valid=False, unit="rad", limits=(0.0, 3.141592653589793)),
            "force_N": reading(1.0),
        }
    )
    assert list(found) == ["x_mm", "edge_degrees", "force_N"]
    x = found["x_mm"]
    assert [x["value"], x["low"], x["high"], *x["range"]] == pytest.approx([11.0, 10.0, 12.0, -20.0, 20.0])
    assert found["edge_degrees"]["value"] is None
    assert found["edge_degrees"]["range"] == pytest.approx([0.0, 180.0])
    assert found["force_N"] == reading(1.0)


def arrows(moves, times=2.0):
    """An overlay of marks on a circle that moved so [px]."""
    at = [(100.0 + 50 * math.cos(k), 100.0 + 50 * math.sin(k)) for k in range(len(moves))]
    shapes = [
        {"role": "mark", "start": list(p), "end": [p[0] + times * m[0], p[1] + times * m[1]]}
        for p, m in zip(at, moves, strict=True)
    ]
    return {"lines": [], "dots": [], "arrows": shapes, "arrow_times": times}


def test_a_contact_is_outlined_and_marks_have_arrows_over_the_picture():
    outline = {"role": "region", "points": [[10, 10], [30, 10], [20, 30]]}
    skin = {"role": "skin", "points": [[0, 0], [400, 0], [400, 300], [0, 300]]}
    shapes = arrows([(3.0, 0.0)] * 5) | {
        "lines": [skin, outline],
        "dots": [{"role": "centre", "at": [20, 15]}],
    }
    svg = overlay_svg({"overlay": shapes, "centre_px": [20.0, 15.0]}, (400, 300))
    assert svg.count('points="10.0,10.0 30.0,10.0 20.0,30.0"') == 2  # seen on dark pictures and bright ones
    assert "400.0,0.0" not in svg
    assert svg.count("<path") == 5 + 2 + 2  # arrows, the cross at the centre, the mean motion
    assert "<circle" not in svg


def pressed(number, valid=True, why="", **changed):
    kappa = {"quantity": "stiffness", "value": 7.9, "low": 5.4, "high": 13.4, "unit": "N_per_mm"}
    kappa |= {"valid": valid, "why": "" if valid else "beyond the <range>"}
    readings = [] if why else [kappa]
    return {"press": number, "readings": readings, "why": why, "frames": 31, "force_N": 4.9, **changed}


def test_softness_is_told_of_each_press_with_its_interval_its_lamp_and_its_reason():
    told = softness_html({"calibration": "c", "presses": [pressed(2), pressed(1, valid=False)], "why": ""})
    assert "31 frames" in told
    assert "N/mm" in told
    assert "to 13.4)" in told or "to 13)" in told  # half its width would promise less above
    assert "±" not in told
    assert "●</i> valid" in told
    assert "(not valid)" in told
    doubtful = softness_html({"presses": [pressed(1, valid=False)]})
    assert "not valid" in doubtful
    assert "the &lt;range&gt" in doubtful
    unread = softness_html({"presses": [pressed(1, why="press <more> slowly")]})
    assert "not read" in unread
    assert "&lt;more&gt; slowly" in unread
    assert "No press" in softness_html({"presses": []})
    assert "force sensor" in softness_html({"presses": [], "why": "no force sensor"})
    assert softness_html(None) == ""


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


class WeighedError(Exception):
    """The scale was read, which is all that a test wants."""


class VoiceUntilWeighed(JobVoice):
    """A session's voice that stops it once its scale has weighed."""

    def say(self, line):
        if line.get("collect", {}).get("force_N") is not None:
            raise WeighedError


def test_a_scale_that_prints_bare_numbers_weighs_by_the_unit_that_the_page_asks_for(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    monkeypatch.setattr(start_session, "STILL_FRAMES", 4)
    with FakeTerminal(HandScale(lambda _: 1.0)) as terminal:
        words = Namespace(
            folder=tmp_path / "mine", camera="virtual:tactip", scale=terminal.path,
            presses=12, seed=0, real_time=False, more=0, unit="",
        )  # fmt: skip
        with refused("no-samples", DeviceError):
            run_session(words, VoiceUntilWeighed())
        assert set(UNITS) == {"", "g", "kg", "N", "oz", "lb"}
        words.unit = "g"
        with pytest.raises(WeighedError):
            run_session(words, VoiceUntilWeighed())
    assert kept_session(tmp_path / "mine")["unit"] == "g"


def test_a_session_whose_other_scale_is_refused_is_shown_as_it_is_kept(tmp_path):
    class Heard(JobVoice):
        def say(self, line):
            lines.append(line)

    lines = []
    kept = start_session.StartSession(tmp_path / "mine")
    kept.choose("virtual:tactip", "virtual", asked=12)
    kept._done("untouched")
    words = Namespace(
        folder=tmp_path / "mine", camera="virtual:tactip", scale=str(tmp_path / "no-port"),
        presses=12, seed=0, real_time=False, more=0, unit="",
    )  # fmt: skip
    with pytest.raises(DeviceError):
        run_session(words, Heard())
    told = [line["session"] for line in lines if "session" in line]
    assert (told[0]["scale"], told[0]["step"]) == (words.scale, "settings")
    assert (told[-1]["scale"], told[-1]["step"]) == ("virtual", "collect")
    assert kept_session(tmp_path / "mine") == told[-1]


@pytest.mark.parametrize(
    ("scale", "presses", "says", "opened"),
    [
        ("typed", 12, True, []),
        ("virtual", 11, True, []),
        ("virtual", 12, False, []),
        ("virtual", 15, False, [15]),
        ("typed", 15, False, [15]),
    ],
)
def test_the_pages_number_of_presses_is_how_many_there_shall_be_in_all(
    scale, presses, says, opened, tmp_path, monkeypatch
):
    class Heard(JobVoice):
        def say(self, line):
            lines.append(line)

    def feed(session, **_):
        asked.append(session.state.asked)
        raise DeviceError("opened")

    lines, asked = [], []
    kept = start_session.StartSession(tmp_path / "mine")
    kept.choose("virtual:tactip", "virtual", asked=12)
    kept.state.settings = {"size_px": [8, 8], "rate_hz": 1.0}
    kept._done("train")
    monkeypatch.setattr(start_session.StartSession, "presses_held", property(lambda session: 12))
    monkeypatch.setattr(start_session.StartSession, "commands", lambda session: [])
    monkeypatch.setattr(start_session.StartSession, "feed", feed)
    words = Namespace(folder=tmp_path / "mine", camera="virtual:tactip", scale=scale, presses=presses,
                      seed=0, real_time=False, more=0, unit="")  # fmt: skip
    with suppress(DeviceError):
        run_session(words, Heard())
    assert asked == opened
    told = [line["said"] for line in lines if "said" in line]
    assert ["12 presses" in one for one in told] == [True] * says


def test_no_more_sessions_go_on_than_are_allowed_and_none_outlives_the_server(tmp_path):
    with StartDesk((sys.executable, "-c", SESSION)) as desk:
        runs = [desk.begin(tmp_path / str(k), "0", "typed", 10) for k in range(2)]
        with refused("too-many-sessions", InputError):
            desk.begin(tmp_path / "third", "0", "typed", 10)
    assert not any(run.running for run in runs)
