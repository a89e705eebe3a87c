"""Watches a camera's frames: which are new, how many were dropped, whether it froze or changed. No camera."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from palpate.core.clock import NS_PER_S
from palpate.core.errors import DeviceError
from palpate.core.shapes import UInt8

_RATE_OVER = 100  # frames
_MOST_BROKEN = 10  # frames in a row
_FEWEST_EQUAL = 3  # frames in a row; one pair a long time apart is a busy computer
Picture = UInt8[ndarray, "h w 3"]


@dataclass(frozen=True, slots=True)
class UvcCounts:
    """What a camera has sent.

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
        """What has come so far."""
        return UvcCounts(self._frames, self._dropped, self._duplicate, self._broken, self._backwards)

    @property
    def measured_rate_hz(self) -> float | None:
        """Frames a second over the last hundred, duplicates among them; None until there are two [Hz]."""
        stamps = self._stamps_ns.copy()
        return (len(stamps) - 1) * NS_PER_S / (stamps[-1] - stamps[0]) if len(stamps) > 1 else None

    def broken(self, stamp_ns: int) -> None:
        """Count a frame that could not be decoded.

        Args:
            stamp_ns: the driver's time of it [ns].

        Raises:
            DeviceError: it was the tenth in a row.
        """
        self._stamp(stamp_ns)
        self._broken += 1
        self._broken_in_a_row += 1
        if self._broken_in_a_row >= _MOST_BROKEN:
            raise DeviceError(f"{_MOST_BROKEN} frames in a row could not be decoded; try another cable")

    def is_new(self, picture: ndarray, stamp_ns: int, time_ns: int) -> bool:
        """Whether a frame is another one than that before.

        Args:
            picture: as the camera gave it.
            stamp_ns: the driver's time of it, on whatever clock [ns].
            time_ns: when it came [ns].

        Raises:
            DeviceError: its size or format is another, or the camera froze.
        """
        self._refuse_changed(picture)
        self._broken_in_a_row = 0
        self._stamp(stamp_ns)
        if self._before is not None and np.array_equal(picture, self._before):
            self._duplicate += 1
            self._equal_in_a_row += 1
            if self._equal_in_a_row >= _FEWEST_EQUAL and time_ns - self._new_ns > self._freeze_ns:
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
