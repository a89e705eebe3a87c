"""Shell of every page: the way to the other pages, and the theme.

All of it is plain HTML beside the page's own elements, so that it is there and works before the page's
connection is, and when that hangs.

Style of the pages: the reports' colours, light and dark, system fonts, nothing from elsewhere.

Parts of pages as HTML: tables that stack on a narrow page, words that stand for a state, commands.

Exceptions of the page server: one line in the terminal, the traceback in a log, a notice on every page.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Sequence
from html import escape
from importlib import resources

from nicegui import app, ui

from palpate.core import InputError
from palpate.core.failure_log import Failure, recent_failures, record_failure
from palpate.studio import status_text

LOGGERS = ("nicegui", "uvicorn.error", "asyncio")
"""Loggers to which the page server's libraries write exceptions that nothing handled."""
LOOK_S = 1.0  # between two looks for new failures


class FailureFilter(logging.Filter):
    """Replaces the traceback of a log record by one line, and writes it to the log of failures."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Rewrite a record that carries an exception; every record passes."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, Exception):
            failure = record_failure(error, "the studio")
            record.msg, record.args, record.exc_info, record.exc_text = failure.text, (), None, None
        return True


def contain_failures() -> None:
    """Install the filter once, and show the code and the log on a page that cannot be built."""
    for name in LOGGERS:
        logger = logging.getLogger(name)
        if not any(isinstance(one, FailureFilter) for one in logger.filters):
            logger.addFilter(FailureFilter())
    app.on_page_exception(lambda error: ui.label(record_failure(error, "a page").text))


def notify_of_failures() -> None:
    """Notify the page that is being built of failures of the server from now on."""
    seen: list[Failure] = recent_failures.items()

    def look() -> None:
        for failure in recent_failures.items():
            if not any(failure is one for one in seen):
                ui.notify(failure.text, type="negative", timeout=0, close_button="Close")
        seen[:] = recent_failures.items()

    ui.timer(LOOK_S, look)


INK, ACCENT, BAND, BAD = "#1b2a33", "#0b7a75", "#cfe8e6", "#c0392b"
"""The reports' colours."""
SOFT, LINE, GROUND, WARN = "#5b6b75", "#d9e0e4", "#f4f6f7", "#855900"
LIGHT = {
    "ink": INK, "accent": ACCENT, "band": BAND, "bad": BAD, "soft": SOFT, "line": LINE, "ground": GROUND,
    "warn": WARN, "card": "#ffffff", "alarm": BAD, "alarm-edge": "#7d1f14", "held": "#fbe9e7",
    "held-ink": "#7d1f14", "notice": "#fdf0d2", "on-fill": "#ffffff", "fill": ACCENT,
    "axis-x": "#b0642b", "axis-y": "#5b6fb5", "axis-z": ACCENT,
}  # fmt: skip
"""Colours by name where the page is light."""
DARK = {
    "ink": "#e8eef1", "accent": "#4cc2ba", "band": "#1f4a4b", "bad": "#ff9a8c", "soft": "#a9b8c1",
    "line": "#34434c", "ground": "#10181d", "warn": "#f0c25a", "card": "#182229", "alarm": BAD,
    "alarm-edge": "#f2b3aa", "held": "#4a1f1a", "held-ink": "#ffd9d3", "notice": "#43361a",
    "on-fill": "#ffffff", "fill": ACCENT, "axis-x": "#e59a5f", "axis-y": "#9db0f2", "axis-z": "#4cc2ba",
}  # fmt: skip
"""The same where it is dark. What is filled keeps its colour, so that white text on it stays as readable."""


def paint(name: str) -> str:
    """A colour of the theme that is shown, as drawings and styles name it."""
    if name not in LIGHT:
        raise InputError(f"no colour is called {name!r}; there are {', '.join(LIGHT)}")
    return f"var(--{name})"


AXES = {axis: paint(f"axis-{axis}") for axis in "xyz"}
"""Colours of the force: the normal one is the accent."""


def style() -> str:
    """The pages' CSS: `look.css`, and its colours by name for both themes."""
    light, dark = (
        "; ".join(f"--{name}: {colour}" for name, colour in colours.items()) for colours in (LIGHT, DARK)
    )
    return (
        f":root {{ color-scheme: light; {light} }}\n"
        f":root[data-theme=dark] {{ color-scheme: dark; {dark} }}\n{text_of('look.css')}"
    )


def text_of(name: str) -> str:
    """A file of this folder."""
    return resources.files("palpate.studio").joinpath(name).read_text(encoding="utf-8")


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
    ui.add_css(style())
    ui.colors(primary=ACCENT, negative=BAD, dark=INK)
    ui.add_head_html(text_of("theme.html"))
    ui.add_body_html(text_of("ages.html"))
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

    def __init__(self, ages: Callable[[], status_text.Ages] = dict) -> None:
        self._ages = ages
        self._element, self._beats = ui.element("div").props('id="beat" hidden'), 0
        ui.timer(BEAT_S, self._tell)

    def _tell(self) -> None:
        self._beats += 1
        self._element.props["data-ages"] = status_text.ages_attribute(self._ages(), self._beats)
        self._element.update()


def keep_in_address(**state: object) -> None:
    """Keep a page's state in its address, without a step in the history; what is None or "" is left out."""
    kept = {name: str(value) for name, value in state.items() if value not in (None, "")}
    ui.run_javascript(
        f"history.replaceState(null, '', location.pathname + '?' + new URLSearchParams({json.dumps(kept)}))"
    )


def state_word(text: str, look: str = "") -> str:
    """A state in a word, on a ground of its own; `look` is "", "warn" or "bad"."""
    return f'<span class="word {look}">{escape(text)}</span>'


def simulated_badge(simulated: bool) -> str:
    """The mark of what no real sensor gave, to stand behind a name; "" for what was measured."""
    return f" {state_word('simulated, not measured', 'warn')}" if simulated else ""


def table_html(heads: Sequence[str], rows: Sequence[Sequence[str]], look: str = "") -> str:
    """A table of cells that are HTML; on a narrow page each cell says its column's name itself.

    Args:
        look: class of the style sheet, for columns of widths of their own.
    """
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = ""
    for row in rows:
        cells = zip(heads, row, strict=True)
        body += (
            "<tr>" + "".join(f'<td data-name="{escape(h)}"><div>{c}</div></td>' for h, c in cells) + "</tr>"
        )
    return f'<table class="table stacks {look}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'


def progress_html(step: str, done: int, total: int, label: str) -> str:
    """How far something is: in words, in numbers and as a bar."""
    share = 100 * done / total if total else 0
    return (
        f'<div class="progress"><div class="said"><span>{escape(step)}</span><span>{done} of {total or "?"}'
        f'</span></div><div class="bar" role="progressbar" aria-label="{escape(label, quote=True)}" '
        f'aria-valuenow="{share:.0f}" aria-valuemin="0" aria-valuemax="100"><i style="width:{share:.1f}%">'
        "</i></div></div>"
    )


def trouble_html(text: str) -> str:
    """What is wrong, in a line."""
    return f'<p class="trouble">{escape(text)}</p>'


def commands_html(commands: Sequence[str]) -> str:
    """Commands as they are typed."""
    typed = escape("\n".join(commands))
    return f'<pre class="commands">{typed}</pre>'
