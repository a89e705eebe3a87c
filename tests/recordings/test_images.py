"""An image file is read whole and right, or refused with its name and a remedy."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from PIL import Image

from palpate.core import ImageError
from palpate.recordings.exchange.image_files import decode, encode, opencv_image, read_image

LOSSLESS = {"PNG": {}, "BMP": {}, "TIFF": {"compression": "tiff_lzw"}, "WEBP": {"lossless": True}}
ANY = LOSSLESS | {"JPEG": {"quality": 90}}


def encoded(image: np.ndarray | Image.Image, form: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    (image if isinstance(image, Image.Image) else Image.fromarray(image)).save(buffer, form, **options)
    return buffer.getvalue()


def noise_image(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.integers(0, 256, shape, dtype=np.uint8)


def written(folder: Path, data: bytes, name: str = "touch.img") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def refused(path: Path, *words: str, **options: int) -> None:
    with pytest.raises(ImageError) as caught:
        read_image(path, **options)
    for word in (str(path), *words):
        assert word in str(caught.value)


# WebP has no grey.
@pytest.mark.parametrize(
    ("form", "shape"), [(f, (20, 30, 3)) for f in LOSSLESS] + [(f, (20, 30)) for f in ("PNG", "BMP", "TIFF")]
)
def test_a_lossless_format_gives_back_every_pixel(tmp_path, rng, form, shape):
    image = noise_image(rng, *shape)
    assert np.array_equal(read_image(written(tmp_path, encoded(image, form, **LOSSLESS[form]))), image)


def test_a_jpeg_is_read_in_rgb_order(tmp_path):
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 0] = 255
    mean = read_image(written(tmp_path, encoded(red, "JPEG", quality=95))).mean(axis=(0, 1))
    assert np.allclose(mean, [255, 0, 0], atol=3)  # JPEG rounds in YCbCr: a level or two


@pytest.mark.parametrize("form", ANY)
def test_an_image_cut_anywhere_is_refused_and_never_filled_in(tmp_path, rng, capfd, form):
    data = encoded(noise_image(rng, 24, 24, 3), form, **ANY[form])
    for length in [*range(1, len(data), 31), len(data) - 1]:
        refused(written(tmp_path, data[:length]))
    assert capfd.readouterr() == ("", "")


def test_a_flipped_byte_in_a_png_is_refused(tmp_path, rng):
    data = bytearray(encoded(noise_image(rng, 16, 16), "PNG"))
    for at in range(8, len(data), 23):
        damaged = bytes(data[:at]) + bytes([data[at] ^ 0x40]) + bytes(data[at + 1 :])
        refused(written(tmp_path, damaged))


SIGNATURES = [b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"II*\0", b"MM\0*", b"RIFF....WEBP", b""]


@settings(max_examples=40)
@given(head=st.sampled_from(SIGNATURES), body=st.binary(max_size=200))
def test_any_bytes_give_an_image_or_an_image_error(tmp_path_factory, head, body):
    path = tmp_path_factory.mktemp("fuzz") / "any"
    path.write_bytes(head + body)
    try:
        assert read_image(path, max_pixels=10_000).dtype == np.uint8
    except ImageError as e:
        assert str(path) in str(e)  # noqa: PT017 -- either outcome is right


@pytest.mark.parametrize(("form", "dtype"), [("PNG", np.uint16), ("TIFF", np.uint16), ("TIFF", np.float32)])
def test_more_than_eight_bits_are_refused(tmp_path, form, dtype):
    refused(written(tmp_path, encoded(np.zeros((4, 4), dtype), form)), "8 bits", "scale")


def test_sixteen_bit_colour_is_refused_though_the_decoder_would_halve_it(tmp_path):
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 2, 2, 16, 2, 0, 0, 0))
    pixels = chunk(b"IDAT", zlib.compress(b"\0" * (2 * (1 + 12))))
    refused(written(tmp_path, b"\x89PNG\r\n\x1a\n" + header + pixels + chunk(b"IEND", b"")), "8 bits")


def test_cmyk_is_refused(tmp_path):
    refused(written(tmp_path, encoded(Image.new("CMYK", (4, 4)), "JPEG")), "CMYK", "convert it to RGB")


@pytest.mark.parametrize(
    ("form", "mode"), [("PNG", "RGBA"), ("PNG", "LA"), ("TIFF", "RGBA"), ("WEBP", "RGBA")]
)
def test_transparency_is_refused(tmp_path, form, mode):
    image = Image.new(mode, (4, 4), (1, 2, 3, 4)[: len(mode)])
    refused(written(tmp_path, encoded(image, form)), "transparency", "flatten")


@pytest.mark.parametrize("form", ["PNG", "TIFF", "WEBP"])
def test_several_pages_are_refused(tmp_path, rng, form):
    pages = [Image.fromarray(noise_image(rng, 8, 8, 3)) for _ in range(3)]
    data = encoded(pages[0], form, save_all=True, append_images=pages[1:])
    refused(written(tmp_path, data), "several pages", "save each page")


def test_a_bomb_is_refused_by_its_header_alone(tmp_path):
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0))
    data = b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", b"never decoded") + chunk(b"IEND", b"")
    refused(written(tmp_path, data), "60000 × 60000 px", "max_pixels")


def test_what_is_no_image_is_refused_by_content_whatever_its_name(tmp_path):
    refused(written(tmp_path, b"%PDF-1.7 and so on", "touch.png"), "no PNG, JPEG, BMP, TIFF or WebP")
    refused(written(tmp_path, encoded(Image.new("L", (4, 4)), "GIF"), "touch2.png"), "save it as PNG")


def test_missing_empty_and_folder_are_each_named(tmp_path):
    refused(tmp_path / "gone.png", "not there")
    refused(written(tmp_path, b""), "0 bytes")
    refused(tmp_path, "folder")


def test_a_png_whose_chunk_claims_more_than_the_file_holds_allocates_none_of_it(rng):
    data = encode(rng.integers(0, 256, (24, 32), np.uint8))
    data[33:37] = 255  # length of the first chunk after the header: 4 GB
    before = peak_bytes()
    with pytest.raises(ImageError):
        decode(data)
    assert opencv_image(data, cv2.IMREAD_GRAYSCALE) is None
    assert peak_bytes() - before < 100e6


def peak_bytes() -> int:
    if not Path("/proc/self/status").is_file():
        pytest.skip("peak memory is read from /proc")
    line = next(one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmHWM"))
    return 1024 * int(line.split()[1])
