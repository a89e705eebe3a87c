"""Server of the studio: loopback only, for pages of its own address only, with nothing of its own to lose.

The emergency stop needs nothing of the page but the browser itself: `estop.html` is plain HTML beside the
page's own elements and asks over a request of its own, so that it works while the page loads, after a reload
and when the page's own connection hangs. It acts when pressed, not when let go. What goes wrong is said
loudly, for then the operator must use the switch on the rig.
"""

from __future__ import annotations

import asyncio
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse

from palpate.core import DeviceError, MissingExtraError, PalpateError
from palpate.rig.service.rig_client import RigClient
from palpate.studio.page_security import ESTOP_PATH, PageSecurity
from palpate.studio.rendering_desk import RenderingDesk

HEADER = "x-palpate"  # which a page from elsewhere cannot send without being allowed to


def add_route(app: FastAPI, client: RigClient, desk: RenderingDesk) -> None:
    """Answer to the page's emergency stop, in threads that nothing else can keep busy."""
    threads = ThreadPoolExecutor(8, thread_name_prefix="palpate-estop")

    @app.post(ESTOP_PATH)
    async def estop(request: Request) -> JSONResponse:
        if request.headers.get(HEADER) != "estop":
            return JSONResponse({"error": "not asked from the rig's own page"}, 403)
        desk.estop()  # one stop for all that this page may move
        try:
            answer = client.send_estop()  # here and now; only its answer is waited for elsewhere
            stop = await asyncio.get_running_loop().run_in_executor(threads, answer)
        except PalpateError as e:
            return JSONResponse({"error": str(e)}, 503)
        return JSONResponse(stop)


HOST = "127.0.0.1"
KEPT = 30  # messages for a tab that loses its connection for a moment
ENDS_S = 2
ALIVE_S = 300  # a connection, so that an emergency stop need not open one
SWITCH_S = 0.001  # between threads, for the same reason


def serve_pages(client: RigClient, port: int, runs: Path, desk: RenderingDesk) -> None:
    """Serve the pages until the process is told to end (Ctrl-C).

    Args:
        client: of the rig's process.
        port: on 127.0.0.1.
        runs: the folder that recordings go into, to be named on the page.
        desk: objects and bench of softness.
    """
    check_needed()
    import uvicorn

    sys.setswitchinterval(SWITCH_S)
    config = uvicorn.Config(
        make_app(client, runs, desk),
        HOST,
        port,
        log_level="warning",
        timeout_graceful_shutdown=ENDS_S,
        timeout_keep_alive=ALIVE_S,
    )
    try:
        uvicorn.Server(config).run()
    finally:
        desk.close()


def make_app(client: RigClient, runs: Path, desk: RenderingDesk) -> PageSecurity:
    """The pages, the emergency stop's own address, and the newest picture, for pages of their own only."""
    from nicegui import ui

    from palpate.studio.rig_page import RigPage
    from palpate.studio.softness_page import SoftnessPage

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    add_route(app, client, desk)

    @app.get("/picture")
    async def picture() -> Response:
        newest = client.picture
        if newest is None:
            return Response(status_code=404)
        return Response(newest[1], media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @ui.page("/", title="Indentation rig · palpate", language="en-US")
    def rig_page() -> None:
        RigPage(client, str(runs))

    @ui.page("/softness", title="Softness · palpate", language="en-US")
    def softness_page() -> None:
        SoftnessPage(desk)

    ui.run_with(app, show_welcome_message=False, message_history_length=KEPT, reconnect_timeout=5.0)
    return PageSecurity(app)


def check_needed() -> None:
    """Refuse to begin without what the pages are made with."""
    try:
        import nicegui  # noqa: F401
    except ImportError as e:
        raise MissingExtraError("the studio needs NiceGUI: pip install 'palpate[studio]'") from e


def check_port(port: int) -> None:
    """Refuse a port that is taken before anything is started."""
    import socket

    try:
        with socket.create_server((HOST, port)):
            pass
    except OSError as e:
        raise DeviceError(f"port {port} on {HOST} cannot be used ({e.strerror}); give another --port") from e
