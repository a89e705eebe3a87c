"""A subscriber that records live frames and forces into an ordinary run."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from palpate.core import NS_PER_S, Clock, Closing, Frame, MonotonicClock, Readings, Wrench
from palpate.core.provenance import Provenance
from palpate.recordings.manifest import MANIFEST, Manifest
from palpate.recordings.run_writer import Overflow, RunWriter
from palpate.recordings.segments import KINDS, file_name
from palpate.sensing.live_sources import LiveSource

NAME = "image_file"  # the label that names a frame


class LiveRecorder(Closing):
    """Recorder of one source; its times count from the first frame, by the source's clock.

    Undecodable frames are left out and named by an event. Force is recorded raw.

    Args:
        path: New folder.
        sensor: Sensor name for the manifest; the source's name by default.
        only_px: Height and width of the recorded frames; None for any [px].
    """

    def __init__(
        self,
        path: Path,
        source: LiveSource,
        sensor: str = "",
        clock: Clock | None = None,
        only_px: tuple[int, int] | None = None,
    ) -> None:
        self._clock = clock or MonotonicClock()
        virtual = source.name.startswith("virtual:")
        manifest = Manifest.new(
            sensor=sensor or source.name.replace("virtual:", "virtual "),
            rig="palpate live",
            labels={NAME: "text"} if source.waits else {},
            origin="a virtual sensor" if virtual else "recorded live by palpate",
            provenance=Provenance.SIMULATED if virtual else Provenance.MEASURED,
        )
        overflow: Overflow = "wait" if source.waits else "drop"
        self._writer = RunWriter.create(path, manifest, clock=self._clock, overflow=overflow)
        self._begin_ns = self._clock.now_ns()
        self._named = source.waits
        self._first_ns: int | None = None
        self._latest_ns = self._latest_force_ns = 0
        self._only_px, self._closed = only_px, False
        self.path = path

    @property
    def kept(self) -> int:
        """Count of frames that were written."""
        return self._writer.stored

    @property
    def dropped(self) -> int:
        """Count of frames for which the disk was too slow."""
        return self._writer.dropped["frames"]

    def on_frame(self, frame: Frame, readings: Readings | None) -> None:
        """Record a frame."""
        if frame.fault:
            self._writer.event("unreadable", frame=frame.name, why=frame.fault)
            return
        if self._only_px not in (None, frame.image.shape[:2]):
            return
        own_ns = round(frame.time_s * NS_PER_S)
        if self._first_ns is None:
            self._first_ns = own_ns
            self._writer.event("live", first_frame_ns=own_ns, arrived_ns=frame.arrived_ns)
        at_ns = max(self._on_writers_clock(own_ns), self._latest_ns)
        self._latest_ns = at_ns
        labels = {NAME: frame.name} if self._named and frame.name else None
        self._writer.frame(frame.image, time_ns=at_ns, exposure_s=frame.exposure_s, labels=labels)

    def on_force(self, samples: Sequence[Wrench]) -> None:
        """Record samples since the first frame."""
        for one in samples if self._first_ns is not None else ():
            at_ns = self._on_writers_clock(one.time_ns)
            if at_ns >= max(self._begin_ns, self._latest_force_ns) and not one.fault:
                self._latest_force_ns = at_ns
                self._writer.force((*one.force_n, *one.torque_nm), time_ns=at_ns, raw=True)

    def close(self) -> None:
        """Write what waits, and close the run. Closing again does nothing."""
        self._closed = True
        self._writer.close()

    def close_or_discard(self) -> None:
        """Write what waits, and close the run; one that holds no frame is removed. Again does nothing.

        A run to which anything was added stays.
        """
        if self._closed:
            return
        self.close()
        made = {MANIFEST, *(file_name(0, kind) for kind in KINDS)}
        with suppress(OSError):
            if not self._writer.stored and {one.name for one in self.path.iterdir()} <= made:
                for name in made:
                    (self.path / name).unlink(missing_ok=True)
                self.path.rmdir()

    def _on_writers_clock(self, own_ns: int) -> int:
        assert self._first_ns is not None
        return self._begin_ns + own_ns - self._first_ns
