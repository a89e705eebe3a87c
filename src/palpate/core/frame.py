"""A Frame: one image from one camera at one time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from html import escape
from time import monotonic_ns

import numpy as np

from palpate.core.errors import ImageError
from palpate.core.shapes import Image


@dataclass(frozen=True, slots=True, repr=False)
class Frame:
    """One image, when it was taken and by what.

    Attributes:
        image: 8-bit grey ``[h w]`` or RGB ``[h w 3]``; row 0 is the top, column 0 the left.
        time_s: capture time on the run's clock [s].
        exposure_s: exposure [s]; None where the camera did not say.
        sensor: which sensor the image is of, e.g. its serial number.
        name: what the frame is called at the edges: a file's name, or its index in a run.
        index: number of the frame in its source, from 0.
        arrived_ns: arrival on the host's monotonic clock [ns]; 0 for a stored frame.
        lost: number of frames that the source lost before it.
        fault: reason why the frame could not be decoded; empty otherwise. Its image is then blank.
    """

    image: Image
    time_s: float = 0.0
    exposure_s: float | None = None
    sensor: str = ""
    name: str = ""
    index: int = 0
    arrived_ns: int = 0
    lost: int = 0
    fault: str = ""

    @classmethod
    def unreadable(cls, fault: str, time_s: float, name: str, index: int = 0) -> Frame:
        """Return a blank frame in place of one that could not be decoded."""
        return cls(np.zeros((1, 1), np.uint8), time_s, name=name, index=index, fault=fault)

    def arrived(self, index: int, at_ns: int | None = None, lost: int = 0) -> Frame:
        """Return this frame as the next of a live source; arrival is now unless stated [ns]."""
        return replace(self, index=index, arrived_ns=monotonic_ns() if at_ns is None else at_ns, lost=lost)

    def __post_init__(self) -> None:
        image = self.image
        if image.dtype != np.uint8 or image.ndim not in (2, 3) or 0 in image.shape:
            raise ImageError(
                f"a Frame holds 8-bit [h w] or [h w 3], got {image.dtype} {list(image.shape)}; "
                "scale or convert the image first"
            )
        if image.ndim == 3 and image.shape[2] != 3:
            raise ImageError(
                f"a colour Frame has 3 channels in RGB order, got {image.shape[2]}", code="image-channels"
            )

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        kind = "grey" if self.image.ndim == 2 else "RGB"
        of = f" of {self.sensor}" if self.sensor else ""
        return (
            f"<Frame {self.name or 'without a name'}{of}: {width} × {height} px, {kind}, {self.time_s:.3f} s>"
        )

    def _repr_html_(self) -> str:
        return f"<code>{escape(repr(self))}</code>"
