"""Workspace: the one folder whose runs, calibrations and experiments the pages show; none leads out of it.

Addresses under which the pages get pictures of runs, their labels, and reports that jobs have written.
"""

from __future__ import annotations

import os
import re
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import cv2
from fastapi import FastAPI, Query, Response
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse

from palpate.core import Image, InputError, PalpateError, RangeError
from palpate.estimators.certified import CARD_FILE, read_card
from palpate.estimators.model_card import Card
from palpate.psychophysics.experiments.experiment_file import EXPERIMENT
from palpate.recordings import Run
from palpate.recordings.manifest import MANIFEST, NOTES
from palpate.studio.library.background_jobs import BackgroundJobs

MAX_DEPTH = 4
"""Folders below the workspace that are looked into."""
LINK_DEPTH = 3
"""Folders of a run or calibration that are searched for links that lead out."""
MAX_LISTED = 500
"""Of a kind that are listed."""
MAX_VISITED = 20_000
"""Folders that are looked into in all."""
MAX_NAME = 1000
MAX_OPEN_RUNS = 4
WRITTEN_S = 5.0
"""A run whose last file has no index and changed within this time is said to be written [s]."""
TIP_ARRAYS = {"layout_px.npy", "levels_n.npy", "touch.turning_n_m.npy"}
"""In an archive that is a calibration of a tip's softness."""
KINDS = {MANIFEST: "run", CARD_FILE: "calibration", EXPERIMENT: "experiment"}

PROJECT = re.compile(r"""^name\s*=\s*["']palpate["']""", re.MULTILINE)
"""Line of a project file by which the source tree of this package is recognized."""

Stamp = tuple[tuple[str, int, int], ...]


class OutsideError(InputError):
    """A name leads out of the workspace."""

    code = "outside-workspace"


class SourceTreeError(InputError):
    """A workspace lies in the source tree of this package."""

    code = "source-tree"


@dataclass(frozen=True, slots=True)
class RunSummary:
    """List entry of a run.

    Attributes:
        length_s: Time from the first to the last frame; None for ordinal times [s].
        state: "whole", "empty", "being written", "not closed" or "damaged".
    """

    name: str
    frames: int
    length_s: float | None
    labels: tuple[str, ...]
    targets: tuple[str, ...]
    sensor: str
    begun: str
    size_bytes: int
    state: str
    why: str
    simulated: bool = False


class Workspace:
    """Workspace of the studio.

    Args:
        folder: that is shown; it need not be there yet.
    """

    def __init__(self, folder: Path) -> None:
        if folder.exists() and not folder.is_dir():
            raise InputError(
                f"the workspace {folder} is a file; give a folder, such as the one it lies in",
                code="not-a-folder",
            )
        self.folder = folder.resolve()
        if (tree := source_tree_of(self.folder)) is not None:
            raise SourceTreeError(
                f"The workspace {self.folder} lies in the source tree {tree}. Choose a folder outside it, "
                "such as ~/palpate."
            )
        self._turn = threading.Lock()
        self._runs: OrderedDict[Path, tuple[Stamp, Run]] = OrderedDict()
        self._summaries: dict[Path, tuple[Stamp, str, RunSummary]] = {}
        self._useless: dict[str, bool] = {}

    def resolve(self, name: str) -> Path:
        """The path of something in the workspace, by its name from there."""
        bad = not name or len(name) > MAX_NAME or not name.isprintable() or "\\" in name
        if not bad and not Path(name).is_absolute():
            path = (self.folder / name).resolve()
            if path != self.folder and path.is_relative_to(self.folder) and not self._leads_out(path):
                return path
        raise OutsideError(
            f"{name[:80]!r} is nothing in the workspace {self.folder}; name what lies in it, as the lists of "
            "the pages do"
        )

    def _leads_out(self, path: Path, depth: int = LINK_DEPTH) -> bool:
        """Whether a link in a folder, or in a folder of it, leads out of the workspace."""
        try:
            with os.scandir(path) as entries:
                return any(
                    not Path(one.path).resolve().is_relative_to(self.folder)
                    if one.is_symlink()
                    else depth > 1 and one.is_dir() and self._leads_out(Path(one.path), depth - 1)
                    for one in entries
                )
        except OSError:
            return False

    def name_of(self, path: Path) -> str:
        """The name of something from the workspace."""
        return path.resolve().relative_to(self.folder).as_posix()

    def found(self, kind: str) -> list[str]:
        """Return the names of what exists of a kind, newest first.

        Args:
            kind: "run", "calibration", "experiment", or "tip" (file of a softness calibration).
        """
        paths = [path for path, what in self._walk() if what == kind]
        paths.sort(key=lambda path: path.stat().st_mtime_ns if path.exists() else 0, reverse=True)
        return [self.name_of(path) for path in paths[:MAX_LISTED]]

    def run(self, name: str) -> Run:
        """A run, opened anew where its files have changed since."""
        path = self.resolve(name)
        stamp = _stamp(path)
        with self._turn:
            kept = self._runs.get(path)
            if kept is not None and kept[0] == stamp:
                self._runs.move_to_end(path)
                return kept[1]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is damaged is told by the list
            run = Run.open(path)
        with self._turn:
            self._runs[path] = stamp, run
            while len(self._runs) > MAX_OPEN_RUNS:
                self._runs.popitem(last=False)
        return run

    def summary(self, name: str) -> RunSummary:
        """Summary of a run; one that cannot be opened is damaged, and says why."""
        path = self.resolve(name)
        stamp = _stamp(path)
        kept = self._summaries.get(path)
        if kept is not None and kept[0] == stamp and kept[2].state != "being written":
            return kept[2]
        found = self._summary(name, path, stamp)
        self._summaries[path] = stamp, name, found
        return found

    def card(self, name: str) -> Card:
        """Card of a calibration."""
        return read_card(self.resolve(name))

    def is_useless(self, name: str, card: Card) -> bool:
        """Return whether a force calibration from hand presses is not certainly better than the mean.

        False for other calibrations and for unreadable predictions.
        """
        from palpate.calibration.certificate import read_predictions
        from palpate.workflows.certification import TARGET, is_useless

        if card.columns != [TARGET] or card.split.columns != ("press",):
            return False
        if card.id not in self._useless:  # which stands for the predictions too, by their hash
            try:
                self._useless[card.id] = is_useless(card, read_predictions(self.resolve(name), card))
            except PalpateError:
                return False
        return self._useless[card.id]

    def _summary(self, name: str, path: Path, stamp: Stamp) -> RunSummary:
        size = sum(size for _, size, _ in stamp)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                run = Run.open(path)
        except (PalpateError, OSError) as e:
            return RunSummary(name, 0, None, (), (), "", "", size, "damaged", str(e))
        about, times_s = run.manifest, run.times_s
        timed = about.clock == "measured" and len(times_s) > 0
        state, why = _state_of(run, stamp)
        return RunSummary(
            name, len(run), float(times_s[-1] - times_s[0]) if timed else None, tuple(about.labels),
            tuple(about.targets), about.sensor, about.created_utc, size, state, why,
            about.is_simulated,
        )  # fmt: skip

    def _walk(self) -> Iterator[tuple[Path, str]]:
        """What is there, with its kind; links are not followed, nor hidden folders looked into."""
        for visited, (at, folders, files) in enumerate(os.walk(self.folder), 1):
            kinds = [kind for file, kind in KINDS.items() if file in files]
            depth = len(Path(at).relative_to(self.folder).parts)
            whole = "run" in kinds or "calibration" in kinds
            if whole or depth >= MAX_DEPTH or visited >= MAX_VISITED:
                folders.clear()
            folders[:] = sorted(one for one in folders if not one.startswith("."))
            if at != str(self.folder):
                yield from ((Path(at), kind) for kind in kinds)
            if not whole:
                yield from ((Path(at) / one, "tip") for one in files if _is_tip(Path(at) / one))


def source_tree_of(folder: Path) -> Path | None:
    """The source tree of this package that a folder is or lies in; None outside of any."""
    for one in (folder, *folder.parents):
        try:
            if PROJECT.search((one / "pyproject.toml").read_text(encoding="utf-8", errors="replace")):
                return one
        except OSError:
            continue
    return None


def _is_tip(path: Path) -> bool:
    """Whether a file is a calibration of a tip's softness, by the names in its archive alone."""
    if path.suffix != ".npz" or path.is_symlink():
        return False
    try:
        with ZipFile(path) as archive:
            return set(archive.namelist()) >= TIP_ARRAYS
    except (BadZipFile, OSError):
        return False


def _stamp(path: Path) -> Stamp:
    """Name, size and time of change of a folder's files, so that a change is seen."""
    try:
        with os.scandir(path) as entries:
            return tuple(
                sorted(
                    (e.name, e.stat().st_size, e.stat().st_mtime_ns)
                    for e in entries
                    if e.is_file() and e.name != NOTES
                )
            )
    except OSError:
        return ()


def _state_of(run: Run, stamp: Stamp) -> tuple[str, str]:
    """State of a run in a word, and what is wrong; its frames' bytes are not read for this."""
    unclosed = any(
        file.data_end is None
        for segment in run.segments
        for file in (segment.frames_file, segment.signals_file)
    )
    newest_s = max((changed_ns for *_, changed_ns in stamp), default=0) / 1e9
    if unclosed and time.time() - newest_s < WRITTEN_S:
        return "being written", ""
    damage = [str(one) for segment in run.segments for one in segment.damage]
    if unclosed:
        return "not closed", "it was cut short while it was written; what was written before can be read"
    if damage:
        return "damaged", damage[0]
    return ("whole", "") if len(run) else ("empty", "it holds no frame")


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
