"""Drift of a live sensor from its calibration, and what to do about it.

Nobody says when a sensor in use is untouched. But a touch only takes its image farther from the untouched
one, so the least distance of the last minute bounds the drift from above, and is the drift itself where the
sensor was let go of once in that minute.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

from palpate.core import Drift, Image, ImageError, Readings
from palpate.core.shared_history import SharedHistory
from palpate.estimators.guard import EXCHANGED, MIRRORED
from palpate.sensing.streaming.live_readers import FrameReader

LOOK_S = 0.25  # between two looks at drift, and at why frames are refused
WINDOW_S = 60.0
MIN_LOOKS = 20  # five seconds, before which nothing is advised
MIN_EXCHANGED = 3  # looks with red and blue exchanged, from which that is advised
REFUSED = 0.5  # share of looks at which the guard refused the frame, from which something is advised

RE_ZERO = "re-zero"
REFOCUS = "refocus"
ADAPT = "adapt"
EXCHANGE = "exchange"
FLIP = "flip"
WORDS = {
    RE_ZERO: "re-zero: take everything off the skin, and take its untouched image anew",
    REFOCUS: "refocus: the image looks like one of a lens out of focus; turn it back, or lock the focus",
    ADAPT: "adapt: the sensor has changed since its calibration; record some fifty presses with labels and "
    "run `palpate adapt`, or calibrate again",
    FLIP: "flip: the picture seems mirrored or turned by half a turn; have the camera or what reads it "
    "give it as it was calibrated on",
    EXCHANGE: "exchange: red and blue seem exchanged; have the camera or what reads it give red, green, blue",
}
OUT_OF_FOCUS = "focus"  # the guard's name of that kind of change


@dataclass(frozen=True, slots=True)
class Look:
    """One look: distance from the untouched sensor, and what a refused frame looked like."""

    at_s: float
    drift: Drift | None
    refused: bool
    kind: str


class DriftWatch:
    """Follows the drift of one live sensor."""

    def __init__(self, reader: FrameReader) -> None:
        self._reader = reader
        self._looks = SharedHistory[Look](round(WINDOW_S / LOOK_S) + 1)
        self._next_s = 0.0
        self._re_zeroed = False

    def frame(self, image: Image, readings: Readings) -> None:
        """Take in a frame and its readings; it is looked at a few times a second."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = now_s + LOOK_S
        try:
            drift = self._reader.drift_of(image)
            # A value beyond the range is not valid either, and says nothing of the camera.
            kind = "" if readings.valid else self._reader.kind_of(image)
        except ImageError:  # of another size: the readings say so
            return
        self._looks.append(Look(now_s, drift, bool(kind), kind))

    def zeroed(self) -> None:
        """The untouched image was taken anew: what was seen before says nothing of now."""
        self._looks.clear()
        self._re_zeroed = True

    @property
    def drift(self) -> Drift | None:
        """The least of the last minute; None where the calibration knows no untouched sensor."""
        recent = [look.drift for look in self._recent() if look.drift is not None]
        return min(recent, key=lambda drift: drift.statistic, default=None)

    @property
    def action(self) -> str:
        """What should be done, a key of `WORDS`; "" where nothing has to be."""
        recent = self._recent()
        # Seen where there is colour alone, as of a touch; but not once where the order is right.
        if sum(look.kind == EXCHANGED for look in recent) >= MIN_EXCHANGED:
            return EXCHANGE
        if len(recent) < MIN_LOOKS:
            return ""
        refused = [look for look in recent if look.refused]
        much = len(refused) > REFUSED * len(recent)
        kinds = Counter(look.kind for look in refused if look.kind)
        if much and kinds and kinds.most_common(1)[0][0] == OUT_OF_FOCUS:
            return REFOCUS
        if much and kinds and kinds.most_common(1)[0][0] in MIRRORED:
            return FLIP
        drift = self.drift
        if (drift is not None and drift.drifted) or (much and kinds):
            return RE_ZERO if self._reader.differential and not self._re_zeroed else ADAPT
        return ""

    @property
    def advice(self) -> str:
        """The same in words."""
        return WORDS.get(self.action, "")

    def to_dict(self) -> dict[str, Any] | None:
        """Drift as plain values; None where it is not known."""
        drift = self.drift
        return None if drift is None else {**drift.to_dict(), "action": self.action}

    def _recent(self) -> list[Look]:
        now_s = time.monotonic()
        return [look for look in self._looks.items() if now_s - look.at_s <= WINDOW_S]
