"""A USB video class (UVC) camera through OpenCV; what would change an image by itself is locked and verified.

A thread of its own reads every frame, so none waits in a queue; the newest ones are kept. With every frame it
verifies one setting again, in turn: other programs can change them.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import cycle
from threading import Condition, Event, Thread
from types import TracebackType
from typing import Any, Literal, Protocol, runtime_checkable

import cv2
import numpy as np

from palpate.core.clock import NS_PER_S, Clock, MonotonicClock
from palpate.core.errors import DeviceError, RangeError
from palpate.core.frame import Frame
from palpate.rig.real.uvc_address import device
from palpate.rig.real.uvc_watch import FrameWatch, UvcCounts

EXPOSURE_UNIT_S = 1e-4  # of the control "exposure time, absolute" in UVC
MANUAL = 1  # of the control "exposure, auto" in Video4Linux
_RATE_WITHIN = 2e-3  # cameras keep fractions, such as 30000/1001
KEPT_S = 0.5  # of frames that wait to be drained
_CLOSE_S = 2.0  # for a read under way to end


@runtime_checkable
class Source(Protocol):
    """What is used of `cv2.VideoCapture`."""

    def isOpened(self) -> bool: ...  # noqa: N802 - OpenCV's name
    def set(self, control: int, value: float, /) -> bool: ...
    def get(self, control: int, /) -> float: ...
    def grab(self) -> bool: ...
    def retrieve(self) -> tuple[bool, Any]: ...
    def release(self) -> None: ...


def open_source(where: str | int) -> Source:
    """The camera there, by Video4Linux where there is one."""
    return cv2.VideoCapture(where, cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY)


@dataclass(frozen=True, slots=True)
class UvcSettings:
    """How a camera shall take its frames.

    Attributes:
        size_px: (width, height) [px].
        rate_hz: frames a second [Hz].
        pixels: how they travel: "MJPG" compresses and loses detail, "YUYV" does not and needs more bandwidth.
        exposure_s: of every frame, in steps of 0.1 ms [s].
        white_balance_k: colour temperature taken as white [K]; None for a camera without such a control.
        controls: further controls, OpenCV's number to value, such as gain and focus; each is verified.
        delay_s: from the end of an exposure until its frame is here [s]; by default one frame's time. Measure
            it for work on moving contacts, with a lamp that is switched on at a known time.
        freeze_s: after equal frames for longer, the camera counts as frozen [s].
    """

    size_px: tuple[int, int] = (640, 480)
    rate_hz: float = 30.0
    pixels: Literal["MJPG", "YUYV"] = "MJPG"
    exposure_s: float = 0.01
    white_balance_k: int | None = 4600
    controls: Mapping[int, float] = field(default_factory=dict)
    delay_s: float | None = None
    freeze_s: float = 1.0

    def __post_init__(self) -> None:
        delay_s = 0.0 if self.delay_s is None else self.delay_s
        given = (*self.size_px, self.rate_hz, self.freeze_s, self.white_balance_k or 1.0)
        if not all(value > 0 and math.isfinite(value) for value in given) or not 0 <= delay_s < math.inf:
            raise RangeError(
                f"sizes [px], rates [Hz], times [s] and kelvins have to be greater than 0: {self}"
            )
        if not EXPOSURE_UNIT_S <= self.exposure_s <= 1 / self.rate_hz:
            raise RangeError(
                f"exposure {self.exposure_s:g} s is outside {EXPOSURE_UNIT_S:g} to {1 / self.rate_hz:g} s, "
                f"what UVC allows at {self.rate_hz:g} frames a second; expose shorter or take fewer frames"
            )
        if self.pixels not in ("MJPG", "YUYV"):
            raise RangeError(f"pixels is {self.pixels!r}; give 'MJPG' or 'YUYV'")


class UvcCamera:
    """A USB camera. Opening it sets and verifies everything, and waits for the first frame.

    Use it in a ``with`` block, or close it.

    Example:
        >>> from palpate.rig.fakes.camera import FakeVideoCapture
        >>> settings = UvcSettings(size_px=(64, 48), rate_hz=100.0, exposure_s=5e-3)
        >>> with UvcCamera("/dev/video0", settings, opener=lambda where: FakeVideoCapture()) as camera:
        ...     time_ns, frame = camera.grab(timeout_s=10.0)
        >>> frame.image.shape, frame.exposure_s
        ((48, 64, 3), 0.005)
    """

    def __init__(
        self,
        address: str | int = 0,
        settings: UvcSettings | None = None,
        clock: Clock | None = None,
        opener: Callable[[str | int], Source] = open_source,
    ) -> None:
        """Open the camera.

        Args:
            address: a number, a path such as ``/dev/video2``, or the camera's serial number.
            settings: how it shall take its frames.
            clock: stamps the frames.
            opener: makes the source for a path or a number; another one stands in for a camera in tests.

        Raises:
            DeviceError: there is no such camera, it is in use, refuses a setting, or sends no frame.
        """
        self._name, self._settings = str(address), settings or UvcSettings()
        self._clock = clock or MonotonicClock()
        s = self._settings
        self._watch = FrameWatch(s.size_px, s.rate_hz, s.freeze_s)
        self._new, self._closing = Condition(), Event()
        self._newest: tuple[int, Frame] | None = None
        self._kept: deque[tuple[int, Frame]] = deque(maxlen=max(2, math.ceil(KEPT_S * s.rate_hz)))
        self._failure = ""
        self._last_ns = self._clock.now_ns()
        self._asked = self._controls()
        self._in_turn = cycle(self._asked)
        self._source = opener(device(address))
        try:
            self._open()
        except (DeviceError, cv2.error) as error:
            self._source.release()
            raise DeviceError(f"the camera {address}: {error}") from error
        self._thread = Thread(target=self._run, name=f"camera {address}", daemon=True)
        self._thread.start()

    @property
    def rate_hz(self) -> float:
        """Frames a second that it is set to [Hz]."""
        return self._settings.rate_hz

    @property
    def measured_rate_hz(self) -> float | None:
        """Frames a second that came of late, by the driver's stamps; None until there are two [Hz]."""
        with self._new:
            return self._watch.measured_rate_hz

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of every frame [px]."""
        return self._settings.size_px

    @property
    def counts(self) -> UvcCounts:
        """What has come so far."""
        with self._new:
            return self._watch.counts

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        """The next frame exposed wholly after this call, and when its exposure ended [ns].

        The time is that of arrival less the settings' delay; it never goes backwards.

        Raises:
            RangeError: the time-out is not a number of seconds.
            DeviceError: none came in time, or the camera has failed, and why.
        """
        if not 0 < timeout_s < math.inf:
            raise RangeError(f"timeout_s is {timeout_s}; give a number of seconds greater than 0")
        asked_ns = self._clock.now_ns()
        until_ns = asked_ns + round(timeout_s * NS_PER_S)
        exposure_ns = round(self._settings.exposure_s * NS_PER_S)
        with self._new:
            while self._newest is None or self._newest[0] - exposure_ns < asked_ns:
                left_ns = until_ns - self._clock.now_ns()
                if self._failure or left_ns <= 0:
                    why = self._failure or f"no frame came within {timeout_s:g} s; is it still plugged in?"
                    raise DeviceError(f"the camera {self._name}: {why}")
                self._new.wait(left_ns / NS_PER_S)
            self._kept.clear()
            return self._newest

    def drain(self) -> list[tuple[int, Frame]]:
        """All frames since the last call or `grab`, oldest first; of the last half second at most.

        Raises:
            DeviceError: the camera has failed, and why.
        """
        with self._new:
            if self._failure:
                raise DeviceError(f"the camera {self._name}: {self._failure}")
            frames = list(self._kept)
            self._kept.clear()
            return frames

    def close(self) -> None:
        """Let go of the camera. Closing again does nothing.

        A read that hangs keeps the device until it ends; closing does not wait for it longer than 2 s.
        """
        self._closing.set()
        self._thread.join(_CLOSE_S)
        self._fail("it was closed; open it anew")

    def __enter__(self) -> UvcCamera:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _open(self) -> None:
        if not self._source.isOpened():
            raise DeviceError(
                "it cannot be opened: check that it is plugged in, that no other program uses it, and that "
                "you may read it (on Linux, group video)"
            )
        for control, (_, value) in self._asked.items():
            self._source.set(control, value)  # what it returns says little; what is read back holds
        if self._settings.white_balance_k is None and self._source.get(cv2.CAP_PROP_AUTO_WB) == 1:
            raise DeviceError("its white balance is automatic; give white_balance_k")
        for control in self._asked:
            self._verify(control)
        for _ in self._asked:  # and once more while frames come: some cameras fall back only then
            self._step()

    def _controls(self) -> dict[int, tuple[str, float]]:
        """Everything that is set, in the order it has to be: a control's number to its name and value."""
        s = self._settings
        asked: dict[int, tuple[str, float]] = {
            cv2.CAP_PROP_FOURCC: ("pixels", cv2.VideoWriter.fourcc(*s.pixels)),
            cv2.CAP_PROP_FRAME_WIDTH: ("width [px]", s.size_px[0]),
            cv2.CAP_PROP_FRAME_HEIGHT: ("height [px]", s.size_px[1]),
            cv2.CAP_PROP_FPS: ("frames a second", s.rate_hz),
            cv2.CAP_PROP_AUTO_EXPOSURE: ("automatic exposure (1 is off)", MANUAL),
            cv2.CAP_PROP_EXPOSURE: ("exposure [0.1 ms]", round(s.exposure_s / EXPOSURE_UNIT_S)),
        }
        if s.white_balance_k is not None:
            asked[cv2.CAP_PROP_AUTO_WB] = ("automatic white balance", 0)
            asked[cv2.CAP_PROP_WB_TEMPERATURE] = ("white balance [K]", s.white_balance_k)
        return asked | {n: (f"OpenCV's control {n}", value) for n, value in s.controls.items()}

    def _verify(self, control: int) -> None:
        name, asked = self._asked[control]
        held = self._source.get(control)
        within = _RATE_WITHIN if control == cv2.CAP_PROP_FPS else 0.0
        if not math.isclose(asked, held, rel_tol=within):
            told = [_letters(v) if control == cv2.CAP_PROP_FOURCC else f"{v:g}" for v in (asked, held)]
            raise DeviceError(
                f"{name} was set to {told[0]} and is {told[1]}: it refuses that, or another program changed "
                "it; ask for what it can do (on Linux, v4l2-ctl --list-ctrls --list-formats-ext tells)"
            )

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._step()
        except DeviceError as error:
            self._fail(str(error))
        except cv2.error as error:
            self._fail(f"OpenCV gave up: {error}")
        finally:  # also after what nobody thought of; and only here, since a read must not lose its device
            ended = "it was closed" if self._closing.is_set() else "its reading thread ended"
            self._fail(f"{ended}; open it anew")
            self._source.release()

    def _fail(self, why: str) -> None:
        with self._new:
            self._failure = self._failure or why
            self._newest = None
            self._new.notify_all()

    def _step(self) -> None:
        """Read a frame, and keep it where it is a new one."""
        if not self._source.grab():
            raise DeviceError("it gives no frame: it was unplugged, or another program took it")
        self._last_ns = max(self._last_ns, self._clock.now_ns())  # before the frame is decoded
        good, picture = self._source.retrieve()
        told_ms = self._source.get(cv2.CAP_PROP_POS_MSEC)
        stamp_ns = round(told_ms * 1e6) if told_ms > 0 else self._last_ns
        self._verify(next(self._in_turn))
        with self._new:
            if not good:
                self._watch.broken(stamp_ns)
            elif self._watch.is_new(picture, stamp_ns, self._last_ns):
                self._newest = self._frame(picture)
                self._kept.append(self._newest)
                self._new.notify_all()

    def _frame(self, picture: np.ndarray) -> tuple[int, Frame]:
        s = self._settings
        delay_s = 1 / s.rate_hz if s.delay_s is None else s.delay_s
        time_ns = self._last_ns - round(delay_s * NS_PER_S)
        frame = Frame(
            image=cv2.cvtColor(picture, cv2.COLOR_BGR2RGB),
            time_s=time_ns / NS_PER_S,
            exposure_s=round(s.exposure_s / EXPOSURE_UNIT_S) * EXPOSURE_UNIT_S,
            sensor=self._name,
            name=str(self._watch.counts.frames - 1),
        )
        return time_ns, frame


def _letters(fourcc: float) -> str:
    """The four letters of a pixel format's number."""
    letters = (int(fourcc) & 0xFFFFFFFF).to_bytes(4, "little")
    return letters.decode("ascii") if letters.isalnum() else f"{fourcc:g}"
