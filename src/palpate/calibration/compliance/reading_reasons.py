"""Reasons why a reading of a press is not valid, each with a code for programs and a text for people."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class ReasonCode(StrEnum):
    """Codes of invalid readings in JSON."""

    FLAWED_PRESS = "flawed_press"
    DRIFTED = "drifted"
    SPEED = "speed_outside_range"
    REPEATED_FRAMES = "repeated_frames"
    OFF_CENTER = "off_center"
    OUT_OF_DISTRIBUTION = "out_of_distribution"
    CUES_DISAGREE = "cues_disagree"
    OUTSIDE_RANGE = "outside_range"
    INTERVAL_OUTSIDE_RANGE = "interval_outside_range"
    TWO_REFERENCES = "two_references"
    CURVED = "curved_object"
    TOO_STIFF = "too_stiff"
    INCLINED = "inclined"
    NOT_HERTZ = "not_hertz"
    SHAPE_OUTSIDE_RANGE = "shape_outside_range"


SEPARATOR = "; "  # between the reasons of one reading


@dataclass(frozen=True)
class ReadingReason:
    """Why a reading is not valid.

    Attributes:
        code: for programs.
        text: for people.
    """

    code: ReasonCode
    text: str


def joined(reasons: Iterable[ReadingReason]) -> dict[str, str | bool]:
    """Return the fields `valid`, `why`, and `code` of a reading; each text and each code occurs once."""
    listed = list(reasons)
    return {
        "valid": not listed,
        "why": SEPARATOR.join(dict.fromkeys(one.text for one in listed)),
        "code": SEPARATOR.join(dict.fromkeys(one.code.value for one in listed)),
    }
