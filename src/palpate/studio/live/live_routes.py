"""Addresses under which the pages get the newest pictures of live sensors and of first sessions."""

from __future__ import annotations

from fastapi import FastAPI, Response

from palpate.core import PalpateError
from palpate.studio.library.workspace import Workspace
from palpate.studio.live.live_desk import LiveDesk
from palpate.studio.live.start_desk import StartDesk


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
