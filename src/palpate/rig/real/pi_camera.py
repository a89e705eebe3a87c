"""A camera of a Raspberry Pi, through its own library picamera2; exposure and colours are locked.

Only the library's calls that its manual documents are used (Picamera2 Manual, Raspberry Pi Ltd,
https://datasheets.raspberrypi.com/camera/picamera2-manual.pdf). Without such a camera at hand it was tested
against a stand-in alone.
"""

from __future__ import annotations

import time
from collections import deque
from threading import Condition, Event, Thread
from typing import Any

import numpy as np

from palpate.core import NS_PER_S, Closing, DeviceError, Frame
from palpate.core.optional_imports import require
from palpate.rig.real.uvc_camera import KEPT_S, UvcSettings

CLOSE_S = 2.0
US_PER_S = 1_000_000


class PiCamera(Closing):
    """Camera of a Raspberry Pi, read by a thread of its own; of its frames the last half second is kept."""

    def __init__(self, settings: UvcSettings | None = None, number: int = 0) -> None:
        """Open it, and lock what would change an image by itself.

        Args:
            settings: size, rate and exposure; its pixels, white balance and further controls have no meaning
                here.
            number: of the camera, from 0.
        """
        self._settings = settings or UvcSettings()
        self._new, self._closing = Condition(), Event()
        self._kept: deque[tuple[int, Frame]] = deque(maxlen=max(2, round(KEPT_S * self._settings.rate_hz)))
        self._failure, self._count = "", 0
        library = _library()
        try:
            self._camera = library.Picamera2(number)
            self._configure()
        except (RuntimeError, IndexError, OSError) as e:
            raise DeviceError(
                f"the camera {number} of this Raspberry Pi cannot be opened: {e}; `rpicam-hello "
                "--list-cameras` lists what is there"
            ) from e
        self._thread = Thread(target=self._run, name="picamera2", daemon=True)
        self._thread.start()

    @property
    def rate_hz(self) -> float:
        return self._settings.rate_hz

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of every frame [px]."""
        return self._settings.size_px

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        """The next frame exposed wholly after this call, and when its exposure ended [ns]."""
        asked_ns = time.monotonic_ns() + round(self._settings.exposure_s * NS_PER_S)
        with self._new:
            came = self._new.wait_for(
                lambda: bool(self._failure or (self._kept and self._kept[-1][0] >= asked_ns)), timeout_s
            )
            if self._failure or not came:
                raise DeviceError(self._failure or f"the camera gave no frame within {timeout_s:g} s")
            newest = self._kept[-1]
            self._kept.clear()
            return newest

    def drain(self) -> list[tuple[int, Frame]]:
        with self._new:
            if self._failure:
                raise DeviceError(self._failure)
            frames = list(self._kept)
            self._kept.clear()
            return frames

    def close(self) -> None:
        """Let go of it. Closing again does nothing."""
        if not self._closing.is_set():
            self._closing.set()
            self._thread.join(CLOSE_S)
            self._camera.stop()
            self._camera.close()

    def _configure(self) -> None:
        s, camera = self._settings, self._camera
        period_us = round(US_PER_S / s.rate_hz)
        controls = {
            "AeEnable": False,
            "AwbEnable": False,
            "ExposureTime": round(s.exposure_s * US_PER_S),
            "AnalogueGain": 1.0,
            "FrameDurationLimits": (period_us, period_us),
        }
        # The library's "BGR888" lies in memory as R, G, B.
        main = {"size": s.size_px, "format": "BGR888"}
        camera.configure(camera.create_video_configuration(main=main, controls=controls))
        camera.start()

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                request = self._camera.capture_request()
                try:
                    picture, about = request.make_array("main"), request.get_metadata()
                finally:
                    request.release()
            except (RuntimeError, OSError) as e:
                with self._new:
                    self._failure = f"the camera of this Raspberry Pi gave up: {e}"
                    self._new.notify_all()
                return
            with self._new:
                self._kept.append(self._frame(picture, about))
                self._new.notify_all()

    def _frame(self, picture: np.ndarray, about: dict[str, Any]) -> tuple[int, Frame]:
        """A frame and when its exposure ended: it began at the sensor's own stamp, of the monotonic clock."""
        exposure_s = float(about.get("ExposureTime", round(self._settings.exposure_s * US_PER_S))) / US_PER_S
        begun_ns = int(about.get("SensorTimestamp", time.monotonic_ns()))
        time_ns = min(begun_ns + round(exposure_s * NS_PER_S), time.monotonic_ns())
        name, self._count = str(self._count), self._count + 1
        image = np.array(picture, np.uint8, order="C")
        return time_ns, Frame(image, time_ns / NS_PER_S, exposure_s, PICAMERA, name)


PICAMERA = "picamera2"


def _library() -> Any:
    return require("picamera2", "The camera of a Raspberry Pi")
