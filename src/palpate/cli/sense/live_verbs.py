"""The verb that reads sensors live.

What `palpate live` writes: a run of each sensor and a log of readings; none stays that holds no frame.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, runtime_checkable

from typer import Argument, Exit, Option

from palpate.cli.verb_support import (
    as_json,
    is_quiet,
    numbers_of,
    reading_words,
    say,
    signals_held,
    stopped_by_signals,
)
from palpate.devices.long_running import loaded_kept

if TYPE_CHECKING:
    from palpate.recordings.exchange.reading_log import ReadingLog
    from palpate.sensing.live_loop import LiveReading
    from palpate.sensing.sensing_loop import Live
    from palpate.sensing.streaming.live_image import ImageWatch
    from palpate.sensing.streaming.live_recorder import LiveRecorder
    from palpate.sensors.owned import SensorPreset

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


TAKE_S = 0.02  # for a reading of one of several sensors
SHOWN_S = 0.1  # between two drawings
PLAIN_S = 1.0  # between two lines where no line can be redrawn
NOTHING_RECORDED = "; nothing recorded, since no frame was kept"


def live(
    calibrations: Annotated[
        list[Path] | None,
        Argument(
            metavar="[CAL]...",
            help="Calibration folder, or a session's, whose newest is taken: none, one for all cameras, or "
            "one for each.",
        ),
    ] = None,
    camera: Annotated[
        list[str] | None,
        Option(
            help="Number, path or USB serial number of a camera, a video, folder or run, - for images on "
            "stdin, or virtual:NAME; may be given again. Default 0."
        ),
    ] = None,
    reference: Annotated[Path | None, Option(help="Image of the untouched sensor.")] = None,
    zero: Annotated[
        bool | None,
        Option(
            "--zero/--no-zero",
            help="Take the first frames as those of the untouched sensor; by default of cameras alone.",
        ),
    ] = None,
    shear: Annotated[
        str,
        Option(
            help="Sensor or file of a patterned skin, as nusense:7: reads touch; newtons by a CAL of force."
        ),
    ] = "",
    compliance: Annotated[
        Path | None,
        Option(help="Calibration (.npz) of a tip with a force sensor beside: stiffness of each press."),
    ] = None,
    preset: Annotated[
        str, Option(help="Preset of the sensor, or its TOML file, where there is no CAL; else by its camera.")
    ] = "",
    seconds: Annotated[float | None, Option(help="End after so long [s]; by default by Ctrl-C.")] = None,
    frames: Annotated[int | None, Option(help="End after so many frames of each camera.")] = None,
    record: Annotated[
        Path | None,
        Option(help="Run to record into; must not exist. Of several cameras RUN-1, RUN-2 and so on."),
    ] = None,
    mcap: Annotated[Path | None, Option(help="MCAP file to write readings to; must not exist.")] = None,
    paced: Annotated[
        bool, Option("--paced", help="Play a file at its own rate, and lose what is not read in time.")
    ] = False,
    wait: Annotated[
        float, Option(help="A folder or run that is written has ended after so long without news [s].")
    ] = 2.0,
    size: Annotated[str | None, Option(help="WIDTHxHEIGHT of a USB camera [px]; default 640x480.")] = None,
    fps: Annotated[float | None, Option(help="Frames a second of a USB camera [Hz]; default 30.")] = None,
    exposure_ms: Annotated[float | None, Option(help="Exposure of a USB camera [ms]; default 10.")] = None,
) -> None:
    """Read a sensor live: value, interval and verdict.

    Without a calibration it shows rate, noise, focus and the difference to the untouched sensor. With --json,
    one object a line, at times with shapes to draw over the picture in "overlay". Ctrl-C ends it; what is
    recorded is whole then. A run that its writer did not close is read, named, and ends with status 1.

    Example: palpate live cal --camera 4B2D --record run
    Example: palpate live --camera virtual:palm --seconds 5
    Example: palpate live cal --camera taps.avi --json
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is there: more would spin, and slow a frame
    _check_above_0(
        ("--seconds", seconds, " [s]"),
        ("--frames", frames, ""),
        ("--wait", wait, " [s]"),
        ("--fps", fps, " [Hz]"),
        ("--exposure-ms", exposure_ms, " [ms]"),
    )
    settings = _settings(size, fps, exposure_ms)
    options = {"settings": settings, "paced": paced, "idle_s": wait, "threads": 1}
    options |= {"shear": shear, "max_frames": frames}
    known = _preset(preset)
    addresses = camera or ["0"]
    folders = _each(calibrations or [], len(addresses))
    outputs = LiveOutputs(record, mcap, len(addresses))
    sensors: list[ShownSensor] = []
    with outputs.told_if_cut_short(sensors):
        with stopped_by_signals(), ExitStack() as stack:
            for address, folder in zip(addresses, folders, strict=True):
                one = stack.enter_context(_sensor(address, folder, reference, zero, options, known))
                sensors.append(one)
                if compliance is not None:
                    stack.enter_context(_presses(one, compliance))
            shown = stack.enter_context(_shown())
            with suppress(KeyboardInterrupt):
                with signals_held():
                    stack.enter_context(outputs.made(sensors))
                for sensor, reading in _readings(sensors, seconds):
                    if sensor.takes(reading):
                        outputs.log(reading)
                    shown(sensor, reading)
                    sensor.broken = reading.why or sensor.broken
                    sensor.refuse_size(reading)
            for sensor in sensors:
                sensor.close()
        for sensor in sensors:
            say(sensor.summary(), err=True)
        for sensor in sensors:
            sensor.refuse_all_sizes()
        cut = {sensor.live.loop.name: why for sensor in sensors if (why := sensor.cut_short())}
        for name, why in cut.items():
            say(why, err=True)
            if as_json():
                say(json.dumps({"source": name, "state": "ended", "why": why}))
        if all(sensor.is_over_and_empty() for sensor in sensors):
            from palpate.core.errors import InputError

            names = [sensor.live.loop.name for sensor in sensors]
            broken = next((sensor.broken for sensor in sensors if sensor.broken), "")
            what = f" that is an image: {broken}" if broken else f"; nothing was read{_put_there(names)}"
            raise InputError(f"{', '.join(names)} ended without a frame{what}")
        if cut:
            raise Exit(1)


class ShownSensor:
    """One sensor of the verb, and what of it is shown."""

    def __init__(self, live: Live, watch: ImageWatch | None) -> None:
        self.live, self.watch = live, watch
        self.recorder: LiveRecorder | None = None
        self.broken = ""  # why the last frame that was no image could not be read
        self._lost = False
        self._looks = 0
        self._fitting, self._other_size = 0, ""

    def record(self, run: Path) -> None:
        """Record into a new run from its first frame on; frames by which it is refused are not kept."""
        from palpate.sensing.streaming.live_recorder import LiveRecorder

        source = self.live.loop.source
        assert source is not None
        only_px = None if self._may_change else self.live.loop.frame_px
        self.recorder = LiveRecorder(run, source, only_px=only_px)
        self.live.loop.subscribe(self.recorder)

    def close(self) -> None:
        """End it, and close what was recorded; a run that holds no frame is removed."""
        try:
            self.live.close()
        finally:
            if self.recorder is not None:
                self.recorder.close_or_discard()

    def takes(self, reading: LiveReading) -> bool:
        """Whether the reading does not end it by its frame's size."""
        return self._may_change or self._fits(reading)

    def tell_state(self) -> None:
        """Say on stderr that the camera was lost, or came back."""
        loop = self.live.loop
        lost = loop.state.value == "lost"
        if lost != self._lost:
            self._lost = lost
            said = f"lost: {loop.why}; it is opened again when it comes back" if lost else "is back"
            say(f"{loop.name} {said}", err=True)

    def line(self, reading: LiveReading) -> str:
        """The newest reading in one line."""
        stats = reading.stats
        rate = "" if stats.rate_hz is None else f"{stats.rate_hz:.1f} Hz"
        latency = f"{1e3 * reading.latency_s:.1f} ms"
        parts = [reading.source, rate, latency, f"{stats.dropped} dropped"]
        if stats.lost:
            parts.append(f"{stats.lost} lost")
        if reading.force_n is not None:
            parts.append(f"beside it {reading.force_n:.2f} N")
        if reading.readings is None:
            parts.append(reading.why or self._picture())
        else:
            parts += reading_words(reading.readings)
        if self.live.loop.zeroing:  # what else is advised may come of that alone
            parts.append("taking the untouched sensor: let nothing touch it")
        elif self.live.advice:
            parts.append(self.live.advice)
        return " | ".join(part for part in parts if part)

    def summary(self) -> str:
        """What there was, in one line."""
        loop = self.live.loop
        s = loop.stats
        counts = f"{s.frames} frames, {s.dropped} dropped, {s.lost} lost"
        counts += f", {s.broken} broken" if s.broken else ""
        times = ""
        if s.p50_ms is not None:
            rate = "" if s.rate_hz is None else f"{s.rate_hz:.1f} Hz, "
            times = f"; {rate}{s.p50_ms:.1f} / {s.p95_ms:.1f} / {s.p99_ms:.1f} ms (p50/p95/p99)"
        kept = ""
        if self.recorder is not None:
            unkept = f" ({self.recorder.dropped} frames left out)" if self.recorder.dropped else ""
            kept = f"; recorded in {self.recorder.path}{unkept}" if self.recorder.kept else NOTHING_RECORDED
        faults = "".join(f"; {fault}" for fault in loop.faults)
        return f"{loop.name}: {counts}{times}{kept}{faults}"

    def refuse_size(self, reading: LiveReading) -> None:
        """End where a camera, or a file that does not change, gives frames of another size than the CAL's."""
        loop, (height, width) = self.live.loop, reading.image.shape[:2]
        wanted = loop.frame_px
        if wanted is None or self._fits(reading):  # of any size, or of the calibration's
            self._fitting += not reading.why
            return
        right, of = f"{wanted[1]}x{wanted[0]}", f" of {loop.sensor}" if loop.sensor else ""
        self._other_size = (
            f"{loop.name} gives frames of {width}x{height} px and the calibration{of} reads {right} px: give "
            f"one of this sensor, film at that size (--size {right} of a USB camera) or calibrate at this one"
        )
        if not self._may_change:
            self.refuse_all_sizes()

    def refuse_all_sizes(self) -> None:
        """End by an error where no frame had the calibration's size."""
        if self._other_size and not self._fitting:
            from palpate.core.errors import InputError

            raise InputError(self._other_size)

    def cut_short(self) -> str:
        """Why its source ended before it was whole, as a run whose writer was killed; empty else."""
        loop = self.live.loop
        return loop.why if loop.state.value == "ended" else ""

    def is_over_and_empty(self) -> bool:
        """Whether its source has ended by itself, and gave no frame that could be read as an image."""
        stats = self.live.stats
        return self.live.loop.state.value == "ended" and stats.frames == stats.broken

    def to_dict(self, reading: LiveReading) -> dict[str, Any]:
        """One object for a line of JSON."""
        told = {**reading.to_dict(), "advice": self.live.advice, "image": None}
        if (watch := self.watch) is not None:
            told["image"] = watch.status()
            if watch.looks != self._looks and watch.overlay is not None:
                told["overlay"] = watch.overlay
            self._looks = watch.looks
        return told

    @property
    def _may_change(self) -> bool:
        return bool(getattr(self.live.loop.source, "may_change", False))

    def _fits(self, reading: LiveReading) -> bool:
        wanted = self.live.loop.frame_px
        return wanted is None or bool(reading.why) or reading.image.shape[:2] == wanted

    def _picture(self) -> str:
        seen = (None if self.watch is None else self.watch.status()) or {}
        parts = [f"level {seen['level']:.0f}"] if "level" in seen else []
        if seen.get("noise") is not None:
            parts.append(f"noise {seen['noise']:.1f}")
        if seen.get("blur_px") is not None:
            parts.append(f"blur {seen['blur_px']:.1f} px")
        if seen.get("verdict"):
            place = seen.get("centre_px")
            parts.append(
                f"{seen['verdict']}" + (f" at x {place[0]:.0f}, y {place[1]:.0f} px" if place else "")
            )
        return ", ".join(parts)


def _put_there(names: list[str]) -> str:
    """What to do about a folder in which nothing lay; empty where there is none."""
    folder = next((name for name in names if Path(name).is_dir()), None)
    if folder is None:
        return ""
    from palpate.recordings.exchange.image_files import IMAGE_SUFFIXES

    kinds = ", ".join(sorted(IMAGE_SUFFIXES))
    return f": put images ({kinds}) into {folder}, or name a folder of images or a run"


def _settings(size: str | None, fps: float | None, exposure_ms: float | None) -> Any:
    if size is None and fps is None and exposure_ms is None:
        return None
    from palpate.rig.real.uvc_camera import UvcSettings

    usual = UvcSettings()
    return UvcSettings(
        size_px=numbers_of(size, 2, "--size") or usual.size_px,  # type: ignore[arg-type]
        rate_hz=usual.rate_hz if fps is None else fps,
        exposure_s=usual.exposure_s if exposure_ms is None else 1e-3 * exposure_ms,
    )


def _check_above_0(*options: tuple[str, float | None, str]) -> None:
    """Refuse an end that has passed, or never comes, and a rate that is none; nan is not above 0 either."""
    from palpate.core.errors import InputError

    for name, value, unit in options:
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"{name} {value:g}; it has to be above 0{unit} and finite, or is left out")


def _each(folders: list[Path], count: int) -> list[Path | None]:
    from palpate.core.errors import InputError

    if len(folders) not in (0, 1, count):
        raise InputError(
            f"{len(folders)} calibrations and {count} cameras; give none, one for all, or one for each in "
            "their order"
        )
    return [*(folders if len(folders) == count else folders * count)] if folders else [None] * count


def _preset(name: str) -> SensorPreset | None:
    if not name:
        return None
    from palpate.sensors.owned import read_preset

    return read_preset(name)


@contextmanager
def _sensor(
    address: str,
    folder: Path | None,
    reference: Path | None,
    zero: bool | None,
    options: dict[str, Any],
    preset: SensorPreset | None,
) -> Iterator[ShownSensor]:
    from palpate.sensing.sensing_loop import live
    from palpate.sensing.streaming.live_image import ImageWatch
    from palpate.sensing.streaming.source_views import preset_of_camera

    opened = live(folder, camera=address, zero=reference if zero is None else zero, **options)
    shown = None
    try:
        if doubt := opened.loop.doubt:
            say(doubt, err=True)
        watch = None if folder else ImageWatch(opened.loop, preset or preset_of_camera(address))
        if watch is not None:
            opened.loop.subscribe(watch)
        shown = ShownSensor(opened, watch)
        yield shown
    finally:
        (opened if shown is None else shown).close()


@contextmanager
def _presses(sensor: ShownSensor, calibration: Path) -> Iterator[None]:
    """Tell the stiffness of each press as it ends."""
    from palpate.calibration.compliance.compliance_calibration import ComplianceCalibration
    from palpate.calibration.compliance.press_cues import UNITS
    from palpate.core.errors import InputError
    from palpate.sensing.streaming.live_presses import LivePress, PressReader, compliance_of

    source = sensor.live.loop.source
    if source is None or source.force is None:
        raise InputError(
            "stiffness of a press needs a force sensor beside the camera, as a virtual sensor has; read "
            "recorded presses by palpate compliance"
        )

    def told(press: LivePress) -> None:
        words = [str(one.in_unit(UNITS[one.quantity])) for one in press.readings] or [press.why]
        say(json.dumps(press.to_dict()) if as_json() else f"press {press.number}: {'; '.join(words)}")

    with PressReader(compliance_of(ComplianceCalibration.load(calibration)), told) as presses:
        sensor.live.loop.subscribe(presses)
        yield
        sensor.live.loop.unsubscribe(presses)


def _readings(sensors: list[ShownSensor], seconds: float | None) -> Iterator[tuple[ShownSensor, LiveReading]]:
    """Readings of all sensors as they come, until all have ended, or it has been long enough."""
    end_s = float("inf") if seconds is None else time.monotonic() + seconds
    going = list(sensors)
    with loaded_kept():
        for sensor in sensors:
            sensor.live.start()
        while going and time.monotonic() < end_s:
            for sensor in list(going):
                reading = sensor.live.take(TAKE_S)
                sensor.tell_state()
                if reading is not None:
                    yield sensor, reading
                if sensor.live.over:
                    going.remove(sensor)
                    sensor.live.refuse_failed()


@contextmanager
def _shown() -> Iterator[Any]:
    """Show readings: as JSON, as lines that are redrawn, or as lines once a second."""
    from rich.console import Console
    from rich.live import Live as Redrawn
    from rich.text import Text

    console = Console(stderr=True)
    if as_json():
        yield lambda sensor, reading: say(json.dumps(sensor.to_dict(reading), allow_nan=False))
        return
    if is_quiet():
        yield lambda sensor, reading: None
        return
    lines: dict[str, str] = {}
    drawn_s: dict[str, float] = {}
    if not console.is_terminal:

        def print_line(sensor: ShownSensor, reading: LiveReading) -> None:
            if time.monotonic() - drawn_s.get(reading.source, float("-inf")) >= PLAIN_S:
                drawn_s[reading.source] = time.monotonic()
                say(sensor.line(reading))

        yield print_line
        return
    with Redrawn(console=console, auto_refresh=False, transient=False) as screen:

        def redraw(sensor: ShownSensor, reading: LiveReading) -> None:
            lines[reading.source] = sensor.line(reading)
            if time.monotonic() - drawn_s.get("", float("-inf")) >= SHOWN_S:
                drawn_s[""] = time.monotonic()
                screen.update(Text("\n".join(lines.values()), overflow="fold"), refresh=True)

        yield redraw
