"""What the studio's server keeps of softness: a folder's objects, the bench, and the rendering that runs.

The rendering belongs to the server and not to a tab: a reload loses nothing, every tab shows the same, and
where the server ends, the rendering's process sees it and makes the devices safe.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from palpate.core import InputError, PalpateError
from palpate.softness import Mode, RenderingLaw, SoftObject, is_object_file, read_object
from palpate.softness.control import LoopSample
from palpate.softness.process import BenchFile, RenderingSession, RenderingStatus

KEPT_S = 10.0  # of samples that are shown
KEPT = 1000
MAX_OBJECTS = 200

Begin = Callable[[BenchFile, SoftObject, Mode, float, float], RenderingSession]


class RenderingDesk:
    """Objects, bench and rendering, shared by all tabs."""

    def __init__(self, folder: Path, bench: BenchFile, begin: Begin = RenderingSession) -> None:
        self.folder, self.bench, self._begin = folder, bench, begin
        self._turn = threading.Lock()
        self._session: RenderingSession | None = None
        self._samples: deque[LoopSample] = deque(maxlen=KEPT)

    def objects(self) -> tuple[dict[str, SoftObject], dict[str, str]]:
        """Objects of the folder by their file's name; and why other objects' files cannot be used.

        A TOML file without a table of an object, such as a rig's, is left out.
        """
        found: dict[str, SoftObject] = {}
        refused: dict[str, str] = {}
        for path in sorted(filter(is_object_file, self.folder.glob("*.toml")))[:MAX_OBJECTS]:
            try:
                found[path.stem] = read_object(path)
            except PalpateError as e:
                refused[path.name] = str(e).removeprefix(f"{path}: ")
        return found, refused

    @property
    def law(self) -> RenderingLaw | None:
        """What is rendered, or was last; None before the first."""
        session = self._session
        return None if session is None else session.law

    @property
    def status(self) -> RenderingStatus | None:
        """How the rendering stands; None before the first."""
        session = self._session
        return None if session is None else session.status()

    @property
    def told_s(self) -> float | None:
        """When the rendering's process told anything last; None where none runs [s, monotonic time]."""
        session = self._session
        return None if session is None or session.status().state == "ended" else session.told_s

    def samples(self) -> list[LoopSample]:
        """Samples of the last `KEPT_S`, oldest first."""
        with self._turn:
            if self._session is not None:
                self._samples.extend(self._session.taken())
            newest_s = self._samples[-1].time_s if self._samples else 0.0
            return [one for one in self._samples if one.time_s > newest_s - KEPT_S]

    def begin(self, name: str, mode: Mode, peak_n: float, frequency_hz: float) -> None:
        """Begin to render an object, or turn into it where one is rendered in the same mode."""
        path = self.folder / f"{name}.toml"
        soft = read_object(path)
        with self._turn:
            now = self._session
            if now is not None and now.status().state == "renders":
                if now.status().mode is not mode:
                    raise InputError(
                        f"{now.status().mode.value} is rendered; stop it before {mode.value} begins, and "
                        "take the finger away",
                        code="rendering-running",
                    )
                now.show(soft)
                return
            self._close()
            self._samples.clear()
            self._session = self._begin(self.bench, soft, mode, peak_n, frequency_hz)

    def end(self) -> None:
        """End the rendering: the chamber vents and the arm brakes."""
        session = self._session
        if session is not None:
            session.stop()

    def estop(self) -> None:
        """Emergency stop; at once, whatever else is asked."""
        session = self._session
        if session is not None:
            session.estop()

    def close(self) -> None:
        """End the rendering, and let go of its devices."""
        with self._turn:
            self._close()

    def _close(self) -> None:
        if self._session is not None:
            self._session.close()


def age_s(desk: RenderingDesk, now_s: float | None = None) -> float:
    """Age of what the page shows of a rendering; 0 where none runs [s]."""
    told = desk.told_s
    return 0.0 if told is None else max((time.monotonic() if now_s is None else now_s) - told, 0.0)
