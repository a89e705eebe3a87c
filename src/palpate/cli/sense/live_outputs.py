"""What `palpate live` writes: a run of each sensor and a log of readings; none stays that holds no frame."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from typer import Exit

from palpate.cli.verb_support import say

if TYPE_CHECKING:
    from palpate.core import MeasurementResult, Readings
    from palpate.recordings.exchange.reading_log import ReadingLog
    from palpate.sensing.live_loop import LiveReading
    from palpate.sensing.streaming.live_recorder import LiveRecorder

INTERRUPTED = 130  # as a shell tells of a program that Ctrl-C has ended


@runtime_checkable
class RecordedSensor(Protocol):
    """A sensor whose frames may be recorded."""

    recorder: LiveRecorder | None

    def record(self, run: Path) -> None:
        """Record into a new run from its first frame on."""


class LiveOutputs:
    """Files of one live reading, made once nothing is left that could be refused.

    Args:
        run: to record into; of several sensors RUN-1, RUN-2 and so on. None records none.
        log: MCAP file of readings; None for none.
        sensors: how many there are.
    """

    def __init__(self, run: Path | None, log: Path | None, sensors: int) -> None:
        numbered = [Path(f"{run}-{i + 1}") for i in range(sensors)] if sensors > 1 else [run]
        self._runs = [] if run is None else [path for path in numbered if path is not None]
        self._log_path = log
        self._log: ReadingLog | None = None
        self._readings = 0  # in the log, of frames that are images
        if paths := [*self._runs, *([] if log is None else [log])]:
            from palpate.core.files import refuse_existing

            for path in paths:
                refuse_existing(path)

    @contextmanager
    def made(self, sensors: Sequence[RecordedSensor]) -> Iterator[None]:
        """Make them, and close the log at the end; the runs are closed by their sensors."""
        try:
            if self._log_path is not None:
                from palpate.recordings.exchange.reading_log import ReadingLog

                self._log = ReadingLog(self._log_path)
            for sensor, run in zip(sensors, self._runs, strict=False):
                sensor.record(run)
            yield
            if self._log is not None and not self._readings:
                say(f"{self._log_path} is not kept, since no frame was read", err=True)
        finally:
            if self._log is not None:
                (self._log.close if self._readings else self._log.discard)()

    def log(self, reading: LiveReading) -> None:
        """Keep a reading in the log, where there is one."""
        if self._log is not None:
            self._readings += not reading.why  # first: what may hold one is never removed
            self._log.write(reading.source, reading.to_dict())

    @contextmanager
    def told_if_cut_short(self, sensors: Sequence[RecordedSensor]) -> Iterator[None]:
        """Where an error or Ctrl-C ends the block, say what was kept, as the same command is refused then."""
        try:
            yield
        except KeyboardInterrupt as e:
            if not (kept := self._kept(sensors)):
                raise
            say(f"palpate: stopped; {kept}", err=True)
            raise Exit(INTERRUPTED) from e
        except Exception as e:
            from palpate.core.errors import PalpateError

            if isinstance(e, PalpateError) and (kept := self._kept(sensors)):
                say(kept, err=True)
            raise

    def _kept(self, sensors: Sequence[RecordedSensor]) -> str:
        runs = [sensor.recorder for sensor in sensors if sensor.recorder is not None]
        parts = [f"{run.path} ({_counted(run.kept, 'frame')})" for run in runs if run.path.exists()]
        if self._readings:
            parts.append(f"{self._log_path} ({_counted(self._readings, 'reading')})")
        return f"kept: {', '.join(parts)}; the next one needs other names" if parts else ""


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


BENCH_UNITS = {"m": "mm", "rad": "deg"}  # other units stay as the calibration has them


def reading_words(readings: Readings) -> list[str]:
    """Parts of a line: readings that have a value, and then those that have none, each reason once.

    Example:
        "x -11.541 mm ± 0.013 mm, inside the calibrated range", "y, rotation –: no contact"
    """
    told: list[str] = []
    without: dict[str, list[str]] = {}
    for one in readings.values():
        if _has_value(one):
            told.append(_in_bench_units(one))
        else:
            without.setdefault(one.verdict, []).append(one.quantity)
    return told + [f"{', '.join(names)} –: {why}" for why, names in without.items()]


def _has_value(reading: MeasurementResult) -> bool:
    value = getattr(reading, "value", "")
    return not math.isnan(value) if isinstance(value, float) else not isinstance(value, str) or bool(value)


def _in_bench_units(reading: MeasurementResult) -> str:
    shown = reading.in_unit(BENCH_UNITS[reading.unit]) if reading.unit in BENCH_UNITS else reading
    return str(shown).replace(" ratio", "")
