"""What the tests of the pages share: servers over a workspace, live sensors, tabs, contrast."""

import json
import os
from contextlib import contextmanager

from tests.studio.test_page_for_everybody import CONTRASTS
from tests.studio.test_page_security import Served

from palpate.devices.rpc import find
from palpate.sensing.live_client import LiveClient

PHONE, DESK = (390, 844), (1280, 900)
"""Widths and heights that every page has to fit [px]."""
BODY_TEXT, LARGE_TEXT = 4.5, 3.0
MAX_S = 120.0


@contextmanager
def environment(**values):
    """Variables for processes that are begun meanwhile; they are as before afterwards."""
    kept = {name: os.environ.get(name) for name in values}
    os.environ |= {name: str(value) for name, value in values.items()}
    try:
        yield
    finally:
        for name, value in kept.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)


@contextmanager
def serving(workspace, runtime=None, sensors=()):
    """The studio over a workspace, before a made-up rig.

    Args:
        workspace: folder that is shown.
        runtime: folder of address files, so that no other process's sensors are met; None for the user's.
        sensors: names of live sensors to be ended at last, as they outlive the server.
    """
    more = {} if runtime is None else {"XDG_RUNTIME_DIR": runtime, "RUNTIME": "given"}
    with environment(WORKSPACE=workspace, **more):
        served = Served()
    try:
        yield served
    finally:
        served.close()
        if runtime is not None:
            end_sensors(runtime / "palpate", sensors)


def end_sensors(folder, names):
    """End live sensors of these names, those that run."""
    for name in names:
        if find(name, folder) is not None:
            with LiveClient(name, folder) as client:
                if client.reached(5.0):
                    client.shutdown()


def opened(
    browser, served, path, size=DESK, scheme="light", until="!!document.querySelector('main .card h2')"
):
    """A tab at an address of the studio, in front, in a theme, once it shows something."""
    tab = browser.open("about:blank", size=size)
    tab.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    tab.go(served.url(path))
    tab.wait(until, MAX_S)
    tab.front()
    return tab


def choose(tab, selector, words):
    """Choose from a list by the words of one of its lines."""
    found = f"document.querySelector({json.dumps(selector)})"
    old = "for (const e of document.querySelectorAll('[data-chosen]')) delete e.dataset.chosen"
    mark = f"{found}.closest('.q-field').dataset.chosen = 'yes'"
    tab.wait(f"!!{found} && (() => {{ {old}; return {mark} }})()", MAX_S)
    tab.press("[data-chosen]")
    holds = f"i.innerText.includes({json.dumps(words)})"
    line = f"[...document.querySelectorAll('.q-menu .q-item')].find((i) => {holds})"
    tab.wait(f"!!{line}", MAX_S)
    tab.run(f"{line}.click()")
    tab.wait("!document.querySelector('.q-menu')", MAX_S)


SOURCE, SCALE = "input[aria-label=source]", "input[aria-label^=scale]"
"""Lists in which an address may be typed."""


def weak_texts(tab):
    """Texts of a page that do not stand out from their ground as much as WCAG 2.2 AA asks."""
    return [one for one in tab.run(CONTRASTS) if one[1] < (LARGE_TEXT if one[2] else BODY_TEXT)]


def wider_than(tab):
    """Width of what a page holds [px], to be no more than the window's."""
    return tab.run("document.documentElement.scrollWidth")


def type_into_list(tab, selector, text):
    """Type what is not in a list into it."""
    tab.wait(f"!!document.querySelector({json.dumps(selector)})", MAX_S)
    tab.front()
    tab.run(f"document.querySelector({json.dumps(selector)}).focus()")
    tab.send("Input.insertText", text=text)
    tab.key("Enter", 13)
    tab.run("document.activeElement.blur()")
    tab.wait("!document.querySelector('.q-menu')", MAX_S)
