"""Sources of frames when sensing: one image, a folder of images, a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from palpate.core import Frame, ImageError, InputError, PathText
from palpate.recordings.exchange.image_files import read_image
from palpate.recordings.manifest import MANIFEST

if TYPE_CHECKING:
    from palpate.recordings.run_reader import Run

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"})


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A frame that could not be opened, and why."""

    name: str
    time_s: float
    why: str


@runtime_checkable
class FrameStream(Protocol):
    """A finite or endless sequence of frames."""

    def __len__(self) -> int:
        """Number of frames."""

    def __iter__(self) -> Iterator[Frame | Unreadable]:
        """The frames in order; one that cannot be opened says why and does not end the sequence."""


@dataclass(frozen=True, slots=True)
class ImageFiles:
    """Images read from files, in the order of their names; a frame's time is its place."""

    paths: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[Frame | Unreadable]:
        for i, path in enumerate(self.paths):
            try:
                yield Frame(read_image(path), float(i), name=path.name)
            except ImageError as e:
                yield Unreadable(path.name, float(i), str(e))


@dataclass(frozen=True, slots=True)
class OneImage:
    """A single image, read when it was opened, as what is no image is then refused."""

    frame: Frame

    def __len__(self) -> int:
        return 1

    def __iter__(self) -> Iterator[Frame]:
        yield self.frame


@dataclass(frozen=True, slots=True)
class RunFrames:
    """The frames of a recorded run."""

    run: Run

    def __len__(self) -> int:
        return len(self.run)

    def __iter__(self) -> Iterator[Frame]:
        return self.run.frames()


def open_source(path: PathText) -> FrameStream:
    """Open an image, a folder of images or a run.

    Raises:
        InputError: there is nothing to sense there.
        ImageError: it is one image, and cannot be read; or nothing is there.
    """
    path = Path(path)
    if not path.exists():
        raise ImageError(f"{path} is not there; give an image, a folder of images or a run")
    if (path / MANIFEST).is_file():
        from palpate.recordings.run_reader import Run  # loads tables, which no image needs

        return RunFrames(Run.open(path))
    if path.is_dir():
        images = tuple(sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES))
        if not images:
            raise InputError(f"{path} holds no images ({', '.join(sorted(IMAGE_SUFFIXES))}) and is not a run")
        return ImageFiles(images)
    return OneImage(Frame(read_image(path), 0.0, name=path.name))
