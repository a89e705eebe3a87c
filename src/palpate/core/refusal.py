"""Reason why a reading is not valid: a code for programs, a sentence for people."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class ImageCode(StrEnum):
    """Codes of invalid readings of a calibration of images."""

    UNREADABLE = "unreadable_frame"
    IMAGE_SIZE = "image_size"
    GRAY_IMAGE = "gray_image"
    NO_REFERENCE_IMAGE = "no_reference_image"
    OUT_OF_DISTRIBUTION = "out_of_distribution"
    FORMER_UNIT = "former_unit"
    NOT_LEARNED = "not_learned"
    UNDETERMINED = "undetermined"
    OUTSIDE_RANGE = "outside_range"
    INTERVAL_OUTSIDE_RANGE = "interval_outside_range"
    NO_CLASS = "no_class"
    ALL_CLASSES = "all_classes"
    CLASS_NOT_IN_SET = "class_not_in_set"


OF_ALL_FRAMES = frozenset({ImageCode.IMAGE_SIZE, ImageCode.NO_REFERENCE_IMAGE})
"""Codes that hold for every frame of a source alike until the source or the reference image changes."""


class Refusal(NamedTuple):
    """Reason of an invalid reading; false where there is none.

    Attributes:
        code: machine-readable, such as ``camera_moved``.
        why: the same in words.
    """

    code: str = ""
    why: str = ""

    def __bool__(self) -> bool:
        return bool(self.code)


NONE = Refusal()
