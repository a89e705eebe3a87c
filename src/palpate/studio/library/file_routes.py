"""Addresses under which the pages get pictures of runs, their labels, and reports that jobs have written."""

from __future__ import annotations

from typing import Any

import cv2
from fastapi import FastAPI, Query, Response
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse

from palpate.core import Image, InputError, PalpateError, RangeError
from palpate.studio.library.background_jobs import BackgroundJobs
from palpate.studio.library.workspace import Workspace

MIN_PX, MAX_PX = 16, 1920
"""Width that a picture may be asked for [px]; it is never made larger than it was recorded."""
QUALITY = 85  # of the JPEG
SHEET_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""Of a report, which is a document: it runs no script, asks for nothing, and is of no origin."""

Frames = Query(ge=0, le=10**9)
Width = Query(ge=MIN_PX, le=MAX_PX)


def add_library_routes(app: FastAPI, workspace: Workspace, jobs: BackgroundJobs) -> None:
    """Answer for frames, labels and reports. All work is done in threads, beside the pages' own loop."""

    @app.get("/run/frame")
    def frame(run: str, index: int = Frames, px: int = Width) -> Response:
        try:
            image = workspace.run(run).frame(index).image
        except PalpateError as e:
            return _refused(e)
        return Response(jpeg_bytes(image, px), media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @app.get("/run/labels")
    def labels(run: str, index: int = Frames) -> Response:
        try:
            opened = workspace.run(run)
            opened_labels = opened.labels
        except PalpateError as e:
            return _refused(e)
        if index >= len(opened):
            return PlainTextResponse(f"the run has frames 0 to {len(opened) - 1}", 404)
        row = opened_labels.iloc[index].dropna()
        known = {str(name): _plain(value) for name, value in row.items()}
        return JSONResponse({"time_s": round(float(opened.times_s[index]), 6), "labels": known})

    @app.get("/sheet/{number}")
    def sheet(number: int) -> Response:
        job = jobs.get(number)
        if job is None or job.state != "done" or job.out.suffix != ".html":
            return PlainTextResponse("there is no such page; it may still be written", 404)
        return HTMLResponse(job.out.read_bytes(), headers={"content-security-policy": SHEET_POLICY})


def jpeg_bytes(image: Image, px: int) -> bytes:
    """An image as a JPEG, not wider than so many pixels."""
    height, width = image.shape[:2]
    rows = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    if width > px:
        rows = cv2.resize(rows, (px, max(1, round(height * px / width))), interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", rows, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes()


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value


def _refused(error: PalpateError) -> PlainTextResponse:
    missing = isinstance(error, RangeError)
    return PlainTextResponse(str(error), 404 if missing or isinstance(error, InputError) else 422)
