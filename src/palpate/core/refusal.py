"""Reason why a reading is not valid: a code for programs, a sentence for people."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple


class ReasonCode(StrEnum):
    """Codes of invalid readings in JSON; the last ones are of presses on an object."""

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
    FLAWED_PRESS = "flawed_press"
    DRIFTED = "drifted"
    SPEED = "speed_outside_range"
    REPEATED_FRAMES = "repeated_frames"
    OFF_CENTER = "off_center"
    CUES_DISAGREE = "cues_disagree"
    TWO_REFERENCES = "two_references"
    CURVED = "curved_object"
    TOO_STIFF = "too_stiff"
    INCLINED = "inclined"
    NOT_HERTZ = "not_hertz"
    SHAPE_OUTSIDE_RANGE = "shape_outside_range"


OF_ALL_FRAMES = frozenset({ReasonCode.IMAGE_SIZE, ReasonCode.NO_REFERENCE_IMAGE})
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
SEPARATOR = "; "  # between the reasons of one reading


def joined(reasons: Iterable[Refusal]) -> dict[str, str | bool]:
    """Return the fields `valid`, `why`, and `code` of a reading; each text and each code occurs once."""
    listed = list(reasons)
    return {
        "valid": not listed,
        "why": SEPARATOR.join(dict.fromkeys(one.why for one in listed)),
        "code": SEPARATOR.join(dict.fromkeys(str(one.code) for one in listed)),
    }
