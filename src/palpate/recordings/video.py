"""A video file as a sequence of frames, decoded one after the other.

How many frames a video holds is known for certain only after the last: what its header says is checked then.
Decoding loses what the codec has lost; touch is better recorded as TIFF or as a run.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from palpate.core.errors import ImageError
from palpate.core.shapes import Image
from palpate.recordings.png import MAX_PIXELS

MAX_FRAMES = 1_000_000  # nine hours at 30 frames a second
SUFFIXES = frozenset({".avi", ".mp4", ".mov", ".mkv", ".webm"})


class VideoFrames:
    """The frames of a video, grey where all three channels are one.

    Attributes:
        path: the file.
        rate_hz: frames a second, as the header says; 0 where it says nothing.
    """

    def __init__(self, path: Path) -> None:
        """Open a file, and close it again: every iteration decodes anew.

        Raises:
            ImageError: it is missing, no video that can be decoded, or claims what no camera makes.
        """
        self.path = Path(path)
        if not self.path.is_file():
            raise ImageError(f"{path} is not there (or no plain file); check the name and the folder")
        capture = cv2.VideoCapture(str(self.path))
        try:
            if not capture.isOpened():
                raise ImageError(f"{path} cannot be decoded as a video; convert it, e.g. to MJPEG in AVI")
            w, h, n = (
                capture.get(what)
                for what in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_COUNT)
            )
            if not (0 < w * h <= MAX_PIXELS and 0 < n <= MAX_FRAMES):
                raise ImageError(
                    f"{path} claims {n:g} frames of {w:g} x {h:g} px; up to {MAX_FRAMES} frames of up to "
                    f"{MAX_PIXELS} px are read"
                )
            self._count, rate = int(n), capture.get(cv2.CAP_PROP_FPS)
            self.rate_hz = float(rate) if np.isfinite(rate) and rate > 0 else 0.0
        finally:
            capture.release()

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Image]:
        """The frames in order.

        Raises:
            ImageError: fewer or more of them than the header says.
        """
        capture = cv2.VideoCapture(str(self.path))
        done = 0
        try:
            while True:
                read, frame = capture.read()
                if not read:
                    break
                done += 1
                if done > self._count:
                    break
                yield _plain(frame)
        finally:
            capture.release()
        if done != self._count:
            found = "more" if done > self._count else str(done)
            raise ImageError(
                f"{self.path}: its header says {self._count} frames, and {found} can be decoded; it is cut "
                "off or damaged: convert it anew"
            )


def _plain(frame: np.ndarray) -> Image:
    """Grey if it is, else RGB."""
    b, g, r = (frame[..., k] for k in range(3)) if frame.ndim == 3 else (frame, frame, frame)
    if np.array_equal(b, g) and np.array_equal(g, r):
        return np.ascontiguousarray(g)
    return np.ascontiguousarray(frame[..., ::-1])
