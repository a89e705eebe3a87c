"""The process of one live sensor: ``python -m palpate.sensing.live_service --name NAME --options JSON``.

It goes on whoever watches it comes or goes, and whatever becomes of the page's server. It records when asked
to; what it recorded is whole when it ends.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from types import FrameType
from typing import Any

import cv2

from palpate.calibration.compliance.compliance_calibration import ComplianceCalibration
from palpate.core import (
    Frame,
    InputError,
    MonotonicClock,
    PalpateError,
    Readings,
    SafetyError,
    Wrench,
    plain_name,
)
from palpate.core.failure_log import Failure, contained, report_to_stderr, thread_failures
from palpate.core.provenance import Provenance
from palpate.devices.device_status import Log, jpeg_of
from palpate.devices.long_running import give_back_memory, keep_loaded
from palpate.devices.rpc import Address, hold, publish
from palpate.devices.rpc_server import Request, RpcServer, request_field
from palpate.recordings.exchange.image_files import read_image
from palpate.sensing.live_loop import LiveLoop, LiveState
from palpate.sensing.live_sources import (
    VIRTUAL,
    HandFrames,
    LiveSource,
    is_simulated,
    open_live_source,
)
from palpate.sensing.streaming.live_image import ImageWatch
from palpate.sensing.streaming.live_presses import PressReader, compliance_of
from palpate.sensing.streaming.live_readers import CalibrationReader, FrameReader, open_reader
from palpate.sensing.streaming.live_recorder import LiveRecorder
from palpate.sensing.streaming.source_views import preset_of_camera, strain_view
from palpate.sensing.streaming.touch_readers import ShearFrameReader, open_shear_reader
from palpate.sensors.owned import read_preset

LOOK_S = 0.2
FREE_EVERY_S = 60.0  # between two times that memory no longer used is given back
SETTLED_S = 5.0  # after the first frame, by which all that reads one is loaded
TAIL = 60  # lines of the log that are told
TOLD_PRESSES = 5  # whose softness is told
PICTURE_S = 0.08  # between two pictures: a page shows no more than a dozen a second
SWITCH_S = 0.001  # between threads, so that a frame does not wait for what others compute


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Options of a live sensor process.

    Attributes:
        camera: Address as of `open_live_source`.
        runs: Folder of recordings; "" to forbid them.
        reference: No-contact image file; "" for none.
        shear: Patterned skin as of `live`.
        compliance: Calibration of a tip (.npz), for the softness of each press; "" for none.
        preset: Preset of the sensor or its TOML file; "" for that of its camera.
        zero: Take the first frames as no-contact frames; None does so for cameras only.
        size_px, rate_hz, exposure_s, white_balance_k: Settings of a USB camera; None for the defaults.
        paced, repeat, idle_s, seed: As of `open_live_source`.
        threads: Threads of the inference engine; 0 lets it choose.
    """

    camera: str = "0"
    calibration: str = ""
    runs: str = ""
    reference: str = ""
    shear: str = ""
    compliance: str = ""
    preset: str = ""
    zero: bool | None = None
    size_px: tuple[int, int] | None = None
    rate_hz: float | None = None
    exposure_s: float | None = None
    white_balance_k: int | None = None
    paced: bool = False
    repeat: bool = False
    idle_s: float = 2.0
    seed: int | None = None
    threads: int = 1

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> LiveOptions:
        """Options from plain values."""
        known = {field.name for field in fields(cls)}
        if unknown := set(values) - known:
            raise InputError(f"no option of a live sensor: {sorted(unknown)}; there are {sorted(known)}")
        size = values.get("size_px")
        return cls(**{**values, "size_px": None if size is None else (int(size[0]), int(size[1]))})

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    def open(self) -> LiveSource:
        """Open the source."""
        return open_live_source(
            int(self.camera) if self.camera.isdecimal() and len(self.camera) < 3 else self.camera,
            settings=self._settings(),
            paced=self.paced,
            repeat=self.repeat,
            idle_s=self.idle_s,
            seed=self.seed,
        )

    def _settings(self) -> Any:
        given = {
            name: value
            for name in ("size_px", "rate_hz", "exposure_s", "white_balance_k")
            if (value := getattr(self, name)) is not None
        }
        if not given:
            return None
        from palpate.rig.real.uvc_camera import UvcSettings

        return replace(UvcSettings(), **given)


class LiveService:
    """Service of one live sensor, for calls from any thread."""

    def __init__(self, name: str, options: LiveOptions) -> None:
        self.name, self.options = name, options
        self._log = Log()
        self._asking = threading.RLock()  # calibration, record, collect: one after the other
        self._reader: FrameReader | None = None
        self._presses: PressReader | None = None
        self._strain: tuple[object, dict[str, Any]] | None = None
        self._recorder: LiveRecorder | None = None
        self._collector: Any = None
        if options.calibration or options.shear:
            self._reader = self._opened_reader(options.calibration)
        self.loop = LiveLoop(self._opened_source, self._reader)
        self._watch = ImageWatch(self.loop, read_preset(options.preset) if options.preset else None)
        self.loop.subscribe(self._watch)
        self._compliance = ""
        if options.compliance:
            tip = ComplianceCalibration.load(Path(options.compliance))
            self._compliance, self._presses = tip.id, PressReader(compliance_of(tip))
            self.loop.subscribe(self._presses)
        self._pictured_s = 0.0
        self._told: LiveState | None = None

    def start(self) -> None:
        """Begin to read."""
        self.loop.start()

    def report(self, failure: Failure) -> None:
        """Show a failure of a thread in the log that pages show."""
        report_to_stderr(failure)
        self._log.add("fault", failure.text)

    def zero(self) -> None:
        """Take the next frames, on which nothing may press, as those of the untouched sensor."""
        self._log.add("operator", "zero")
        self.loop.zero()
        if self._collector is not None:
            self._collector.rezero()

    def use(self, calibration: str) -> dict[str, Any]:
        """Read by another calibration from now on; "" by none."""
        with self._asking:
            reader, source = self._opened_reader(calibration) if calibration else None, self.loop.source
            if source is not None:
                self._attach(source, reader)
            self._reader = reader
            self.loop.use(reader)
            self._log.add("operator", f"calibration {calibration or 'none'}")
            return {"calibration": None if self._reader is None else self._reader.id}

    def record(self, run: str) -> dict[str, Any]:
        """Record frames and forces into a new run of this name."""
        with self._asking:
            self._check_free()
            path, source = self._path(run), self._source()
            self._recorder = LiveRecorder(path, source)
            self.loop.subscribe(self._recorder)
            self._log.add("operator", f"record {run}")
            return {"run": str(path)}

    def record_stop(self) -> dict[str, Any]:
        """End the recording; the run is whole when this returns."""
        with self._asking:
            recorder, self._recorder = self._recorder, None
            if recorder is None:
                raise SafetyError("nothing is being recorded", code="no-recording")
            self.loop.unsubscribe(recorder)
            recorder.close()
            self._log.add("operator", "recording ended")
            return {"run": str(recorder.path), "dropped": recorder.dropped}

    def collect(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Collect labeled presses into a new or existing run.

        Args:
            request: "run" and optionally "scale" ("beside" for the force sensor next to the camera, "typed"
                for typed weights, or a serial port), "unit" (for a scale whose lines carry none), "asked",
                "session", "region", "force_range_n".
        """
        with self._asking:
            self._check_free()
            collector = self._opened_collector(request)
            self._collector = collector
            self.loop.subscribe(collector)
            self._log.add("operator", f"collect presses into {collector.run.name}")
            return {"run": str(collector.run)}

    def collect_stop(self) -> dict[str, Any]:
        """End the collection; the run is whole when this returns."""
        with self._asking:
            collector, self._collector = self._collector, None
            if collector is None:
                raise SafetyError("no presses are being collected")
            self.loop.unsubscribe(collector)
            collector.close()
            self._log.add("operator", "collection ended")
            status: dict[str, Any] = collector.status
            return status

    def label(self, force_n: float) -> dict[str, Any]:
        """State the weight that lies on the sensor now [N]."""
        if self._collector is None:
            raise SafetyError("no presses are being collected; start that first")
        self._collector.label(float(force_n))
        return {"force_N": float(force_n)}

    def status(self) -> dict[str, Any]:
        """Status for a page, but for the picture; plain values."""
        found = self.loop.status()
        if self.loop.state is not self._told:
            self._told = self.loop.state
            why = f": {found['why']}" if found["why"] else ""
            failed = self._told in (LiveState.LOST, LiveState.FAILED)
            self._log.add("fault" if failed else "rig", f"{self._told.value}{why}")
        recorder, collector = self._recorder, self._collector
        return {
            **found,
            "name": self.name,
            "camera": self.options.camera,
            "simulated": self._simulated,
            "image": self._image_status(),
            "strain": self._strain_status(),
            "compliance": self._press_status(),
            "record": None if recorder is None else {"run": str(recorder.path), "dropped": recorder.dropped},
            "collect": None if collector is None else collector.status,
            "log": self._log.tail(TAIL),
        }

    @property
    def _simulated(self) -> bool:
        source = self.loop.source
        return self.options.camera.startswith(VIRTUAL) if source is None else is_simulated(source)

    def picture(self, after: int = -1) -> dict[str, Any] | None:
        """The newest frame as a JPEG, numbered; None where none is newer than `after`, or none is due."""
        latest = self.loop.latest
        if latest is None or latest.number == after or latest.why:
            return None
        if after >= 0 and time.monotonic() - self._pictured_s < PICTURE_S:
            return None
        self._pictured_s = time.monotonic()
        return {"number": latest.number, **jpeg_of(latest.image)}

    def close(self) -> None:
        """End: what is recorded and collected is closed whole, then the camera is let go of."""
        self.loop.close()
        with self._asking:
            for kept in (self._recorder, self._collector):
                if kept is not None:
                    kept.close()
            self._recorder = self._collector = None
            if self._presses is not None:
                self._presses.close()

    def _image_status(self) -> dict[str, Any] | None:
        found, overlay = self._watch.status(), self._watch.overlay
        if found is None or overlay is None or self.options.shear:  # its strain is drawn instead
            return found
        return found | {"overlay": overlay}

    def _strain_status(self) -> dict[str, Any] | None:
        seen = self._reader.seen if isinstance(self._reader, ShearFrameReader) else None
        if seen is None:
            return None
        if self._strain is None or self._strain[0] is not seen:  # once a frame, however often it is told
            self._strain = seen, strain_view(*seen)
        return self._strain[1]

    def _press_status(self) -> dict[str, Any] | None:
        """The last presses, the newest first; why there can be none."""
        presses, source = self._presses, self.loop.source
        if presses is None:
            return None
        why = ""
        if source is not None and source.force is None:
            why = f"there is no force sensor beside {source.name}, and stiffness needs one"
        last = [one.to_dict() for one in presses.presses.items()[-TOLD_PRESSES:]]
        return {"calibration": self._compliance, "presses": last[::-1], "why": why}

    def _opened_reader(self, calibration: str) -> FrameReader:
        reference = read_image(self.options.reference) if self.options.reference else None
        if self.options.shear:
            return open_shear_reader(self.options.shear, calibration or None, reference=reference)
        return open_reader(calibration, reference=reference, threads=self.options.threads)

    def _opened_source(self) -> LiveSource:
        source = self.options.open()
        try:
            self._attach(source, self._reader)
        except BaseException:
            source.close()
            raise
        if not self.options.preset:
            self._watch.preset = preset_of_camera(self.options.camera)
        wanted = self.options.zero
        by_itself = not source.waits and not self.options.reference and self.loop.untouched is None
        if by_itself if wanted is None else wanted and self.loop.untouched is None:
            self.loop.zero()
        return source

    @staticmethod
    def _attach(source: LiveSource, reader: FrameReader | None) -> None:
        if isinstance(reader, CalibrationReader):
            reader.attach(source)

    def _opened_collector(self, request: Mapping[str, Any]) -> Any:
        from palpate.rig.real.scale import ScaleSpec, SerialScale
        from palpate.sensing.collection.plateau_finder import Weighing
        from palpate.sensing.collection.press_collector import PressCollector, ScaleCollector

        path, source = self._path(request_field(request, "run", (str,))), self._source()
        kind = request.get("scale", "beside")
        if not isinstance(kind, str) or not kind:
            raise InputError(f"scale {kind!r}; give 'beside', 'typed', or the serial port of a scale")
        if kind == "beside" and source.force is None:
            raise InputError(
                f"there is no force sensor beside {source.name}; type weights: scale 'typed', or give the "
                "serial port of a scale",
                code="no-force-sensor",
            )
        options = {k: request[k] for k in ("asked", "session", "region", "force_range_n") if k in request}
        options |= {k: tuple(options[k]) for k in ("region", "force_range_n") if options.get(k) is not None}
        if isinstance(source, HandFrames):
            truths = ("true_depth_mm", "true_force_N", "true_x_mm", "true_y_mm")
            options |= {"truth": source.hand.truth, "truths": truths, "licence": "CC0-1.0"}
            options |= {"origin": "pressed by a virtual hand", "provenance": Provenance.SIMULATED}
        name = source.name.replace("virtual:", "virtual ")
        if kind in ("beside", "typed"):
            scale = Weighing.by(source.force) if kind == "beside" and source.force is not None else None
            return PressCollector(path, name, scale, **options)
        opened = SerialScale.open(ScaleSpec(kind, unit=request.get("unit") or ""), MonotonicClock())
        try:
            by_scale = PressCollector(path, name, Weighing.by(opened, f"the scale at {kind}"), **options)
        except BaseException:
            opened.close()
            raise
        return ScaleCollector(by_scale, opened)

    def _source(self) -> LiveSource:
        source = self.loop.source
        if source is None:
            raise SafetyError(
                f"{self.options.camera} is not there now ({self.loop.why}); nothing is recorded",
                code="camera-missing",
            )
        return source

    def _path(self, run: str) -> Path:
        if not self.options.runs:
            raise InputError("this process was given no folder for recordings; start it with one")
        return Path(self.options.runs) / plain_name(run)

    def _check_free(self) -> None:
        if self._recorder is not None or self._collector is not None:
            raise SafetyError("a recording is under way; end it first")


class Nudge:
    """Subscriber that has the server tell its clients of each frame sooner."""

    def __init__(self, server: RpcServer) -> None:
        self._server = server

    def on_frame(self, frame: Frame, readings: Readings | None) -> None:
        """Tell of it."""
        self._server.nudge()

    def on_force(self, samples: Sequence[Wrench]) -> None:
        """Forces are told with frames."""


class LiveServer(RpcServer):
    """Serves a `LiveService` to processes on this machine."""

    def __init__(self, service: LiveService) -> None:
        self.ended = threading.Event()
        quick: dict[str, Request] = {
            "zero": lambda _: service.zero(),
            "status": lambda _: service.status(),
            "label": lambda request: service.label(request_field(request, "force_n", (int, float))),
            "shutdown": lambda _: self.ended.set(),
        }
        slow: dict[str, Request] = {
            "calibration": lambda request: service.use(request_field(request, "path", (str,))),
            "record": lambda request: service.record(request_field(request, "run", (str,))),
            "record_stop": lambda _: service.record_stop(),
            "collect": service.collect,
            "collect_stop": lambda _: service.collect_stop(),
        }
        super().__init__(service.name, service.status, service.picture, quick, slow)
        service.loop.subscribe(Nudge(self))


def main() -> int:
    """Read a sensor until told to end."""
    parser = argparse.ArgumentParser(description="Read a sensor live, and tell whoever asks.")
    parser.add_argument("--name", required=True)
    parser.add_argument(
        "--options", default="{}", help="JSON object of options, such as camera and calibration"
    )
    parser.add_argument("--folder", type=Path, help="folder of the address file")
    words = parser.parse_args()
    ended = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        ended.set()

    sys.setswitchinterval(SWITCH_S)
    cv2.setNumThreads(1)
    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with contained(f"the process of {words.name}"):
        try:
            serve_live(words.name, LiveOptions.from_dict(json.loads(words.options)), words.folder, ended)
        except PalpateError as e:
            print(f"palpate: {e}", file=sys.stderr)
            return 2
    return 0


def serve_live(name: str, options: LiveOptions, folder: Path | None, ended: threading.Event) -> None:
    """Read a sensor until the event is set, or a client asks for the end."""
    with hold(name, folder):
        service = LiveService(name, options)
        server = LiveServer(service)
        keep_loaded()
        service.start()
        path = publish(Address(name, server.port, server.token, os.getpid()), folder)
        try:
            with thread_failures(service.report):
                _upkeep(service, lambda: ended.wait(LOOK_S) or server.ended.is_set())
        finally:
            path.unlink(missing_ok=True)
            service.close()
            server.close()


def _upkeep(service: LiveService, over: Callable[[], bool]) -> None:
    """Keep pauses short and memory flat until it is over."""
    freed_s = time.monotonic()
    settles_s: float | None = None
    while not over():
        now_s = time.monotonic()
        if now_s - freed_s > FREE_EVERY_S:
            give_back_memory()
            freed_s = now_s
        if settles_s is None and service.loop.latest is not None:
            settles_s = now_s + SETTLED_S
        if settles_s is not None and now_s > settles_s:
            keep_loaded()
            settles_s = math.inf


if __name__ == "__main__":
    sys.exit(main())
