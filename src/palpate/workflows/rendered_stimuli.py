"""Stimuli of an experiment shown on a softness display, under codes, so that nothing says which is which."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

from palpate.core import Closing, DeviceError, InputError, PalpateError
from palpate.psychophysics import Condition, Presentation
from palpate.psychophysics.experiments import ExperimentDesign
from palpate.softness import Mode, SoftObject, read_object
from palpate.softness.process import BenchFile, RenderingSession

MODES = {
    Condition.INTEGRATED: Mode.BOTH,
    Condition.KINESTHETIC: Mode.KINESTHETIC,
    Condition.CUTANEOUS: Mode.CUTANEOUS,
}
PEAK_N = 1.0  # of a virtual bench's finger, or half of what the object is known to
BEGUN_S = 5.0
LOOK_S = 0.02


class RenderedStimuli(Closing):
    """Display that shows one stimulus after the other; see `StimulusPresenter`.

    All objects are read before anything is shown. A rendering that has ended is restarted by the next `show`.

    Args:
        bench: display and arm; see `read_bench`.
    """

    def __init__(self, design: ExperimentDesign, bench: BenchFile) -> None:
        self._bench = bench
        self._objects: Mapping[tuple[Condition, str], SoftObject] = {
            (part.condition, name): read_object(design.folder / path)
            for part in design.file.stimuli
            if part.presentation is Presentation.RENDERED
            for name, path in zip(part.names, part.objects, strict=True)
        }
        self._session: RenderingSession | None = None
        self._mode: Mode | None = None

    @property
    def simulated(self) -> bool:
        """Whether the bench is virtual, so that no finger can feel anything."""
        return self._bench.simulated

    def prepare(self, condition: Condition) -> str:
        """What the experimenter has to do before a condition; what was shown ends."""
        self.close()
        if self.simulated:
            return "Virtual bench: a simulated finger presses a simulated display; nothing of it is touch."
        if MODES[condition] is Mode.KINESTHETIC:
            return "Put the rigid plate in the display's place (CM2). No finger there meanwhile."
        return "Put the softness display on the arm. No finger there meanwhile."

    def show(self, condition: Condition, name: str, code: str) -> None:
        if (condition, name) not in self._objects:
            raise InputError(
                f"nothing is rendered as {code} in condition {condition.value}", code="stimulus-not-rendered"
            )
        soft = replace(self._objects[condition, name], name=code, source="")
        if self._session is not None and (
            self._mode is not MODES[condition] or self._session.status().state == "ended"
        ):
            self.close()
        try:
            if self._session is None:
                self._begin(soft, MODES[condition])
            else:
                self._session.show(soft)
        except PalpateError:
            self.close()
            raise

    def check(self) -> None:
        """Raise `DeviceError` if the rendering has ended."""
        if self._session is None:
            raise DeviceError("nothing is rendered", code="nothing-rendered")
        status = self._session.status()
        if status.state == "ended":
            self.close()
            raise DeviceError(f"the rendering has ended: {status.why}", code="rendering-ended")

    def close(self) -> None:
        """End what is shown; the chamber vents and the arm brakes."""
        session, self._session = self._session, None
        if session is not None:
            with suppress(DeviceError):  # a process that is gone already; its devices' watchdogs have acted
                session.close()

    def _begin(self, soft: SoftObject, mode: Mode) -> None:
        peak_n = min(PEAK_N, soft.greatest_n / 2)
        self._session, self._mode = RenderingSession(self._bench, soft, mode, peak_n), mode
        end_s = time.monotonic() + BEGUN_S
        while self._session.status().state == "opens" and time.monotonic() < end_s:
            time.sleep(LOOK_S)
        self.check()
