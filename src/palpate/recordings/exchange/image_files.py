"""Image files: PNG written in an encoding that decodes fast, and single images of others read.

Reading has an allow-list of formats, and everything is checked. The encoding decodes faster than OpenCV's
default and is not larger.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from PIL import ImageOps
from PIL.BmpImagePlugin import BmpImageFile
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import BITSPERSAMPLE, SAMPLEFORMAT, TiffImageFile
from PIL.WebPImagePlugin import WebPImageFile

from palpate.core import Image, ImageError, PathText, storage_errors
from palpate.core.parsing import parser

MAX_PIXELS = 100_000_000  # beyond any touch camera; a header that claims more is an attack or damage

# Rows predicted from the row above decode faster than OpenCV's default prediction from the left, because
# whole rows add at once; run lengths suit what is left; one large buffer spares a header every 8 KiB.
# benchmarks/recordings/frames.py measures all of it.
_SETTINGS = [
    cv2.IMWRITE_PNG_COMPRESSION, 1,
    cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE,
    cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP,
    cv2.IMWRITE_PNG_ZLIBBUFFER_SIZE, 1 << 20,
]  # fmt: skip
_HEADER = struct.Struct(">8sI4sIIBB")
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END = b"\0\0\0\0IEND\xaeB`\x82"
_READ_AS = {0: cv2.IMREAD_GRAYSCALE, 2: cv2.IMREAD_COLOR_RGB}  # by PNG's colour type


def encode(image: Image) -> np.ndarray:
    """PNG bytes ``[n]`` of an 8-bit grey ``[h w]`` or RGB ``[h w 3]`` image."""
    rows = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".png", rows, _SETTINGS)
    if not done:
        raise ImageError(f"an image {list(image.shape)} could not be encoded as PNG")
    return np.asarray(data, np.uint8).reshape(-1)


@parser("PNG bytes", ImageError)
def decode(data: np.ndarray) -> Image:
    """The 8-bit grey ``[h w]`` or RGB ``[h w 3]`` image in PNG bytes ``[n]``.

    The header is judged before anything is decoded, so a bomb costs nothing.
    """
    shape, read_as = _expected(data)
    image = _decoded(data, read_as)
    if image is None or image.shape != shape:
        raise ImageError("the PNG cannot be decoded; its data is damaged")
    return np.asarray(image, np.uint8)


def opencv_image(data: np.ndarray, flags: int) -> np.ndarray | None:
    """Decode the bytes ``[n]`` of an image file by OpenCV; None where it cannot, or above `MAX_PIXELS`.

    Pixels are those that OpenCV makes of a file; `image_from_bytes` makes them with Pillow.
    """
    content = data.tobytes()
    try:
        with _decoder(Path("image"), content)(BytesIO(content)) as header:
            width, height = header.size
    except Exception:  # as in `_damage_explained`
        return None
    return _decoded(data, flags) if 0 < width * height <= MAX_PIXELS else None


def _decoded(data: np.ndarray, flags: int) -> np.ndarray | None:
    """OpenCV allocates what a PNG's chunk claims before it reads it: none may end beyond the file."""
    if data[:8].tobytes() == _SIGNATURE and not _chunks_fit(data):
        return None
    try:
        return cv2.imdecode(data, flags)
    except cv2.error:
        return None


def _chunks_fit(data: np.ndarray) -> bool:
    """Whether each chunk of a PNG, up to its end, lies within the file."""
    at, head = len(_SIGNATURE), struct.Struct(">I4s")
    while at + head.size <= data.size:
        length, name = head.unpack(data[at : at + head.size].tobytes())
        at += 12 + length  # with the length itself, the name, and the checksum
        if at > data.size or name == b"IEND":
            break
    return bool(at <= data.size)


def _expected(data: np.ndarray) -> tuple[tuple[int, ...], int]:
    """The shape that a PNG's header promises, and OpenCV's flag to read it so."""
    if data.size < _HEADER.size + len(_END) or data[-len(_END) :].tobytes() != _END:
        raise ImageError("the image is not a whole PNG")
    signature, length, name, width, height, depth, colour = _HEADER.unpack(data[: _HEADER.size].tobytes())
    if signature != _SIGNATURE or length != 13 or name != b"IHDR":
        raise ImageError("the image is not a PNG")
    if depth != 8 or colour not in _READ_AS:
        raise ImageError(
            f"the PNG is {depth}-bit of colour type {colour}; a run holds 8-bit grey or RGB",
            code="pixel-format",
        )
    if not 0 < width * height <= MAX_PIXELS:
        raise ImageError(f"a PNG of {width} x {height} px; 1 to {MAX_PIXELS} are read", code="image-size")
    return (height, width) if colour == 0 else (height, width, 3), _READ_AS[colour]


# The decoders are named one by one, because Pillow's own `open` would try every format it knows.
_FORMATS: tuple[tuple[int, bytes, type[ImageFile]], ...] = (
    (0, b"\x89PNG\r\n\x1a\n", PngImageFile),
    (0, b"\xff\xd8\xff", JpegImageFile),
    (0, b"BM", BmpImageFile),
    (0, b"II*\0", TiffImageFile),
    (0, b"MM\0*", TiffImageFile),
    (8, b"WEBP", WebPImageFile),
)
TIFF_SUFFIXES = frozenset({".tif", ".tiff"})
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".webp"}) | TIFF_SUFFIXES
VIDEO_SUFFIXES = frozenset({".avi", ".mp4", ".mov", ".mkv", ".webm"})
_GREY = ("1", "L")
_COLOUR = ("RGB", "P", "YCbCr")
_ALPHA = ("LA", "La", "PA", "RGBA", "RGBa", "RGBX")
_HEADER_BYTES = 1 << 20
_BYTES_PER_PIXEL = 8


@parser("image", ImageError, max_bytes=1 << 30)
def read_image(path: PathText, *, max_pixels: int = 100_000_000) -> Image:
    """Read one PNG, JPEG, BMP, single-page TIFF or WebP file, recognised by content and not by name.

    An orientation noted by the camera is applied, so that rows and columns are those a person sees.
    Damage inside a JPEG's or BMP's pixels cannot be told from content: those formats carry no checksum.

    Args:
        max_pixels: largest image that is decoded; the header is asked before any pixel is.

    Returns:
        8-bit grey ``[h w]``, or RGB ``[h w 3]``.
    """
    path = Path(path)
    return image_from_bytes(
        _read_bytes(path, _HEADER_BYTES + _BYTES_PER_PIXEL * max_pixels), path, max_pixels=max_pixels
    )


@parser("image bytes", ImageError, max_bytes=1 << 40)
def image_from_bytes(data: bytes, path: Path, *, max_pixels: int = MAX_PIXELS) -> Image:
    """Image in the bytes of an image file, as `read_image` reads it.

    Args:
        path: what the file is called where it cannot be read.
    """
    decoder = _decoder(path, data)
    with _damage_explained(path):
        image = decoder(BytesIO(data))
    _check_size(path, image, max_pixels)
    _check_kind(path, image, data)
    with _damage_explained(path):
        _check_complete(decoder, data)
        image.load()
        upright = ImageOps.exif_transpose(image)
        return np.array(upright.convert("L" if image.mode in _GREY else "RGB"))


def refuse_missing(path: Path) -> None:
    """Raise an `ImageError` where there is no plain file."""
    if not path.is_file():
        raise ImageError(f"{path} is not there (or no plain file); check the name and the folder")


def _read_bytes(path: Path, most: int) -> bytes:
    if path.is_dir():
        raise ImageError(f"{path} is a folder, not an image; name a file in it")
    refuse_missing(path)
    with storage_errors(path):
        size = path.stat().st_size
        if size == 0:
            raise ImageError(f"{path} is empty (0 bytes); copy or record it again")
        if size > most:
            raise ImageError(
                f"{path} has {size} bytes, more than an image may have ({most}); make it smaller"
            )
        return path.read_bytes()


def _decoder(path: Path, data: bytes) -> type[ImageFile]:
    for offset, signature, decoder in _FORMATS:
        if data[offset:].startswith(signature):
            return decoder
    raise ImageError(
        f"{path} is no PNG, JPEG, BMP, TIFF or WebP image (it begins with {data[:8]!r}); "
        "save it as PNG, give another file, or leave this one out",
        code="image-format",
    )


@contextmanager
def _damage_explained(path: Path) -> Iterator[None]:
    # A decoder fed with damaged bytes may raise anything, so anything is what is caught.
    try:
        yield
    except Exception as e:
        if "unknown pixel mode" in str(e):  # Pillow's words of floating-point colour, and of other rare kinds
            raise ImageError(
                f"{path} has pixels of a kind that is not read, such as floating-point colour; scale all "
                "images alike to unsigned 8 bits first",
                code="pixel-format",
            ) from e
        raise ImageError(
            f"{path} is damaged or cut short ({type(e).__name__}: {e}); copy it again from where it came, "
            "or remove it together with its row"
        ) from e


def _check_size(path: Path, image: ImageFile, max_pixels: int) -> None:
    width, height = image.size
    if width < 1 or height < 1:
        raise ImageError(f"{path} is {width} × {height} px; an image has at least one pixel: record it again")
    if width * height > max_pixels:
        raise ImageError(
            f"{path} claims {width} × {height} px, more than the {max_pixels} pixels that are decoded; "
            "make it smaller, or raise max_pixels if it is really that large"
        )


def _check_kind(path: Path, image: ImageFile, data: bytes) -> None:
    if image.mode == "CMYK":
        raise ImageError(f"{path} is CMYK, an ink image; convert it to RGB or grey first")
    if _is_deep(image, data):
        raise ImageError(
            f"{path} has more than 8 bits a channel, or signed or floating-point pixels; "
            "scale all images alike to unsigned 8 bits first"
        )
    if image.mode in _ALPHA or "transparency" in image.info:
        raise ImageError(f"{path} has a transparency (alpha) channel; flatten it onto a background first")
    if image.mode not in _GREY + _COLOUR:
        raise ImageError(f"{path} has pixels of kind {image.mode}; convert it to RGB or grey first")
    if _has_more_pages(path, type(image), data):
        raise ImageError(
            f"{path} is animated or has several pages; save each page as an image of its own, with its own "
            f"row"
        )


def _is_deep(image: ImageFile, data: bytes) -> bool:
    # The mode does not tell: Pillow reads 16-bit colour as 8-bit by dropping half of it.
    if isinstance(image, PngImageFile):
        return data[24] > 8  # the bit depth in IHDR, always the first chunk
    if isinstance(image, TiffImageFile):
        bits, kinds = image.tag_v2.get(BITSPERSAMPLE, (1,)), image.tag_v2.get(SAMPLEFORMAT, (1,))
        return max(bits) > 8 or set(kinds) != {1}
    return image.mode.startswith(("I", "F"))


def _has_more_pages(path: Path, decoder: type[ImageFile], data: bytes) -> bool:
    # Whether there is a second page; counting all would walk a chain of any length.
    with _damage_explained(path):
        try:
            decoder(BytesIO(data)).seek(1)
        except EOFError:
            return False
        return True


def _check_complete(decoder: type[ImageFile], data: bytes) -> None:
    if decoder is PngImageFile:
        _check_png(data)
    if decoder is JpegImageFile and data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda"):
        raise ValueError("no end marker after the last scan")


def _check_png(data: bytes) -> None:
    """Walk the chunks to the closing one; Pillow neither compares every checksum nor asks for the end."""
    at, kind = 8, b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, at)
        (checksum,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(data[at + 4 : at + 8 + length]) != checksum:
            raise ValueError(f"checksum of chunk {kind.decode('latin-1')} at byte {at} is wrong")
        at += 12 + length
