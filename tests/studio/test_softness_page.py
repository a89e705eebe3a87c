"""The softness page: what the server keeps, what is drawn of it, and one stop for all that may move."""

import html
import os
import re
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.refusals import refused
from tests.studio import devtools
from tests.studio.test_page_security import Served

from palpate.core import InputError
from palpate.softness import Mode, RenderingLaw
from palpate.softness.control import LoopSample
from palpate.softness.process import RenderingStatus, read_bench
from palpate.studio.softness_page import RenderingDesk, no_object_html

LINE = """
name = "{name}"
[force_area]
area_mm2 = [0.0, 130.0]
force_N = [0.0, 4.0]
[force_displacement]
displacement_mm = [0.0, 6.0]
force_N = [0.0, 4.0]
"""


def felt(time_s: float, force_n: float, touched: bool = True) -> LoopSample:
    return LoopSample(time_s, 5e-3, 1e-3, 30e3, 30e3, force_n, 25e-6 * force_n, 1.0, 0.0, touched)


class MadeUpSession:
    """Stands for `RenderingSession`."""

    def __init__(self, bench, soft, mode, peak_n, frequency_hz) -> None:
        self.law = RenderingLaw(soft, mode=mode)
        self.told_s, self.asked = time.monotonic(), []
        self._state = "renders"

    def status(self) -> RenderingStatus:
        why = "the operator ended it" if self._state == "ended" else ""
        return RenderingStatus(self._state, why, self.law.object.name, self.law.mode, wished=True)

    def taken(self) -> list[LoopSample]:
        return [felt(float(t), 1.0) for t in np.arange(0.0, 30.0, 0.1)] if not self.asked else []

    def show(self, soft) -> None:
        self.asked.append("show")
        self.law = RenderingLaw(soft, mode=self.law.mode)

    def stop(self) -> None:
        self._state = "ended"

    estop = stop

    def close(self) -> None:
        self.asked.append("close")


@pytest.fixture
def desk(tmp_path: Path) -> RenderingDesk:
    for name in ("one", "two"):
        (tmp_path / f"{name}.toml").write_text(LINE.format(name=f"object {name}"))
    (tmp_path / "three.toml").write_text(LINE.format(name="three") + "x = 1")
    return RenderingDesk(tmp_path, read_bench(None), MadeUpSession)


def test_objects_of_the_folder_are_found_and_others_are_named_with_their_reason(desk) -> None:
    found, refused = desk.objects()
    assert {name: soft.name for name, soft in found.items()} == {"one": "object one", "two": "object two"}
    assert set(refused) == {"three.toml"}
    assert "no field" in refused["three.toml"]


def test_another_object_is_shown_in_the_rendering_that_runs_and_another_mode_is_refused(desk) -> None:
    desk.begin("one", Mode.BOTH, 1.0, 1.0)
    first = desk._session
    desk.begin("two", Mode.BOTH, 1.0, 1.0)
    assert desk._session is first
    assert desk.status.object == "object two"
    with refused("rendering-running", InputError):
        desk.begin("one", Mode.CUTANEOUS, 1.0, 1.0)
    desk.end()
    desk.begin("one", Mode.CUTANEOUS, 1.0, 1.0)
    assert first.asked == ["show", "close"]
    assert desk.status.mode is Mode.CUTANEOUS


def circles(svg: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg)]


def polyline(svg: str) -> list[tuple[float, float]]:
    points = re.search(r'<polyline points="([^"]+)"', svg).group(1)
    return [tuple(map(float, one.split(","))) for one in points.split()]


@pytest.mark.skipif(os.name == "nt", reason="the command is one of a POSIX shell")
@pytest.mark.parametrize("there", [True, False])
def test_a_folder_without_an_object_is_told_the_command_that_writes_one(tmp_path, there: bool) -> None:
    folder = tmp_path / "my objects"
    if there:
        folder.mkdir()
    told = no_object_html(folder)
    assert "No object" in told
    command = html.unescape(re.search('<pre class="commands">(.*?)</pre>', told, re.DOTALL).group(1))
    subprocess.run(command, shell=True, check=True, timeout=30)
    found, refused = RenderingDesk(folder, read_bench(None)).objects()
    assert {name: soft.name for name, soft in found.items()} == {"soft-ball": "soft ball"}
    assert refused == {}
    RenderingLaw(found["soft-ball"])  # which can be rendered


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    folder = tmp_path_factory.mktemp("objects")
    (folder / "line.toml").write_text(LINE.format(name="line"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OBJECTS", str(folder))
        served = Served()
    yield served
    served.close()


STATE = "document.querySelector('#state')?.innerText"
LIVE = "JSON.parse(document.querySelector('#beat').dataset.ages).beat > 1"  # the server hears this page


def begun_reloaded_and_stopped(tab: devtools.Tab) -> tuple[str, str]:
    """What the page says of a rendering after it was loaded anew, and why that ended."""
    tab.wait(LIVE)
    tab.run("document.querySelector('#begin').click()")
    tab.wait(f"/^(renders|ended): line/.test({STATE})")
    tab.run("window.old = true")
    tab.reload()
    tab.wait(f"!window.old && {LIVE}")
    circles = "document.querySelectorAll('#skin circle').length > 5"
    tab.wait(f"{circles} || {STATE}.startsWith('ended')")
    state = tab.run(STATE)
    tab.run("document.dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))")
    return state, tab.wait("document.querySelector('#why').innerText")


@pytest.mark.slow
def test_a_rendering_begun_on_the_page_is_seen_after_a_reload_and_ended_by_the_stop(served, tmp_path) -> None:
    if devtools.chromium() is None:
        pytest.skip("there is no Chromium to drive")
    browser = devtools.Browser(tmp_path)
    try:
        tab = browser.open(served.url("/softness"))
        for _ in range(3):  # a loop that the machine's other work kept waiting ends by itself, as it should
            state, why = begun_reloaded_and_stopped(tab)
            if "emergency stop" in why:
                break
        assert state.startswith("renders: line")
        assert "emergency stop" in why
        assert tab.said == []
    finally:
        browser.close()
