"""Take the pictures of the studio's pages in docs/images anew, in a headless Chromium.

    PYTHONPATH=src:. python tools/studio_pictures.py          # some five minutes of one core
    PYTHONPATH=src:. python tools/studio_pictures.py --only live-dark

Everything on them is simulated: a virtual palm and a virtual NUSense, each pressed by a virtual hand. The
palm's session of forty presses is gone on with where the workspace that --kept names holds it, in my-sensor.
"""

from __future__ import annotations

import argparse
import io
import tempfile
import time
from pathlib import Path

from PIL import Image
from tests.studio.devtools import Browser, Tab
from tests.studio.page_driving import SOURCE, choose, opened, serving
from tests.studio.test_page_security import Served

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
ALL = ["start", "live", "live-phone", "recordings", "live-dark"]
PALM, NUSENSE = "live virtual:palm", "live virtual:nusense"
WIDE, PHONE = (1280, 860), (390, 1000)
LONG_S = 900.0
PLOT_S = 22.0  # until twenty seconds are drawn
WARM_S = 75.0  # in which a virtual palm draws its pictures for the first time, and loses frames
PRESSED = (  # a press that is read as valid, hard enough to be seen
    "[...document.querySelectorAll('.value:not(.invalid)')].some((one) => "
    "one.innerText.startsWith('force') && parseFloat(one.querySelector('b').innerText) > 3)"
)
READY = "document.querySelector('#steps').innerText.includes('6. Live newtons ready')"
TWELVE = "/presses\\s+(1[2-9]|[23]\\d) of 40/.test(document.querySelector('#steps').innerText)"
NAMELESS = (  # the workspace lies in a temporary folder
    "[...document.querySelectorAll('*')].filter((one) => !one.children.length && "
    "one.innerText?.startsWith('runs in ')).forEach((one) => { one.innerText = 'runs in my-workspace' })"
)
STRAINED = "document.querySelectorAll('.strain svg path').length > 0"


def taken(tab: Tab, name: str, width: int, height: int = 0, when: str = "true") -> None:
    """Take a picture of a page of this size once it shows something; a height of 0 is what it needs."""
    tab.send("Emulation.setScrollbarsHidden", hidden=True)
    tab.resize(width, height or WIDE[1])
    time.sleep(1.0)  # until the page has settled in its new size
    if not height:
        height = int(tab.run("document.documentElement.scrollHeight"))
        tab.resize(width, height)
    tab.run("window.scrollTo(0, 0)")
    time.sleep(1.0)
    tab.wait(when, LONG_S)
    path = IMAGES / f"studio-{name}.png"
    tab.screenshot(path)
    packed = io.BytesIO()
    Image.open(path).convert("RGB").save(packed, format="png", optimize=True)
    path.write_bytes(packed.getvalue())
    print(f"{path.name}: {width} × {height} px, {path.stat().st_size / 1e3:.0f} kB", flush=True)


def begun(browser: Browser, served: Served, folder: str) -> Tab:
    """The first page at a session, which is begun or gone on with unless it is through."""
    tab = opened(
        browser, served, f"/?folder={folder}", WIDE, until="!!document.querySelector('#start-begin')"
    )
    time.sleep(3.0)  # a session that is kept is taken in
    if not tab.run(READY):
        tab.press("#start-begin")
    return tab


def take(browser: Browser, served: Served, wanted: list[str]) -> None:
    """Take those that are named."""
    if "start" in wanted:
        tab = begun(browser, served, "first")
        tab.wait(TWELVE, LONG_S)
        taken(tab, "start", WIDE[0])
        tab.press("#start-stop")
    if {"live", "live-phone", "recordings"} & set(wanted):
        tab = begun(browser, served, "my-sensor")
        tab.wait(READY, LONG_S)
        if {"live", "live-phone"} & set(wanted):
            tab.press("#go-live")
            tab.wait(PRESSED, LONG_S)
            time.sleep(WARM_S)
        for name, (width, height) in {"live": (WIDE[0], 0), "live-phone": PHONE}.items():
            if name in wanted:
                taken(tab, name, width, height, PRESSED)
        if tab.run("!!document.querySelector('.end-live')"):
            tab.press(".end-live")  # it would take what the next ones need
    if "recordings" in wanted:
        address = "/recordings?run=my-sensor%2Fpresses&frame=57"
        tab = opened(browser, served, address, scheme="dark")
        tab.wait("document.querySelector('.player img')?.naturalWidth > 100", LONG_S)
        tab.run(NAMELESS)
        taken(tab, "recordings", *WIDE)
    if "live-dark" in wanted:
        tab = opened(browser, served, "/live?sensor=live%20virtual%3Anusense", scheme="dark")
        choose(tab, SOURCE, "virtual NUSense")
        time.sleep(1.0)
        tab.press("#live-begin")
        tab.wait(STRAINED, LONG_S)
        time.sleep(PLOT_S)
        taken(tab, "live-dark", WIDE[0], when=STRAINED)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=ALL, default=ALL, help="of these alone")
    parser.add_argument("--kept", type=Path, help="workspace whose session is gone on with")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        workspace = words.kept or Path(folder) / "workspace"
        workspace.mkdir(parents=True, exist_ok=True)
        browser = Browser(Path(folder) / "profile")
        try:
            with serving(workspace, Path(folder), (PALM, NUSENSE)) as served:
                take(browser, served, words.only)
        finally:
            browser.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
