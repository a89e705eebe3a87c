"""A live image without a calibration: its health, and what differs from the untouched sensor."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from palpate.core import Frame, Image, InputError, Readings, Wrench
from palpate.core.reading import plain_number
from palpate.sensing.image_health import image_health
from palpate.sensing.live_loop import LiveLoop
from palpate.sensing.streaming.source_views import view_of_source
from palpate.sensing.untouched_view import UntouchedView, overlay_of
from palpate.sensors.owned import SensorPreset

LOOK_S = 0.2  # between two looks; the health of a picture does not change faster
BRIGHT = 251  # grey levels from which a pixel is clipped


class ImageWatch:
    """Subscriber that inspects the picture a few times a second.

    Focus and noise come from the frames of the last zero; later frames are compared with them.

    Args:
        preset: Preset of the sensor: its skin region, marks, and scale. By default that of a virtual sensor,
            or the whole frame.
    """

    def __init__(self, loop: LiveLoop, preset: SensorPreset | None = None) -> None:
        self._loop, self.preset = loop, preset
        self.overlay: dict[str, Any] | None = None
        self.looks = 0
        self._frames: tuple[Image, ...] = ()
        self._view: UntouchedView | None = None
        self._health: dict[str, Any] = {}
        self._now: dict[str, Any] = {}
        self._next_s = 0.0

    def on_frame(self, frame: Frame, readings: Readings | None) -> None:
        """Look at a frame, if the last look is some time ago."""
        now_s = time.monotonic()
        if now_s < self._next_s or frame.fault:
            return
        self._next_s = now_s + LOOK_S
        if self._loop.untouched_frames is not self._frames:
            self._learn(self._loop.untouched_frames)
        self._now = self._seen(frame.image)
        self.looks += 1

    def on_force(self, samples: Sequence[Wrench]) -> None:
        """Nothing is seen of a force."""

    def status(self) -> dict[str, Any] | None:
        """Plain values: "level", "clipped", after a zero "noise", "blur_px", "verdict", "change", "why".

        "centre_px" is of the changed region, "centre_mm" from the middle of the skin where its scale is
        known.
        """
        return {**self._health, **self._now} or None

    def _learn(self, frames: tuple[Image, ...]) -> None:
        self._frames, self._view, self._health, self.overlay = frames, None, {}, None
        if not frames:
            return
        try:
            design = getattr(getattr(self._loop.source, "hand", None), "design", None)
            self._view = view_of_source(frames, self.preset, design)
            self._health = image_health(frames).to_dict()
        except InputError as e:
            self._health = {"advice": [str(e)]}

    def _seen(self, image: Image) -> dict[str, Any]:
        found = {"level": round(float(image.mean()), 2), "clipped": round(float((image >= BRIGHT).mean()), 5)}
        if self._view is None:
            return found
        try:
            touch = self._view.seen(image)
        except InputError as e:
            return found | {"verdict": "view-changed", "why": str(e)}
        self.overlay = overlay_of(touch, self._view.region)
        region = touch.region
        place = None if region is None else [round(c, 1) for c in region.centre_px]
        seen = {"verdict": touch.verdict, "change": plain_number(touch.change), "centre_px": place}
        if region is not None and region.centre_mm is not None:
            seen["centre_mm"] = [round(c, 2) for c in region.centre_mm]
        return found | seen | {"why": touch.why}
