"""The page is read by keyboard, by ear and in poor light: what WCAG 2.2 asks of it, level AA, as tests."""

import itertools
import json
import time
from html.parser import HTMLParser

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from palpate.studio import page_shell

AGES = {"force": 0.0, "position": 0.0, "camera": 0.0, "engine": None}
BODY_TEXT, LARGE_TEXT = 4.5, 3.0
"""Least contrast of text on its ground, and of large text (success criterion 1.4.3)."""


@pytest.fixture
def served(plain_served):
    plain_served.tell(json.dumps({"ages_s": AGES}))
    return plain_served


class Parsed(HTMLParser):
    """Elements of the served page, in order, with their attributes."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.title, self._in_title = [], "", False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        self._in_title = tag == "title"

    def handle_endtag(self, tag):
        self._in_title = False

    def handle_data(self, data):
        self.title += data if self._in_title else ""

    def by_id(self, name):
        return next(attributes for _, attributes in self.elements if attributes.get("id") == name)


def test_the_served_page_has_a_language_a_title_and_the_emergency_stop_before_all_else(served):
    page = Parsed(served.ask("GET", "/rig")[2])
    assert dict(page.elements)["html"]["lang"].split("-")[0] == "en"
    assert "rig" in page.title
    (viewport,) = (a["content"] for t, a in page.elements if t == "meta" and a.get("name") == "viewport")
    assert "user-scalable" not in viewport
    assert "maximum-scale" not in viewport
    first = next(a for tag, a in page.elements if tag in ("button", "a", "input", "select", "textarea"))
    assert (first["id"], first["aria-label"]) == ("estop", "Emergency stop")
    assert page.by_id("estop-failed")["role"] == "alert"
    assert page.by_id("silence-who")["role"] == "alert"
    assert page.by_id("ages-said")["role"] == "status"
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))


def luminance(colour):
    """Relative luminance of "#rrggbb", as WCAG defines it."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


SIZES = ((390, 844), (1200, 900))
STATES = {
    "ready": {},
    "recording": {"recording": True, "state": "running", "message": "p1, cycle 0: depth", "shots": 3},
    "paused": {"recording": True, "state": "paused", "asked": "pause", "message": "p1, cycle 0: depth"},
    "held": {"held": True, "state": "e-stopped", "message": "emergency stop", "shots": 3, "run": "one"},
    "failed": {
        "state": "failed",
        "message": "force-limit: 21 N",
        "devices": [
            {"name": "stage", "state": "held", "detail": "held by the emergency stop"},
            {"name": "force sensor", "state": "failed", "detail": "saturated"},
            {"name": "camera", "state": "silent", "detail": "the last 9 s ago"},
        ],
        "log": [
            {"utc": "2026-11-23T01:00:00+00:00", "kind": kind, "text": f"a line of {kind}"}
            for kind in ("rig", "operator", "place", "fault")
        ],
        "log_count": 4,
    },
    "stale": {"recording": True, "state": "running", "message": "p1", "ages": 70.0},
}


def opened(browser, served, name="ready", size=SIZES[1], scheme="light"):
    state = dict(STATES[name])
    age_s = state.pop("ages", 0.0)
    engine = {"engine": age_s} if state.get("recording") else {}
    ages = {**dict.fromkeys(AGES, age_s), "engine": None, **engine}
    served.tell(json.dumps({**state, "ages_s": ages}))
    tab = browser.open("about:blank", size=size)
    tab.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    tab.go(served.url("/rig"))
    tab.wait("!!document.querySelector('#force-now b') && !!document.querySelector('#devices b')", 30)
    tab.front()
    time.sleep(0.8)  # for what is animated
    return tab


NAMED = {
    "button",
    "textbox",
    "spinbutton",
    "combobox",
    "link",
    "image",
    "img",
    "region",
    "log",
    "progressbar",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", STATES)
def test_everything_that_is_used_or_seen_has_a_name_for_a_screen_reader(browser, served, name):
    tab = opened(browser, served, name)
    tab.send("Accessibility.enable")
    nodes = tab.send("Accessibility.getFullAXTree")["nodes"]
    found = [
        (one["role"]["value"], one.get("name", {}).get("value", "")) for one in nodes if not one["ignored"]
    ]
    roles = {role for role, _ in found}
    assert {"button", "spinbutton", "combobox", "textbox", "heading", "log", "status", "progressbar"} <= roles
    assert [one for one in found if one[0] in NAMED and not one[1].strip()] == []
    assert ("spinbutton", "grid pitch, in mm") in found
    assert ("textbox", "name of the run") in found
    pictures = [text for role, text in found if role == "image"]
    assert any(text.startswith("the camera's newest picture, 256 by 128 pixels") for text in pictures)
    assert {("image", "Places of the plan on the skin"), ("image", "Force of the last seconds")} <= set(found)
    levels = [
        next(int(p["value"]["value"]) for p in one["properties"] if p["name"] == "level")
        for one in nodes
        if one["role"]["value"] == "heading"
    ]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(later <= before + 1 for before, later in itertools.pairwise(levels))


@pytest.mark.slow
def test_the_tab_key_reaches_the_stop_first_and_shows_where_it_is(browser, served):
    tab = opened(browser, served)
    stops = []
    for _ in range(20):
        tab.key("Tab", 9)
        stops.append(
            tab.run(
                "(() => { const e = document.activeElement, s = getComputedStyle(e);"
                "const f = e.closest('.q-field__control');"
                "const ring = f ? getComputedStyle(f, '::after').borderTopWidth : s.outlineWidth;"
                "return [e.id || e.getAttribute('aria-label') || e.tagName, e.matches(':focus-visible'),"
                "parseFloat(ring), f ? 'solid' : s.outlineStyle] })()"
            )
        )
    assert stops[0][0] == "estop"
    assert all(seen and width >= 2 and style != "none" for _, seen, width, style in stops), stops
    assert len({name for name, *_ in stops}) == len(stops)  # and is caught nowhere


CONTRASTS = """(() => {
  const rgba = (text) => { const v = text.match(/[\\d.]+/g).map(Number);
    return v.length < 4 ? [...v, 1] : v };
  const over = (top, under) => [0, 1, 2].map((i) => top[i] * top[3] + under[i] * (1 - top[3])).concat(1);
  const light = (c) => { const [r, g, b] = c.slice(0, 3).map((v) => v / 255).map((v) =>
    v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4); return 0.2126 * r + 0.7152 * g + 0.0722 * b };
  const ground = (e) => { const above = []; for (let a = e; a; a = a.parentElement) {
    const c = rgba(getComputedStyle(a).backgroundColor); if (c[3] > 0) above.unshift(c);
    if (c[3] === 1) break }
    return above.reduce((under, top) => over(top, under), [255, 255, 255, 1]) };
  const found = [];
  for (const e of document.querySelectorAll("body *")) {
    const text = [...e.childNodes].filter((n) => n.nodeType === 3).map((n) => n.data.trim()).join("");
    const box = e.getBoundingClientRect(), style = getComputedStyle(e);
    if (!text || ["SCRIPT", "STYLE", "TITLE", "title", "desc"].includes(e.tagName)) continue;
    if (e.closest("[disabled], .disabled, .q-field--disabled, .unseen, i.q-icon")) continue;
    if (!e.checkVisibility({ visibilityProperty: true, opacityProperty: true }) || box.width < 2) continue;
    if (e.closest("#popup, #too_long_message_popup, #esm-fallback")) continue;
    let opacity = 1; for (let a = e; a; a = a.parentElement) opacity *= Number(getComputedStyle(a).opacity);
    const under = ground(e), own = rgba(e instanceof SVGElement ? style.fill : style.color);
    const shown = over([...own.slice(0, 3), own[3] * opacity], under);
    const [low, high] = [light(shown), light(under)].sort((a, b) => a - b);
    const px = parseFloat(style.fontSize), bold = Number(style.fontWeight) >= 700;
    const large = px >= 24 || (px >= 18.66 && bold);
    found.push([text.slice(0, 40), (high + 0.05) / (low + 0.05), large]);
  }
  return found;
})()"""


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES)
def test_text_stands_out_in_every_state_and_nothing_is_cut_off(browser, served, size, scheme, tmp_path):
    for name in STATES:
        tab = opened(browser, served, name, size, scheme)
        texts = tab.run(CONTRASTS)
        assert len(texts) > 30
        weak = [one for one in texts if one[1] < (LARGE_TEXT if one[2] else BODY_TEXT)]
        assert weak == [], name
        assert tab.run("document.documentElement.scrollWidth") <= size[0]
        tab.screenshot(tmp_path / f"{name}-{scheme}-{size[0]}.png")
        assert (tmp_path / f"{name}-{scheme}-{size[0]}.png").stat().st_size > 10_000
    # The measure itself: grey on the card's ground is told as too weak.
    grey, colours = ("#555555", page_shell.DARK) if scheme == "dark" else ("#aaaaaa", page_shell.LIGHT)
    tab.run(f"document.querySelector('#doing').innerHTML = '<b style=\"color:{grey}\">weak</b>'")
    told = min(one[1] for one in tab.run(CONTRASTS) if one[0] == "weak")
    assert told == pytest.approx(contrast(grey, colours["card"]), abs=0.05)
    assert told < LARGE_TEXT
