"""Frames of files: an image, a folder of images, a run, a video, a TIFF."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.core import Closing, ForceSensor, Frame, ImageError, InputError, PathText, RecordingError
from palpate.recordings.exchange.image_files import IMAGE_SUFFIXES, TIFF_SUFFIXES, VIDEO_SUFFIXES, read_image
from palpate.recordings.manifest import MANIFEST

if TYPE_CHECKING:
    from palpate.recordings.exchange.frame_sequences import FrameSequence
    from palpate.recordings.run_reader import Run


class FileFrames(Closing):
    """Frames of a complete source, a `LiveSource` that can also be iterated, any number of times.

    A frame that cannot be decoded has a fault and does not end the sequence.

    Attributes:
        run: Run that is read, with its manifest; None for images and videos.
        clocked: Whether frame times are those of a clock; they are frame indices otherwise.
        may_change: Whether frame sizes may differ, as in a folder.
    """

    waits = True
    force: ForceSensor | None = None

    def __init__(
        self,
        name: str,
        frames: Callable[[], Iterator[Frame]],
        count: int,
        *,
        run: Run | None = None,
        clocked: bool = True,
        may_change: bool = False,
        let_go: Callable[[], None] = lambda: None,
    ) -> None:
        self.name, self.run, self.clocked, self.may_change = name, run, clocked, may_change
        self.manifest = None if run is None else run.manifest
        self._frames, self._count, self._let_go = frames, count, let_go
        self._rest: Iterator[Frame] | None = None
        self._grabbed = 0

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Frame]:
        return self._frames()

    def grab(self, timeout_s: float) -> Frame | None:
        """The next frame; None at the end. A frame is read in less time than any time-out is worth."""
        if self._rest is None:
            self._rest = iter(self)
        index, self._grabbed = self._grabbed, self._grabbed + 1
        try:
            frame = next(self._rest, None)
        except RecordingError as e:
            frame = Frame.unreadable(str(e), 0.0, str(index))
        return None if frame is None else frame.arrived(index)

    @property
    def unfinished(self) -> str:
        """Reason why a run is incomplete; empty otherwise."""
        if self.run is None:
            return ""
        from palpate.sensing.streaming.replayed_frames import unfinished

        return unfinished(self.run.path)

    def close(self) -> None:
        """Close the file."""
        self._rest = iter(())
        self._let_go()


def image_files(paths: Sequence[Path], name: str = "") -> FileFrames:
    """Return the images of files, in their order; a frame's time is its index."""

    def frames() -> Iterator[Frame]:
        for i, path in enumerate(paths):
            try:
                yield Frame(read_image(path), float(i), name=path.name, index=i)
            except ImageError as e:
                yield Frame.unreadable(str(e), float(i), path.name, i)

    return FileFrames(name, frames, len(paths), clocked=False, may_change=True)


def run_frames(run: Run) -> FileFrames:
    """Return the frames of a recorded run."""
    return FileFrames(str(run.path), lambda: map(run.frame, range(len(run))), len(run), run=run)


def _sequence_frames(
    path: Path, sequence: FrameSequence, rate_hz: float = 0.0, let_go: Callable[[], None] = lambda: None
) -> FileFrames:
    """Images of a video or TIFF as frames, named by their number; a rate of 0 Hz is not known."""

    def frames() -> Iterator[Frame]:
        for i, image in enumerate(sequence):
            yield Frame(image, i / (rate_hz or 1.0), name=str(i), index=i)

    return FileFrames(str(path), frames, len(sequence), clocked=rate_hz > 0, let_go=let_go)


def open_source(path: PathText) -> FileFrames:
    """Open an image, a folder of images, a run, a video, or a multi-page TIFF."""
    path = Path(path)
    if not path.exists():
        raise ImageError(
            f"{path} is not there; give an image, a folder of images, a run or a video", code="file-missing"
        )
    if (path / MANIFEST).is_file():
        from palpate.recordings.run_reader import Run  # loads tables, which no image needs

        return run_frames(Run.open(path))
    if path.is_dir():
        images = sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        if not images:
            raise InputError(
                f"{path} holds no images ({', '.join(sorted(IMAGE_SUFFIXES))}) and is not a run",
                code="no-images",
            )
        return image_files(images, str(path))
    if path.suffix.lower() in VIDEO_SUFFIXES:
        from palpate.recordings.exchange.frame_sequences import VideoFrames  # loads tables, as above

        video = VideoFrames(path)
        return _sequence_frames(path, video, video.rate_hz)
    if path.suffix.lower() in TIFF_SUFFIXES:
        from palpate.recordings.exchange.frame_sequences import TiffFrames, is_multi_page

        if is_multi_page(path):
            pages = TiffFrames(path)
            return _sequence_frames(path, pages, let_go=pages.close)
    image = Frame(read_image(path), name=path.name)  # read now, so that a file without an image is refused
    return FileFrames(str(path), lambda: iter((image,)), 1)
