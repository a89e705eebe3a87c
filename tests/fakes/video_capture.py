"""A camera that is not there: stands in for `cv2.VideoCapture`, with every fault on demand."""

from __future__ import annotations

import time
from threading import Event
from typing import Any

import cv2
import numpy as np

from palpate.core import UInt8, ndarray

BLUE = 7  # of every pixel: tells a picture in BGR from one in RGB


Noise = UInt8[ndarray, "..."]


class FakeVideoCapture:
    """Gives noise at a rate, the frame's number in its first pixels. Change its attributes to make it fail.

    Attributes:
        refused: controls, by OpenCV's number, that cannot be set.
        kept: controls that seem to be set, and keep these values.
        opens: whether it can be opened.
        frozen: gives the same picture for ever.
        unplugged: gives no frame any more.
        error: raised by the next read.
        shape: of the pictures, from now on.
        released: set once it was let go of.
        resume: reads wait while it is clear.
        hangs: set once a read waits so.
        numbers: of the frames taken so far.

    Example:
        >>> camera = FakeVideoCapture()
        >>> camera.grab(), frame_number(camera.retrieve()[1])
        (True, 1)
    """

    def __init__(self, size_px: tuple[int, int] = (64, 48), rate_hz: float = 100.0, seed: int = 0) -> None:
        self.refused: set[int] = set()
        self.kept: dict[int, float] = {}
        self.opens, self.frozen, self.unplugged = True, False, False
        self.error: Exception | None = None
        self.shape: tuple[int, ...] = (size_px[1], size_px[0], 3)
        self.released, self.resume, self.hangs = Event(), Event(), Event()
        self.resume.set()
        self.numbers = 0
        self._set: dict[int, float] = {}
        self._rate_hz, self._rng = rate_hz, np.random.default_rng(seed)
        self._broken = self._repeated = 0
        self._stamp_ms, self._due = 1000.0, time.monotonic()
        self._picture: Noise | None = None

    def drop(self, n: int = 1) -> None:
        """Lose the next n frames: their time passes, and they never come."""
        self.numbers += n
        self._stamp_ms += 1e3 * n / self._rate_hz

    def repeat(self, n: int = 1) -> None:
        """Give the last picture n times more."""
        self._repeated += n

    def tear(self, n: int = 1) -> None:
        """Make the next n frames undecodable."""
        self._broken += n

    def turn_back(self, seconds: float) -> None:
        """Set the clock of the driver's stamps back [s]."""
        self._stamp_ms -= 1e3 * seconds

    def isOpened(self) -> bool:
        return self.opens

    def set(self, control: int, value: float, /) -> bool:
        if control in self.refused:
            return False
        self._set[control] = value
        return True

    def get(self, control: int, /) -> float:
        if control == cv2.CAP_PROP_POS_MSEC:
            return self._stamp_ms
        return self.kept.get(control, self._set.get(control, -1.0))

    def grab(self) -> bool:
        """Wait for the next frame."""
        if not self.resume.is_set():
            self.hangs.set()
            self.resume.wait()
        self._due = max(self._due + 1 / self._rate_hz, time.monotonic())
        time.sleep(max(self._due - time.monotonic(), 0.0))
        if self.error is not None:
            error, self.error = self.error, None
            raise error
        if self.unplugged:
            return False
        self.numbers += 1
        self._stamp_ms += 1e3 / self._rate_hz
        return True

    def retrieve(self) -> tuple[bool, Any]:
        """The frame waited for, as BGR."""
        if self._broken:
            self._broken -= 1
            return False, None
        if self._picture is not None and (self.frozen or self._repeated):
            self._repeated = max(self._repeated - 1, 0)
        else:
            self._picture = self._noise()
        return True, self._picture.copy()

    def release(self) -> None:
        """Let go of it."""
        self.released.set()

    def _noise(self) -> Noise:
        picture = self._rng.integers(100, 140, self.shape, dtype=np.uint8)
        picture.reshape(-1, picture.shape[-1])[:, 0] = BLUE
        picture.reshape(-1)[[1, 2, 4, 5]] = [self.numbers >> shift & 0xFF for shift in (24, 16, 8, 0)]
        return picture


def frame_number(picture: UInt8[ndarray, "h w 3"]) -> int:
    """The number that a fake camera wrote into a picture, in BGR."""
    return int.from_bytes(picture.reshape(-1)[[1, 2, 4, 5]].tobytes(), "big")
