"""The emergency stop on the page, which needs nothing of the page but the browser itself.

`estop.html` is plain HTML beside the page's own elements and asks over a request of its own, so that it works
while the page loads, after a reload and when the page's own connection hangs. It acts when pressed, not when
let go. What goes wrong is said loudly, for then the operator must use the switch on the rig.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse

from palpate.core.errors import PalpateError
from palpate.rig.service.rig_client import RigClient

PATH = "/estop"
HEADER = "x-palpate"  # which a page from elsewhere cannot send without being allowed to


def add_route(app: FastAPI, client: RigClient) -> None:
    """Answer to the page's emergency stop, in threads that nothing else can keep busy."""
    threads = ThreadPoolExecutor(8, thread_name_prefix="palpate-estop")

    @app.post(PATH)
    async def estop(request: Request) -> JSONResponse:
        if request.headers.get(HEADER) != "estop":
            return JSONResponse({"error": "not asked from the rig's own page"}, 403)
        try:
            answer = client.send_estop()  # here and now; only its answer is waited for elsewhere
            found = await asyncio.get_running_loop().run_in_executor(threads, answer)
        except PalpateError as e:
            return JSONResponse({"error": str(e)}, 503)
        return JSONResponse(found)
