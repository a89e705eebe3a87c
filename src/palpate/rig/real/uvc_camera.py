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
from pathlib import Path
from threading import Condition, Event, Thread
from typing import Any, Literal, Protocol, runtime_checkable

import cv2
import numpy as np

from palpate.core import (
    NS_PER_S,
    Clock,
    Closing,
    DeviceError,
    Frame,
    MonotonicClock,
    RangeError,
    UInt8,
    ndarray,
)
from palpate.rig.real.camera_listing import VideoSystem, list_cameras
from palpate.rig.real.device_hold import DeviceHold, camera_named, hold_device

BY_ID = Path("/dev/v4l/by-id")


def device(address: str | int, by_id: Path = BY_ID) -> str | int:
    """Device of an address.

    Args:
        address: a number, a path such as ``/dev/video2``, or the serial number that the camera tells over
            USB. Only the last stays with the camera when cables are swapped.
        by_id: where the system lists cameras by serial number.

    Raises:
        DeviceError: no camera, or more than one, has this serial number.
    """
    if isinstance(address, int) or "/" in address:
        return address
    matches = [path for path in _cameras(by_id) if path.name.endswith(f"_{address}-video-index0")]
    if len(matches) != 1 or not address:
        there = ", ".join(path.name for path in _cameras(by_id)) or "none"
        raise DeviceError(
            f"{len(matches)} cameras have the serial number {address!r}; {by_id} lists: {there}. "
            "Give one of these serial numbers, a path such as /dev/video0, or a number",
            code="camera-not-found",
        )
    return str(matches[0].resolve())


def _cameras(by_id: Path) -> list[Path]:
    return sorted(by_id.glob("*-video-index0"))


_RATE_OVER = 100  # frames
_MAX_BROKEN = 10  # frames in a row
_MIN_EQUAL = 3  # frames in a row; one pair a long time apart is a busy computer
Picture = UInt8[ndarray, "h w 3"]


@dataclass(frozen=True, slots=True)
class UvcCounts:
    """Counts of what a camera has sent.

    Attributes:
        frames: new ones.
        dropped: that the time between two frames leaves room for; counted by the camera driver's stamps.
        duplicate: equal to the one before in every pixel, and passed over.
        broken: that could not be decoded, and were passed over.
        backwards: how often the driver's stamps went back.
    """

    frames: int = 0
    dropped: int = 0
    duplicate: int = 0
    broken: int = 0
    backwards: int = 0


class FrameWatch:
    """Follows the frames of one camera."""

    def __init__(self, size_px: tuple[int, int], rate_hz: float, freeze_s: float) -> None:
        """Follow a camera.

        Args:
            size_px: (width, height) of every frame [px].
            rate_hz: that it is set to [Hz].
            freeze_s: after equal frames for longer, it counts as frozen [s].
        """
        self._size_px, self._period_ns, self._freeze_ns = size_px, NS_PER_S / rate_hz, freeze_s * NS_PER_S
        self._frames = self._dropped = self._duplicate = self._broken = self._backwards = 0
        self._broken_in_a_row = self._equal_in_a_row = 0
        self._before: Picture | None = None
        self._stamps_ns: deque[int] = deque(maxlen=_RATE_OVER)
        self._new_ns = 0

    @property
    def counts(self) -> UvcCounts:
        """Counts of what has come so far."""
        return UvcCounts(self._frames, self._dropped, self._duplicate, self._broken, self._backwards)

    @property
    def measured_rate_hz(self) -> float | None:
        """Frames a second over the last hundred, duplicates among them; None until there are two [Hz]."""
        stamps = self._stamps_ns.copy()
        return (len(stamps) - 1) * NS_PER_S / (stamps[-1] - stamps[0]) if len(stamps) > 1 else None

    def broken(self, stamp_ns: int) -> None:
        """Count a frame that could not be decoded."""
        self._stamp(stamp_ns)
        self._broken += 1
        self._broken_in_a_row += 1
        if self._broken_in_a_row >= _MAX_BROKEN:
            raise DeviceError(f"{_MAX_BROKEN} frames in a row could not be decoded; try another cable")

    def is_new(self, picture: ndarray, stamp_ns: int, time_ns: int) -> bool:
        """Whether a frame is another one than that before."""
        self._refuse_changed(picture)
        self._broken_in_a_row = 0
        self._stamp(stamp_ns)
        if self._before is not None and np.array_equal(picture, self._before):
            self._duplicate += 1
            self._equal_in_a_row += 1
            if self._equal_in_a_row >= _MIN_EQUAL and time_ns - self._new_ns > self._freeze_ns:
                raise DeviceError(
                    f"all frames for {self._freeze_ns / NS_PER_S:g} s were equal in every pixel: it froze, "
                    "or sees perfect darkness; plug it in anew, or take off its cap"
                )
            return False
        self._frames, self._before, self._new_ns, self._equal_in_a_row = self._frames + 1, picture, time_ns, 0
        return True

    def _refuse_changed(self, picture: ndarray) -> None:
        width, height = self._size_px
        if picture.dtype != np.uint8 or picture.shape != (height, width, 3):
            raise DeviceError(
                f"a frame came as {picture.dtype} {list(picture.shape)} where uint8 [{height}, {width}, 3] "
                "was set: its size or format changed; close other programs that use it and open it anew"
            )

    def _stamp(self, stamp_ns: int) -> None:
        if self._stamps_ns:
            step_ns = stamp_ns - self._stamps_ns[-1]
            if step_ns <= 0:
                self._backwards += step_ns < 0
                self._stamps_ns.clear()
            else:
                self._dropped += max(round(step_ns / self._period_ns) - 1, 0)
        self._stamps_ns.append(stamp_ns)


EXPOSURE_UNIT_S = 1e-4  # of the control "exposure time, absolute" in UVC
MANUAL = 1  # of the control "exposure, auto" in Video4Linux
_RATE_WITHIN = 2e-3  # cameras keep fractions, such as 30000/1001
KEPT_S = 0.5  # of frames that wait to be drained
_CLOSE_S = 2.0  # for a read under way to end


@runtime_checkable
class VideoSource(Protocol):
    """Source of video, as far as `cv2.VideoCapture` is used."""

    def isOpened(self) -> bool: ...  # noqa: N802 - OpenCV's name
    def set(self, control: int, value: float, /) -> bool: ...
    def get(self, control: int, /) -> float: ...
    def grab(self) -> bool: ...
    def retrieve(self) -> tuple[bool, Any]: ...
    def release(self) -> None: ...


def refuse_absent(where: str | int, system: VideoSystem | None = None) -> None:
    """Refuse a device whose file is not there, and say which cameras are; Linux alone has such files.

    Raises:
        DeviceError: it is not there.
    """
    at = system or VideoSystem()
    path = at.devices / f"video{where}" if isinstance(where, int) else Path(where)
    if sys.platform != "linux" or path.exists():
        return
    cameras = list_cameras(at)
    there = ", ".join(f"{one.path} ({one.name}, serial number {one.serial or 'none'})" for one in cameras)
    raise DeviceError(
        f"the camera {where}: there is no {path}; "
        + (f"there are {there}" if there else "no camera is to be seen: check that it is plugged in"),
        code="camera-not-found",
    )


def open_video_source(where: str | int) -> VideoSource:
    """The camera there, by Video4Linux where there is one."""
    return cv2.VideoCapture(where, cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY)


@dataclass(frozen=True, slots=True)
class UvcSettings:
    """Settings of how a camera takes its frames.

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
        width, height = self.size_px
        for name, value, unit in (
            ("width", width, "px"),
            ("height", height, "px"),
            ("rate_hz", self.rate_hz, "Hz"),
            ("freeze_s", self.freeze_s, "s"),
            ("white_balance_k", self.white_balance_k or 1, "K"),
        ):
            if not 0 < value < math.inf:
                raise RangeError(f"a camera's {name} is {value:g} {unit}; it has to be greater than 0")
        if not 0 <= (delay_s := self.delay_s or 0.0) < math.inf:
            raise RangeError(f"a camera's delay_s is {delay_s:g} s; it has to be 0 or greater")
        if not EXPOSURE_UNIT_S <= self.exposure_s <= 1 / self.rate_hz:
            raise RangeError(
                f"exposure {self.exposure_s:g} s is outside {EXPOSURE_UNIT_S:g} to {1 / self.rate_hz:g} s, "
                f"what UVC allows at {self.rate_hz:g} frames a second; expose shorter or take fewer frames"
            )
        if self.pixels not in ("MJPG", "YUYV"):
            raise RangeError(f"pixels is {self.pixels!r}; give 'MJPG' or 'YUYV'")


class UvcCamera(Closing):
    """A USB camera. Opening it sets and verifies everything, and waits for the first frame.

    Use it in a ``with`` block, or close it.

    Example:
        >>> settings = UvcSettings(size_px=(640, 480), rate_hz=30.0, exposure_s=5e-3)
        >>> with UvcCamera("/dev/video0", settings) as camera:  # doctest: +SKIP
        ...     time_ns, frame = camera.grab(timeout_s=10.0)
        ...     frame.image.shape, frame.exposure_s
        ((480, 640, 3), 0.005)
    """

    def __init__(
        self,
        address: str | int = 0,
        settings: UvcSettings | None = None,
        clock: Clock | None = None,
        opener: Callable[[str | int], VideoSource] = open_video_source,
    ) -> None:
        """Open the camera.

        Args:
            address: a number, a path such as ``/dev/video2``, or the camera's serial number.
            settings: how it shall take its frames.
            clock: stamps the frames.
            opener: makes the source for a path or a number; another one stands in for a camera in tests.
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
        self._targets = self._controls()
        self._in_turn = cycle(self._targets)
        where = device(address)
        real = opener is open_video_source
        if real:
            refuse_absent(where)
        self._held = hold_device(camera_named(where)) if real else DeviceHold(None)
        self._source = opener(where)
        try:
            self._open()
        except (DeviceError, cv2.error) as error:
            self._source.release()
            self._held.release()
            raise DeviceError(f"the camera {address}: {error}") from error
        self._thread = Thread(target=self._run, name=f"camera {address}", daemon=True)
        self._thread.start()

    @property
    def rate_hz(self) -> float:
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
        """Counts of what has come so far."""
        with self._new:
            return self._watch.counts

    @property
    def health(self) -> str:
        """What was lost, repeated or damaged so far; empty where nothing was."""
        counts = self.counts
        told = {
            "frames lost": counts.dropped,
            "frames that repeat the one before": counts.duplicate,
            "frames broken": counts.broken,
            "steps back of the driver's clock": counts.backwards,
        }
        return ", ".join(f"{count} {what}" for what, count in told.items() if count)

    def grab(self, timeout_s: float = 1.0) -> tuple[int, Frame]:
        """The next frame exposed wholly after this call, and when its exposure ended [ns].

        The time is that of arrival less the settings' delay; it never goes backwards.
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
                    raise DeviceError(f"the camera {self._name}: {why}", code="no-frames")
                self._new.wait(left_ns / NS_PER_S)
            self._kept.clear()
            return self._newest

    def drain(self) -> list[tuple[int, Frame]]:
        """Frames since the last call or `grab`, oldest first; of the last half second at most."""
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

    def _open(self) -> None:
        if not self._source.isOpened():
            raise DeviceError(
                "it cannot be opened: check that it is plugged in, that no other program uses it, and that "
                "you may read it (on Linux, group video)"
            )
        for control, (_, value) in self._targets.items():
            self._source.set(control, value)  # what it returns says little; what is read back holds
        if self._settings.white_balance_k is None and self._source.get(cv2.CAP_PROP_AUTO_WB) == 1:
            raise DeviceError("its white balance is automatic; give white_balance_k")
        for control in self._targets:
            self._verify(control)
        for _ in self._targets:  # and once more while frames come: some cameras fall back only then
            self._step()

    def _controls(self) -> dict[int, tuple[str, float]]:
        """Everything that is set, in the order it has to be: a control's number to its name and value."""
        s = self._settings
        controls: dict[int, tuple[str, float]] = {
            cv2.CAP_PROP_FOURCC: ("pixels", cv2.VideoWriter.fourcc(*s.pixels)),
            cv2.CAP_PROP_FRAME_WIDTH: ("width [px]", s.size_px[0]),
            cv2.CAP_PROP_FRAME_HEIGHT: ("height [px]", s.size_px[1]),
            cv2.CAP_PROP_FPS: ("frames a second", s.rate_hz),
            cv2.CAP_PROP_AUTO_EXPOSURE: ("automatic exposure (1 is off)", MANUAL),
            cv2.CAP_PROP_EXPOSURE: ("exposure [0.1 ms]", round(s.exposure_s / EXPOSURE_UNIT_S)),
        }
        if s.white_balance_k is not None:
            controls[cv2.CAP_PROP_AUTO_WB] = ("automatic white balance", 0)
            controls[cv2.CAP_PROP_WB_TEMPERATURE] = ("white balance [K]", s.white_balance_k)
        return controls | {n: (f"OpenCV's control {n}", value) for n, value in s.controls.items()}

    def _verify(self, control: int) -> None:
        name, target = self._targets[control]
        actual = self._source.get(control)
        within = _RATE_WITHIN if control == cv2.CAP_PROP_FPS else 0.0
        if not math.isclose(target, actual, rel_tol=within):
            words = [_letters(v) if control == cv2.CAP_PROP_FOURCC else f"{v:g}" for v in (target, actual)]
            raise DeviceError(
                f"{name} was set to {words[0]} and is {words[1]}: it refuses that, or another program "
                "changed it; see what it can do (on Linux, v4l2-ctl --list-ctrls --list-formats-ext tells)"
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
            self._held.release()

    def _fail(self, why: str) -> None:
        with self._new:
            self._failure = self._failure or why
            self._newest = None
            self._new.notify_all()

    def _step(self) -> None:
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
    letters = (int(fourcc) & 0xFFFFFFFF).to_bytes(4, "little")
    return letters.decode("ascii") if letters.isalnum() else f"{fourcc:g}"
