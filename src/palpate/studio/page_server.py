"""Page server of the studio: loopback by default, for its own pages only, with limits on clients.

The emergency stop does not depend on it: `estop.html` is plain HTML and sends its requests to the listener of
`stop_process`. The page server forwards them where a browser cannot reach the listener, for example through
an SSH tunnel of one port.
"""

from __future__ import annotations

import asyncio
import errno
import json
import socket
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse

from palpate.core import DeviceError, PalpateError
from palpate.core.failure_log import contained, log_in_workspace
from palpate.devices.long_running import keep_loaded
from palpate.rig.service.rig_client import RigClient
from palpate.studio.library.background_jobs import BackgroundJobs
from palpate.studio.library.workspace import Workspace, add_library_routes
from palpate.studio.live.live_desk import LiveDesk, LiveProcesses
from palpate.studio.live.start_desk import StartDesk
from palpate.studio.operator_lease import OperatorCookie, RigLease, operator_of
from palpate.studio.page_security import ESTOP_PATH, PageSecurity, TokenGate, cookies_of, names_of_server
from palpate.studio.page_shell import contain_failures, text_of
from palpate.studio.softness_page import RenderingDesk
from palpate.studio.stop_listener import StopListener, rig_targets


def add_live_routes(app: FastAPI, lives: LiveDesk, starts: StartDesk, workspace: Workspace) -> None:
    """Answer for pictures, from memory; nothing is begun by asking."""

    @app.get("/live/picture")
    async def live_picture(name: str) -> Response:
        sensor = lives.listened(name)
        newest = None if sensor is None else sensor.connection.picture
        return _jpeg(None if newest is None else newest[1])

    @app.get("/start/picture")
    async def start_picture(folder: str) -> Response:
        try:
            run = starts.run(workspace.resolve(folder))
        except PalpateError:
            run = None
        return _jpeg(None if run is None or run.picture is None else run.picture[1])


def _jpeg(data: bytes | None) -> Response:
    if data is None:
        return Response(status_code=404)
    return Response(data, media_type="image/jpeg", headers={"Cache-Control": "no-store"})


MAX_DIGITS = 10
HEADER = "x-palpate"  # which a page from elsewhere cannot send without being allowed to
STOP_REQUESTS = ("state", "stop", "stop-moving")


def add_route(app: FastAPI, parts: StudioParts, listener: StopListener) -> None:
    """Forward a page's requests to the emergency stop listener, in threads that nothing else keeps busy."""
    threads = ThreadPoolExecutor(8, thread_name_prefix="palpate-estop")

    def forward(do: str) -> dict[str, Any]:
        try:
            return listener.ask(do)
        except DeviceError:
            if do == "state":
                raise
            parts.desk.estop()
            parts.client.send_estop()()
            return {"ok": True, "moving": True, "stopped": [{"name": parts.client.name}], "failed": []}

    @app.post(ESTOP_PATH)
    async def estop(request: Request) -> JSONResponse:
        if request.headers.get(HEADER) != "estop":
            return JSONResponse({"error": "not asked from the rig's own page"}, 403)
        do = (await request.body()).decode("utf-8", "replace")
        do = do if do in STOP_REQUESTS else "stop"
        try:
            answer = await asyncio.get_running_loop().run_in_executor(threads, forward, do)
        except PalpateError as e:
            return JSONResponse({"error": str(e)}, 503)
        return JSONResponse(answer, 200 if answer.get("ok") else 503)


HOST = "127.0.0.1"
HTTP_PORT, MAX_PORT = 8080, 65535
KEPT = 30  # messages for a tab that loses its connection for a moment
ENDS_S = 2
ALIVE_S = 300  # a connection, so that an emergency stop need not open one
SWITCH_S = 0.001  # between threads, for the same reason
RECONNECT_S = 20.0
"""Time within which a tab that was cut off finds what it had. A browser is asked for a sign of life every
0.8 of it and cut off after another 0.4 without one, and a busy computer keeps one silent for some seconds."""


@dataclass
class StudioParts:
    """Parts of the studio that all pages of one server share.

    Attributes:
        runs: the folder that the rig's recordings go into, to be named on the page.
        launch_rig: starts the rig's process and waits until it answers.
        folder: address files of the workspace's processes; None for the user's own.
    """

    client: RigClient
    runs: Path
    desk: RenderingDesk
    workspace: Workspace
    launch_rig: Callable[[], object]
    folder: Path | None = None
    lease: RigLease = field(default_factory=RigLease)
    jobs: BackgroundJobs = field(default_factory=BackgroundJobs)
    lives: LiveDesk = field(init=False)
    starts: StartDesk = field(default_factory=StartDesk)

    def __post_init__(self) -> None:
        self.lives = LiveDesk(LiveProcesses(self.folder))

    def close(self) -> None:
        """End what the server itself has begun; the rig and live sensors go on."""
        self.starts.close()
        self.lives.close()
        self.jobs.close()
        self.desk.close()


def serve_pages(parts: StudioParts, port: int, token: str, host: str = HOST) -> None:
    """Serve the pages until the process is told to end (Ctrl-C).

    Args:
        token: that every request carries, in the address or in a cookie.
    """
    import uvicorn

    from palpate.studio import page_limits

    log_in_workspace(parts.workspace.folder)
    sys.setswitchinterval(SWITCH_S)
    targets = rig_targets(parts.client.name, parts.desk.bench.name, parts.folder)
    with StopListener(targets, host, min(port + 1, MAX_PORT)) as listener:
        config = uvicorn.Config(
            make_app(parts, port, token, listener, host),
            host,
            port,
            http=page_limits.limited_http(),
            backlog=page_limits.BACKLOG,
            log_level="warning",
            timeout_graceful_shutdown=ENDS_S,
            timeout_keep_alive=ALIVE_S,
        )
        keep_loaded()
        try:
            with contained("the studio"):
                uvicorn.Server(config).run()
        finally:
            parts.close()


def make_app(
    parts: StudioParts, port: int, token: str, listener: StopListener, host: str = HOST
) -> PageSecurity:
    """The pages, the emergency stop's own address, and the newest picture, for pages of their own only."""
    from nicegui import ui

    from palpate.studio.page_limits import PageQueue
    from palpate.studio.page_shell import PAGES

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    add_route(app, parts, listener)
    # Before all else, also for the Tab key.
    ui.add_body_html(estop_html(listener.port, listener.token), shared=True)
    add_library_routes(app, parts.workspace, parts.jobs)

    @app.get("/picture")
    async def picture() -> Response:
        newest = parts.client.picture
        if newest is None:
            return Response(status_code=404)
        return Response(newest[1], media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    add_live_routes(app, parts.lives, parts.starts, parts.workspace)
    add_pages(parts)
    contain_failures()
    ui.run_with(
        app,
        language="en-US",
        dark=None,
        show_welcome_message=False,
        message_history_length=KEPT,
        reconnect_timeout=RECONNECT_S,
    )
    inner = OperatorCookie(PageQueue(app, [address for address, _ in PAGES.values()]))
    return PageSecurity(TokenGate(inner, token, port), names_of_server(host), listener.port)


def estop_html(port: int, token: str) -> str:
    """Return the emergency stop of a page, with the port and the token of its listener."""
    about = json.dumps({"port": port, "token": token, "path": ESTOP_PATH})
    return text_of("estop.html").replace('"LISTENER"', about)


def add_pages(parts: StudioParts) -> None:
    """Name the pages; each is imported when it is first asked for, so that the first is there soon."""
    from nicegui import ui

    @ui.page("/", title="Start · palpate")
    def start_page(request: Request) -> None:
        from palpate.studio.live.start_page import StartPage

        asked = dict(request.query_params)
        StartPage(parts.workspace, parts.starts, parts.lives, asked.get("folder", ""), asked)

    @ui.page("/live", title="Live · palpate")
    def live_page(request: Request) -> None:
        from palpate.studio.live.live_page import LivePage

        LivePage(parts.workspace, parts.lives, request.query_params.getlist("sensor"))

    @ui.page("/rig", title="Indentation rig · palpate")
    def rig_page() -> None:
        from palpate.studio.rig_page import RigPage

        request = ui.context.client.request
        where = request.client.host if request.client else None
        operator = operator_of(cookies_of(request.scope), where)
        RigPage(parts.client, str(parts.runs), parts.lease, operator, parts.launch_rig)

    @ui.page("/softness", title="Softness · palpate")
    def softness_page() -> None:
        from palpate.studio.softness_page import SoftnessPage

        SoftnessPage(parts.desk)

    @ui.page("/recordings", title="Recordings · palpate")
    def recordings_page(request: Request) -> None:
        from palpate.studio.library.recordings_page import RecordingsPage

        asked = request.query_params
        frames = (_whole(asked.get("frame")), _whole(asked.get("beside_frame")))
        names = (asked.get("run", ""), asked.get("beside", ""))
        RecordingsPage(parts.workspace, parts.jobs, *names, frames, asked.get("split", ""))

    @ui.page("/calibrations", title="Calibrations · palpate")
    def calibrations_page(request: Request) -> None:
        from palpate.studio.library.calibrations_page import CalibrationsPage

        asked = request.query_params
        chosen = (asked.get("cal", ""), asked.get("beside", ""), asked.get("run", ""))
        CalibrationsPage(parts.workspace, parts.jobs, chosen)

    @ui.page("/trials", title="Trials · palpate")
    def trials_page() -> None:
        from palpate.studio.library.trials_page import TrialsPage

        TrialsPage(parts.workspace, parts.jobs)


def _whole(text: str | None) -> int:
    """A number of a frame as it stands in an address; 0 where it is none."""
    return int(text) if text and text.isascii() and text.isdigit() and len(text) < MAX_DIGITS else 0


def check_port(port: int, host: str = HOST) -> None:
    """Refuse a port that is taken, or an address that is not here, before anything is started."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.create_server((host, port), family=family):
            pass
    except OSError as e:
        raise DeviceError(_no_port_text(port, host, e), code="address-unavailable") from e


def _no_port_text(port: int, host: str, e: OSError) -> str:
    """Why nobody can listen at a port, and what to do."""
    other = port + 1 if port < MAX_PORT else HTTP_PORT
    if e.errno == errno.EADDRINUSE:
        shown = f"[{host}]" if ":" in host else host
        return (
            f"port {port} on {host} is in use by another program, perhaps a studio that runs already: open "
            f"http://{shown}:{port}/, end that program, or give another port, such as --port {other}"
        )
    if e.errno == errno.EACCES:
        return f"port {port} on {host} is kept for the system's own programs; give --port {HTTP_PORT}"
    if e.errno == errno.EADDRNOTAVAIL or isinstance(e, socket.gaierror):
        return f"--host {host} (port {port}) is no address of this computer; give one of its own, or none"
    return f"port {port} on {host} cannot be used ({e.strerror or e}); give another, such as --port {other}"
