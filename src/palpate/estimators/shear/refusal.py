"""Reason why a reading of a patterned skin is not valid: a code for programs, a sentence for people."""

from __future__ import annotations

from typing import NamedTuple


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
