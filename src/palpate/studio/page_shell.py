"""Shell of every page: the way to the other pages, and the theme.

All of it is plain HTML beside the page's own elements, so that it is there and works before the page's
connection is, and when that hangs.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from html import escape

from nicegui import ui

from palpate.studio import page_style, shown_ages
from palpate.studio.page_failures import notify_of_failures
from palpate.studio.page_style import ACCENT, BAD, INK

PAGES = {
    "start": ("/", "Start"),
    "live": ("/live", "Live"),
    "rig": ("/rig", "Rig"),
    "recordings": ("/recordings", "Recordings"),
    "calibrations": ("/calibrations", "Calibrations"),
    "softness": ("/softness", "Softness"),
    "trials": ("/trials", "Trials"),
}
"""Address and name of each page, in the order in which the shell names them."""

BEAT_S = 0.5


def page_shell(active: str) -> None:
    """Put the shell on a page that is being made; call it before any of the page's own elements.

    Args:
        active: which of `PAGES` it is.
    """
    ui.add_css(page_style.style())
    ui.colors(primary=ACCENT, negative=BAD, dark=INK)
    ui.add_head_html(page_style.text_of("theme.html"))
    ui.add_body_html(page_style.text_of("ages.html"))
    ui.add_body_html(navigation_html(active))
    notify_of_failures()


def navigation_html(active: str) -> str:
    """The ways to all pages, the one that is open marked by more than its colour, and the theme's switch."""
    here = {active: ' aria-current="page"'}
    links = "".join(
        f'<a id="to-{name}" href="{address}"{here.get(name, "")}>{words}</a>'
        for name, (address, words) in PAGES.items()
    )
    return (
        f'<header id="shell"><nav aria-label="Pages">{links}</nav>'
        '<button id="theme" type="button" title="Light, dark, or as the system is">Theme</button></header>'
    )


def page_title(title: str, under: str = "") -> ui.element:
    """The page's heading with a line under it, plain text; other parts of the top may be put inside."""
    top = ui.element("header").classes("top")
    with top:
        line = f'<div class="under">{escape(under)}</div>' if under else ""
        ui.html(f"<h1>{escape(title)}</h1>{line}", sanitize=False)
    return top


class PageBeat:
    """Sign of life that a page's script listens for; where none comes it says that the server is not heard.

    Args:
        ages: of what the page shows, by part [s]; of nothing where left out.
    """

    def __init__(self, ages: Callable[[], shown_ages.Ages] = dict) -> None:
        self._ages = ages
        self._element, self._beats = ui.element("div").props('id="beat" hidden'), 0
        ui.timer(BEAT_S, self._tell)

    def _tell(self) -> None:
        self._beats += 1
        self._element.props["data-ages"] = shown_ages.ages_attribute(self._ages(), self._beats)
        self._element.update()


def keep_in_address(**state: object) -> None:
    """Keep a page's state in its address, without a step in the history; what is None or "" is left out."""
    kept = {name: str(value) for name, value in state.items() if value not in (None, "")}
    ui.run_javascript(
        f"history.replaceState(null, '', location.pathname + '?' + new URLSearchParams({json.dumps(kept)}))"
    )
