"""Frames one after the other, whatever they are stored as: a multi-page TIFF, a video, a folder, a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from palpate.core.errors import InputError
from palpate.core.shapes import Image
from palpate.recordings.images import read_image
from palpate.recordings.manifest import MANIFEST
from palpate.recordings.reader import Run
from palpate.recordings.tiff import TiffFrames
from palpate.recordings.video import SUFFIXES as VIDEOS
from palpate.recordings.video import VideoFrames

TIFFS = frozenset({".tif", ".tiff"})
IMAGES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".webp", *TIFFS})


@runtime_checkable
class Sequence(Protocol):
    """Images in time, which may be gone through more than once."""

    def __len__(self) -> int:
        """How many there are."""
        ...

    def __iter__(self) -> Iterator[Image]:
        """Each in turn."""
        ...


@dataclass(frozen=True)
class ImageFolder:
    """The images of a folder, in the order of their names."""

    paths: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[Image]:
        return (read_image(path) for path in self.paths)


@dataclass(frozen=True)
class RunImages:
    """The images of a run."""

    run: Run

    def __len__(self) -> int:
        return len(self.run)

    def __iter__(self) -> Iterator[Image]:
        return (frame.image for frame in self.run.frames())


@contextmanager
def open_sequence(path: Path) -> Iterator[Sequence]:
    """Open whatever holds frames.

    Raises:
        InputError: nothing that does.
        ImageError: it cannot be read.
        RecordingError: a damaged run.
    """
    path = Path(path)
    if (path / MANIFEST).is_file():
        yield RunImages(Run.open(path))
    elif path.is_dir():
        found = tuple(sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGES))
        if not found:
            raise InputError(f"{path} holds no images ({', '.join(sorted(IMAGES))}) and is not a run")
        yield ImageFolder(found)
    elif path.suffix.lower() in VIDEOS:
        yield VideoFrames(path)
    elif path.suffix.lower() in TIFFS:
        with TiffFrames(path) as pages:
            yield pages
    else:
        raise InputError(
            f"{path} holds no sequence of frames; give a multi-page TIFF, a folder of images, a run, or a "
            f"video ({', '.join(sorted(VIDEOS))})"
        )
