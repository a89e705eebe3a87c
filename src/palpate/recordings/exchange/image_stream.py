"""Images in a stream of bytes: JPEG and PNG files one after the other, or MJPEG with whatever lies between.

A JPEG is followed marker by marker (ITU-T T.81, annex B), since the thumbnail inside one has an end of its
own; a PNG chunk by chunk. What lies between two images, such as a multipart answer's headers, is skipped.
"""

from __future__ import annotations

from collections.abc import Iterator

from palpate.core import ImageError

MAX_IMAGE_BYTES = 64 << 20
_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"  # with its checksum
_JPEG = b"\xff\xd8\xff"
_SCAN, _END = 0xDA, 0xD9
MIN_MARKER = 0xC0
_BARE = frozenset({0x01, 0xD8, *range(0xD0, 0xD8)})  # markers without a length


class ImageCutter:
    """Cuts a stream of bytes into image files; holds no more than one of them."""

    def __init__(self) -> None:
        self._held = bytearray()

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Each image file that is whole now; of a PNG that was cut short its first bytes, which are none."""
        self._held += data
        while True:
            self._skip_to_image()
            length = _length(self._held)
            if length is None:
                if len(self._held) > MAX_IMAGE_BYTES:
                    self._held.clear()
                    raise ImageError(f"an image of more than {MAX_IMAGE_BYTES} bytes in the stream; skipped")
                return
            if length == 0:  # began like an image and is none
                begun = bytes(self._held[: len(_PNG)])
                del self._held[0]
                if begun == _PNG:  # eight bytes that nothing else begins with: one that was cut short
                    yield begun
                continue
            image = bytes(self._held[:length])
            del self._held[:length]
            yield image

    def _skip_to_image(self) -> None:
        starts = [at for at in (self._held.find(_PNG), self._held.find(_JPEG)) if at >= 0]
        if starts:
            del self._held[: min(starts)]
        elif len(self._held) >= len(_PNG):  # what is kept may be the beginning of one
            del self._held[: 1 - len(_PNG)]


def _length(data: bytearray) -> int | None:
    """Length of the image file at the beginning; None where its end is not there yet, 0 where it is none."""
    if data.startswith(_PNG):
        return _png_length(data)
    return _jpeg_length(data) if data.startswith(_JPEG) else None


def _png_length(data: bytearray) -> int | None:
    at = len(_PNG)
    while len(data) >= at + 12:
        size, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        if not kind.isalpha() or size > MAX_IMAGE_BYTES:
            return 0
        at += 12 + size
        if kind == b"IEND":
            if len(data) < at:
                return None
            return at if data.startswith(_PNG_END, at - len(_PNG_END)) else 0
    return None


def _jpeg_length(data: bytearray) -> int | None:
    at = 2
    while len(data) >= at + 4:
        marker = data[at + 1]
        if data[at] != 0xFF or (marker < MIN_MARKER and marker not in _BARE):
            return 0
        if marker == 0xFF:  # fill
            at += 1
        elif marker == _END:
            return at + 2
        elif marker in _BARE:
            at += 2
        else:
            size = int.from_bytes(data[at + 2 : at + 4], "big")
            if size < 2:
                return 0
            at += 2 + size
            if marker == _SCAN:
                after = _scan_end(data, at)
                if after is None:
                    return None
                at = after
    ended = len(data) >= at + 2 and data[at] == 0xFF and data[at + 1] == _END
    return at + 2 if ended else None


def _scan_end(data: bytearray, at: int) -> int | None:
    """Place of the marker that ends a scan: the first that is neither a stuffed byte nor a restart."""
    while (at := data.find(0xFF, at)) >= 0 and at + 1 < len(data):
        if data[at + 1] == 0 or 0xD0 <= data[at + 1] <= 0xD7:
            at += 2
        else:
            return at
    return None
