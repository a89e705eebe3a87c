"""Sources of frames when sensing: one image, a folder of images, a run, a video."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from palpate.core import Frame, ImageError, InputError, PathText
from palpate.recordings.exchange.image_files import read_image
from palpate.recordings.manifest import MANIFEST

if TYPE_CHECKING:
    from palpate.recordings.exchange.frame_sequences import FrameSequence
    from palpate.recordings.run_reader import Run

VIDEO_SUFFIXES = frozenset({".avi", ".mp4", ".mov", ".mkv", ".webm"})
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"})


@runtime_checkable
class FrameStream(Protocol):
    """A finite or endless sequence of frames."""

    def __len__(self) -> int:
        """Number of frames."""

    def __iter__(self) -> Iterator[Frame]:
        """The frames in order; one that cannot be decoded has a fault and does not end the sequence."""


@dataclass(frozen=True, slots=True)
class ImageFiles:
    """Images read from files, in the order of their names; a frame's time is its place."""

    paths: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[Frame]:
        for i, path in enumerate(self.paths):
            try:
                yield Frame(read_image(path), float(i), name=path.name, index=i)
            except ImageError as e:
                yield Frame.unreadable(str(e), float(i), path.name, i)


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


@dataclass(frozen=True, slots=True)
class SequenceFrames:
    """A video's or TIFF's images as frames, named by their number; a rate of 0 Hz is not known."""

    sequence: FrameSequence
    rate_hz: float

    def __len__(self) -> int:
        return len(self.sequence)

    def __iter__(self) -> Iterator[Frame]:
        for i, image in enumerate(self.sequence):
            yield Frame(image, i / (self.rate_hz or 1.0), name=str(i), index=i)


def open_source(path: PathText) -> FrameStream:
    """Open an image, a folder of images, a run or a video."""
    path = Path(path)
    if not path.exists():
        raise ImageError(
            f"{path} is not there; give an image, a folder of images, a run or a video", code="file-missing"
        )
    if (path / MANIFEST).is_file():
        from palpate.recordings.run_reader import Run  # loads tables, which no image needs

        return RunFrames(Run.open(path))
    if path.is_dir():
        images = tuple(sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES))
        if not images:
            raise InputError(
                f"{path} holds no images ({', '.join(sorted(IMAGE_SUFFIXES))}) and is not a run",
                code="no-images",
            )
        return ImageFiles(images)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        from palpate.recordings.exchange.frame_sequences import VideoFrames  # loads tables, as above

        video = VideoFrames(path)
        return SequenceFrames(video, video.rate_hz)
    return OneImage(Frame(read_image(path), 0.0, name=path.name))
