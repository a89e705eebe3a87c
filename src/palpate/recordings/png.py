"""One image as PNG bytes, in an encoding that decodes faster than OpenCV's default and is not larger."""

from __future__ import annotations

import struct

import cv2
import numpy as np

from palpate.core.errors import ImageError
from palpate.core.shapes import Image

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
    """PNG bytes ``[n]`` of an 8-bit grey ``[h w]`` or RGB ``[h w 3]`` image.

    Raises:
        ImageError: it cannot be encoded.
    """
    rows = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".png", rows, _SETTINGS)
    if not done:
        raise ImageError(f"an image {list(image.shape)} could not be encoded as PNG")
    return np.asarray(data, np.uint8).reshape(-1)


def decode(data: np.ndarray) -> Image:
    """The 8-bit grey ``[h w]`` or RGB ``[h w 3]`` image in PNG bytes ``[n]``.

    The header is judged before anything is decoded, so a bomb costs nothing.

    Raises:
        ImageError: not a whole PNG, of another kind, or larger than `MAX_PIXELS`.
    """
    shape, read_as = _expected(data)
    try:
        image = cv2.imdecode(data, read_as)
    except cv2.error as e:
        raise ImageError(f"the PNG cannot be decoded ({e.err})") from e
    if image is None or image.shape != shape:
        raise ImageError("the PNG cannot be decoded; its data is damaged")
    return np.asarray(image, np.uint8)


def _expected(data: np.ndarray) -> tuple[tuple[int, ...], int]:
    """The shape that a PNG's header promises, and OpenCV's flag to read it so."""
    if data.size < _HEADER.size + len(_END) or data[-len(_END) :].tobytes() != _END:
        raise ImageError("the image is not a whole PNG")
    signature, length, name, width, height, depth, colour = _HEADER.unpack(data[: _HEADER.size].tobytes())
    if signature != _SIGNATURE or length != 13 or name != b"IHDR":
        raise ImageError("the image is not a PNG")
    if depth != 8 or colour not in _READ_AS:
        raise ImageError(f"the PNG is {depth}-bit of colour type {colour}; a run holds 8-bit grey or RGB")
    if not 0 < width * height <= MAX_PIXELS:
        raise ImageError(f"the PNG claims {width} x {height} pixels; 1 to {MAX_PIXELS} are read")
    return (height, width) if colour == 0 else (height, width, 3), _READ_AS[colour]
