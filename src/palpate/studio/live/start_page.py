"""Start: what there is to do first, with a sensor or without one."""

from __future__ import annotations

from nicegui import ui

from palpate.studio.library.workspace import Workspace
from palpate.studio.page_shell import PageBeat, page_shell, page_title


class StartPage:
    """First page, in one tab.

    Args:
        workspace: that is worked in.
    """

    def __init__(self, workspace: Workspace) -> None:
        page_shell("start")
        PageBeat()
        page_title("Start", f"workspace {workspace.folder}")
        with ui.element("main").classes("sheet"):
            ui.html(WAYS, sanitize=False)


WAYS = (
    '<section class="card" aria-label="Ways to begin"><h2>Where to go</h2><ul>'
    '<li><a href="/live">Live</a>: read sensors now, with a calibration or without.</li>'
    '<li><a href="/rig">Rig</a>: record a calibration set, on the virtual rig or your own.</li>'
    '<li><a href="/recordings">Recordings</a>: play, note and compare what was recorded.</li>'
    '<li><a href="/calibrations">Calibrations</a>: scores, reports, comparisons.</li>'
    '<li><a href="/softness">Softness</a>: render an object on a display.</li>'
    '<li><a href="/trials">Trials</a>: experiments with people.</li></ul></section>'
)
