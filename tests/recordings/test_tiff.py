"""Multi-page TIFFs: frames as they were written, and every kind of chain that is none."""

import struct

import numpy as np
import pytest
import tifffile
from tests.refusals import refused

from palpate.core.errors import ImageError, RangeError
from palpate.recordings.exchange.frame_sequences import TiffFrames


@pytest.fixture
def frames(rng) -> np.ndarray:
    return rng.integers(0, 256, (7, 30, 40), dtype=np.uint8)


@pytest.mark.parametrize("how", [{}, {"bigtiff": True}, {"byteorder": ">"}, {"compression": "zlib"}])
def test_pages_come_back_as_they_were_written(tmp_path, frames, how) -> None:
    path = tmp_path / "press.tif"
    options = {name: how[name] for name in how if name in ("bigtiff", "byteorder")}
    with tifffile.TiffWriter(path, **options) as writer:
        for frame in frames:
            writer.write(frame, contiguous=False, compression=how.get("compression"))
    with TiffFrames(path) as read:
        assert len(read) == 7
        assert read.shape == (30, 40)
        np.testing.assert_array_equal(np.stack(list(read)), frames)
        np.testing.assert_array_equal(read[3], frames[3])
        with refused("index-range", RangeError):
            read[7]


def classic(pages: list[int]) -> bytes:
    """Empty directories at 8, 14, 20, ... of which each names the next one's offset as given."""
    return struct.pack("<2sHI", b"II", 42, 8) + b"".join(struct.pack("<HI", 0, after) for after in pages)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (classic([14, 8]), "tiff-loop"),
        (classic([8]), "tiff-loop"),
        (classic([14, 9999]), "tiff-offset"),
        (classic([14 + 6 * i for i in range(300)] + [0]), "too-many-pages"),
        (struct.pack("<2sHI", b"II", 42, 0), "no-pages"),
        (struct.pack("<2sHI", b"II", 42, 8) + b"\xff\xff", "file-truncated"),
        (b"II*", "file-truncated"),
        (b"\x89PNG....", "not-tiff"),
        (b"", "not-tiff"),
    ],
)
def test_a_chain_of_pages_that_is_no_recording_is_refused_at_once(tmp_path, data, said) -> None:
    path = tmp_path / "bad.tif"
    path.write_bytes(data)
    with refused(said, ImageError):
        TiffFrames(path, max_pages=100)


def test_pages_of_different_sizes_or_depths_are_refused(tmp_path, frames) -> None:
    with tifffile.TiffWriter(tmp_path / "two.tif") as writer:
        writer.write(frames[0])
        writer.write(frames[1, :20])
    with TiffFrames(tmp_path / "two.tif") as read, pytest.raises(ImageError, match="one size"):
        list(read)
    tifffile.imwrite(tmp_path / "deep.tif", frames.astype(np.uint16))
    with pytest.raises(ImageError, match="uint16"):
        TiffFrames(tmp_path / "deep.tif")


def test_a_page_that_claims_more_pixels_than_any_camera_is_not_decoded(tmp_path, frames) -> None:
    path = tmp_path / "huge.tif"
    tifffile.imwrite(path, frames[0])
    with tifffile.TiffFile(path, mode="r+b") as file:
        file.pages[0].tags["ImageWidth"].overwrite(60_000)
        file.pages[0].tags["ImageLength"].overwrite(60_000)
    with pytest.raises(ImageError, match="pixels"):
        TiffFrames(path)


def test_a_file_that_is_cut_off_names_its_page(tmp_path, frames) -> None:
    path = tmp_path / "cut.tif"
    with tifffile.TiffWriter(path) as writer:
        for frame in frames:
            writer.write(frame, contiguous=False)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ImageError, match="cut off"), TiffFrames(path) as read:
        list(read)
