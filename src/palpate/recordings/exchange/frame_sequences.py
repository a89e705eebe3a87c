"""Sequences of frames: multi-page TIFF, video, folder, or run.

The chain of TIFF directories is checked for loops, bounds, and length before a page is decoded, and the file
stays open because reopening it for each page is slow. The frame count in a video's header is verified
after the last frame.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol, runtime_checkable

import cv2
import numpy as np
import tifffile

from palpate.core import Closing, Frame, Image, ImageError, InputError, RangeError, new_file, storage_errors
from palpate.core.parsing import parser
from palpate.recordings.exchange.image_files import (
    IMAGE_SUFFIXES,
    MAX_PIXELS,
    TIFF_SUFFIXES,
    VIDEO_SUFFIXES,
    read_image,
    refuse_missing,
)
from palpate.recordings.manifest import MANIFEST
from palpate.recordings.run_reader import Run

MAX_PAGES = 100_000  # 83 minutes at 20 frames a second
_ORDERS = {b"II": "<", b"MM": ">"}


class TiffFrames(Closing):
    """The pages of a TIFF, all of one size and kind; use it in a `with` block, or `close` it.

    Attributes:
        shape: of every frame, ``(h, w)`` or ``(h, w, 3)``.
    """

    @parser("TIFF", ImageError, max_bytes=1 << 40)
    def __init__(self, path: Path, *, max_pages: int = MAX_PAGES) -> None:
        self.path = Path(path)
        refuse_missing(self.path)
        with storage_errors(self.path), self.path.open("rb") as file:
            self._offsets = page_offsets(file, self.path, max_pages)
        try:
            self._file = tifffile.TiffFile(self.path)
        except (tifffile.TiffFileError, ValueError, struct.error, IndexError, KeyError) as e:
            raise ImageError(f"{path} cannot be read as a TIFF ({e}); export it again") from e
        try:
            self.shape = self._checked(0).shape
        except ImageError:
            self.close()
            raise

    def __len__(self) -> int:
        return len(self._offsets)

    def __iter__(self) -> Iterator[Image]:
        return (self[i] for i in range(len(self)))

    @parser("TIFF page", ImageError)
    def __getitem__(self, index: int) -> Image:
        """Frame by its number."""
        if not 0 <= index < len(self):
            raise RangeError(
                f"{self.path} has pages 0 to {len(self) - 1}, and {index} was asked for", code="index-range"
            )
        page = self._checked(index)
        if page.shape != self.shape:
            raise ImageError(
                f"{self.path}, page {index} is {_kind(page)} and the first {_kind(self._checked(0))}; the "
                "frames of one press are of one size and kind"
            )
        with storage_errors(self.path):
            try:
                return np.ascontiguousarray(page.asarray())
            except (tifffile.TiffFileError, ValueError, RuntimeError, struct.error) as e:
                raise ImageError(f"{self.path}, page {index} is damaged ({e}); export it again") from e

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _checked(self, index: int) -> tifffile.TiffPage:
        """A page whose header says that it is 8-bit grey or RGB, and not too large."""
        page = self._file.pages[index]
        assert isinstance(page, tifffile.TiffPage)
        pixels = int(np.prod(page.shape[:2])) if len(page.shape) > 1 else 0
        if not 0 < pixels <= MAX_PIXELS:
            raise ImageError(f"{self.path}, page {index} claims {pixels} pixels; 1 to {MAX_PIXELS} are read")
        grey = len(page.shape) == 2
        if page.dtype != np.uint8 or not (grey or (len(page.shape) == 3 and page.shape[2] == 3)):
            raise ImageError(
                f"{self.path}, page {index} is {_kind(page)}; frames are 8-bit grey or RGB: convert them"
            )
        return page


def write_tiff(path: Path, frames: Iterable[Image]) -> int:
    """Write frames as the pages of a new TIFF, each as it comes; the file appears whole or not at all."""
    shapes: list[tuple[int, ...]] = []
    with new_file(path) as building, tifffile.TiffWriter(building, ome=False) as writer:
        for image in frames:
            shapes.append(Frame(image).image.shape)  # refuses what is no image
            if shapes[-1] != shapes[0]:
                raise ImageError(f"{path}: frame {len(shapes) - 1} is {shapes[-1]}, the first {shapes[0]}")
            kind = "rgb" if image.ndim == 3 else "minisblack"
            writer.write(image, photometric=kind, contiguous=False, metadata=None)
        if not shapes:
            raise ImageError(f"{path} would have no pages; give at least one frame")
    return len(shapes)


def page_offsets(file: BinaryIO, path: Path, most: int) -> list[int]:
    """Offsets of every page's directory."""
    size = file.seek(0, 2)
    file.seek(0)
    order = _ORDERS.get(file.read(2))
    magic = _number(file, order + "H", path) if order else 0
    if order is None or magic not in (42, 43):
        raise ImageError(f"{path} is no TIFF; give a multi-page TIFF", code="not-tiff")
    # classic: 4-byte offsets, 2-byte counts, 12-byte entries; BigTIFF: 8, 8 and 20
    offset_type, count_type, entry = ("I", "H", 12) if magic == 42 else ("Q", "Q", 20)
    if magic == 43:
        file.seek(8)
    offsets: list[int] = []
    visited: set[int] = set()
    offset = _number(file, order + offset_type, path)
    while offset:
        if offset in visited:
            raise ImageError(
                f"{path}: its pages run in a circle after page {len(offsets) - 1}; it is damaged",
                code="tiff-loop",
            )
        if not 0 < offset < size:
            raise ImageError(
                f"{path}: page {len(offsets)} lies outside the file; it is cut off or damaged",
                code="tiff-offset",
            )
        if len(offsets) >= most:
            raise ImageError(
                f"{path} has more than {most} pages; split the recording, or raise the limit",
                code="too-many-pages",
            )
        visited.add(offset)
        offsets.append(offset)
        file.seek(offset)
        entries = _number(file, order + count_type, path)
        file.seek(entries * entry, 1)
        offset = _number(file, order + offset_type, path)
    if not offsets:
        raise ImageError(f"{path} has no pages; export it again", code="no-pages")
    return offsets


def is_multi_page(path: Path) -> bool:
    """Whether a file is a TIFF of several pages."""
    try:
        with storage_errors(path), path.open("rb") as file:
            return len(page_offsets(file, path, MAX_PAGES)) > 1
    except ImageError:
        return False


def _number(file: BinaryIO, kind: str, path: Path) -> int:
    data = file.read(struct.calcsize(kind))
    if len(data) < struct.calcsize(kind):
        raise ImageError(
            f"{path} ends within a directory of pages; it is cut off: copy it again", code="file-truncated"
        )
    return int(struct.unpack(kind, data)[0])


def _kind(page: tifffile.TiffPage) -> str:
    return f"{' x '.join(map(str, page.shape))} of {page.dtype}"


MAX_FRAMES = 1_000_000  # nine hours at 30 frames a second


class VideoFrames:
    """The frames of a video, grey where all three channels are one.

    Attributes:
        rate_hz: frames a second, as the header says; 0 where it says nothing.
    """

    @parser("video", ImageError, max_bytes=1 << 40)
    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        refuse_missing(self.path)
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
        """The frames in order."""
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
            number = "more" if done > self._count else str(done)
            raise ImageError(
                f"{self.path}: its header says {self._count} frames, and {number} can be decoded; it is cut "
                "off or damaged: convert it anew"
            )


def _plain(frame: np.ndarray) -> Image:
    """Image in grey where all channels are one, else in RGB."""
    b, g, r = (frame[..., k] for k in range(3)) if frame.ndim == 3 else (frame, frame, frame)
    if np.array_equal(b, g) and np.array_equal(g, r):
        return np.ascontiguousarray(g)
    return np.ascontiguousarray(frame[..., ::-1])


@runtime_checkable
class FrameSequence(Protocol):
    """Images in time, which may be gone through more than once."""

    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Image]: ...


@dataclass(frozen=True)
class IndexedImages:
    """Images that are read by their index, of a run or of a folder in the order of its names."""

    count: int
    read: Callable[[int], Image]

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Image]:
        return (self.read(i) for i in range(self.count))


@contextmanager
def open_sequence(path: Path) -> Iterator[FrameSequence]:
    """Open whatever holds frames."""
    path = Path(path)
    if (path / MANIFEST).is_file():
        run = Run.open(path)
        yield IndexedImages(len(run), lambda i: run.frame(i).image)
    elif path.is_dir():
        images = tuple(sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES))
        if not images:
            raise InputError(f"{path} holds no images ({', '.join(sorted(IMAGE_SUFFIXES))}) and is not a run")
        yield IndexedImages(len(images), lambda i: read_image(images[i]))
    elif path.suffix.lower() in VIDEO_SUFFIXES:
        yield VideoFrames(path)
    elif path.suffix.lower() in TIFF_SUFFIXES:
        with TiffFrames(path) as pages:
            yield pages
    else:
        raise InputError(
            f"{path} holds no sequence of frames; give a multi-page TIFF, a folder of images, a run, or a "
            f"video ({', '.join(sorted(VIDEO_SUFFIXES))})"
        )
