"""Onset of slip: the contact moves on over the skin's marks in place of taking them along.

While a contact sticks, the same marks lie under it from frame to frame, however far they are taken along;
places are told on the resting skin, so that its place stays. Once it slides, the marks under it stop
following, and its place moves on over them.
"""

from __future__ import annotations

import math
from collections import deque

from palpate.estimators.shear.touch_places import TouchPlace, TouchPlaces

FRAMES = 6  # before this one, that it is held against
MIN_PITCHES = 0.08  # of the pitch: what a place moves by at least
MIN_SIGNIFICANCE = 4.0  # of the move over its standard error
SAME_CONTACT = 1.5  # pitches from frame to frame; what is further is another contact


class SlipWatch:
    """Places of the first contact over the last frames.

    Args:
        pitch: distance of marks [unit].
    """

    def __init__(self, pitch: float) -> None:
        self._pitch = pitch
        self._past: deque[TouchPlace] = deque(maxlen=FRAMES)

    def slips(self, places: TouchPlaces) -> bool | None:
        """Whether the contact has moved over the marks; None without one contact that was there before."""
        if len(places.contacts) != 1:
            self._past.clear()
            return None
        now = places.contacts[0]
        if self._past and _apart(now, self._past[-1]) > SAME_CONTACT * self._pitch:
            self._past.clear()
        past = list(self._past)
        self._past.append(now)
        if not past:
            return None
        return any(
            _apart(now, one) > MIN_PITCHES * self._pitch + MIN_SIGNIFICANCE * _error(now, one) for one in past
        )


def _apart(one: TouchPlace, other: TouchPlace) -> float:
    return math.hypot(one.x - other.x, one.y - other.y)


def _error(one: TouchPlace, other: TouchPlace) -> float:
    """Standard error of their distance, along its worse axis."""
    return max(math.hypot(one.x_error, other.x_error), math.hypot(one.y_error, other.y_error))
