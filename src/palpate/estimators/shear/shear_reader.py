"""Reader of touch on a patterned skin, without a calibration and so without newtons.

    reader = ShearReader(sensor.shear_skin(), untouched)
    touch = reader.touch(frame)
    touch.readings["x_mm"], touch.readings["edge_deg"], touch.readings["damage"]

A frame is read if its light and sharpness match the reference's. Slip is detected when a contact's position,
in coordinates of the resting skin, moves over marks that stopped following.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from palpate.core import Float, Frame, InputError, Lens, RangeError, Readings, Shaped, ndarray
from palpate.core.reading import NONE, Refusal
from palpate.estimators.fringe_light import brightest_channel
from palpate.estimators.lattice import ControlPoints, DottedSkin
from palpate.estimators.shear.reference_check import damage_of, refuse_reference
from palpate.estimators.shear.skin_marks import DotMarks, SkinMarks, TiledSkin, TileMarks
from palpate.estimators.shear.touch_places import (
    TouchPlace,
    TouchPlaces,
    camera_motion,
    reach_of,
    touch_places,
)
from palpate.estimators.shear.touch_readings import touch_readings
from palpate.estimators.surface_strain import StrainFields, StrainMeter

FRAMES = 6  # previous frames for comparison
MIN_PITCHES = 0.08  # pitches, least motion of a position
MIN_SIGNIFICANCE = 4.0  # ratio of the motion to its standard error
SAME_CONTACT = 1.5  # pitches from frame to frame within one contact


class SlipWatch:
    """Positions of the first contact over the last frames, for marks `pitch` apart."""

    def __init__(self, pitch: float) -> None:
        self._pitch = pitch
        self._past: deque[TouchPlace] = deque(maxlen=FRAMES)

    def slips(self, places: TouchPlaces) -> bool | None:
        """Return whether the contact moved over the marks; None without one contact seen before."""
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
    """Standard error of the distance, along the worse axis."""
    return max(math.hypot(one.x_error, other.x_error), math.hypot(one.y_error, other.y_error))


MIN_CONTRAST = 0.4  # of the reference's
MIN_SHARPNESS = 0.7  # of the reference's
MAX_CLIPPED = 0.1  # ratio of saturated pixels beyond the reference's
CLIPPED = 254
STEP = 2  # sampling of pixels


class FrameLook(NamedTuple):
    """Appearance of a frame where the pattern is.

    Attributes:
        contrast: Contrast of its darker and brighter parts [gray levels].
        clipped: Ratio of pixels with a channel at the end of the range.
        steep: Steepest gradients along x and y over the contrast [1/px].
    """

    contrast: float
    clipped: float
    steep: tuple[float, float]


def pattern_box(places_px: Float[ndarray, "n 2"], shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return rows and columns of an image that hold marks."""
    low = np.clip(places_px.min(axis=0), 0, None).astype(int)
    high = np.ceil(np.minimum(places_px.max(axis=0) + 1, shape[1::-1])).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def look_at(image: Shaped[ndarray, ...], box: tuple[slice, slice]) -> FrameLook:
    """Return the appearance of an 8-bit frame within a box."""
    part = image[box]
    grey = part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_RGB2GRAY)
    brightest = brightest_channel(part)
    some = grey[::STEP, ::STEP]
    low, high = _level(some, 10), _level(some, 90)
    contrast = max(high - low, 1.0)
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.8)  # noise is no edge
    gx, gy = (np.abs(g[::STEP, ::STEP]) for g in cv2.spatialGradient(smooth))
    steep = tuple(_level(g, 97) / contrast for g in (gx, gy))
    return FrameLook(contrast, float((brightest[::STEP, ::STEP] >= CLIPPED).mean()), (steep[0], steep[1]))


def _level(values: Shaped[ndarray, ...], percent: float) -> float:
    """Percentile of non-negative integers by counting, as NumPy defines it."""
    below = np.cumsum(np.bincount(values.ravel()))
    place = percent / 100 * (below[-1] - 1)
    lower, upper = np.searchsorted(below, [math.floor(place), math.ceil(place)], side="right")
    return float(lower + (upper - lower) * (place % 1))


def why_unreadable(now: FrameLook, reference: FrameLook) -> Refusal:
    """Return the refusal of a frame that cannot be read relative to its reference."""
    if now.clipped > reference.clipped + MAX_CLIPPED:
        percent = f"{100 * now.clipped:.0f} %"
        return Refusal("saturated", f"{percent} of the pattern is saturated; lower light or exposure")
    if now.contrast < MIN_CONTRAST * reference.contrast:
        return Refusal(
            "low_contrast",
            f"the pattern's contrast is {now.contrast:.0f} grey levels, and {reference.contrast:.0f} in the "
            f"reference: too dark, or covered; look at the light",
        )
    sharp = min(a / b for a, b in zip(now.steep, reference.steep, strict=True))
    if sharp < MIN_SHARPNESS:
        return Refusal(
            "blurred", f"the frame is blurred: edges are {100 * sharp:.0f} % as steep as the reference's"
        )
    return NONE


MIN_SEEN = 0.5  # of the reference's marks
NOTHING = TouchPlaces((), 0, None, None)


@dataclass(frozen=True, slots=True, eq=False)
class ShearTouch:
    """Touch in one frame.

    Attributes:
        readings: Readings by column.
        points: Marks on the skin; none if the frame is refused.
        fields: Strain relative to the reference, degree 1; None likewise.
        places: Contacts.
        reason, code: Why the frame is refused; else empty.
        assumes: What a force assumes of the skin; empty without one.
    """

    readings: Readings
    points: ControlPoints
    fields: StrainFields | None
    places: TouchPlaces
    reason: str
    code: str = ""
    assumes: str = ""


class ShearReader:
    """Reader of touch relative to a no-contact frame.

    Args:
        skin: Tiles with their camera, from a sensor's `shear_skin`, or a maker's dots.
        reference: No-contact frame.
        lens: Lens of the dots' camera; tiles carry theirs.
    """

    def __init__(self, skin: TiledSkin | DottedSkin, reference: Frame, lens: Lens | None = None) -> None:
        image = reference.image
        if isinstance(skin, TiledSkin) and lens is not None:
            raise InputError(
                "a tiled skin carries its lens; give one by dataclasses.replace(skin, lens=lens)"
            )
        self.skin = skin
        self.marks: SkinMarks = (
            TileMarks(skin, image) if isinstance(skin, TiledSkin) else DotMarks(skin, image, lens)
        )
        self.lattice = refuse_reference(self.marks, skin)
        self._box = pattern_box(self.marks.in_image(self.marks.reference.places), image.shape)
        self._look = look_at(image, self._box)
        self._meter = StrainMeter(self.marks.reference)
        self._slip = SlipWatch(self.marks.pitch)
        self._torn = f"a dark line crosses {self.marks.gap:.1f} tiles" if self.marks.gap else ""

    def read(self, frame: Frame) -> Readings:
        return self.touch(frame).readings

    def touch(self, frame: Frame) -> ShearTouch:
        """Return the touch in the next frame; frames come in temporal order."""
        points, fields, refusal = self._seen(frame)
        places = NOTHING if fields is None else touch_places(fields, self.marks, self.skin)
        if fields is not None:
            refusal = camera_motion(fields, self.marks.pitch, self.marks.px_per_unit, places)
        if fields is None or refusal:
            fields, places = None, NOTHING
        reach = NONE if fields is None else reach_of(fields, places, self.marks, self.skin)
        damage = NONE if fields is None else self._damage(fields, places, points, reach)
        slip = self._slip.slips(places)
        readings = touch_readings(
            frame,
            self.marks,
            self.skin,
            self.lattice,
            len(points),
            fields,
            places,
            refusal,
            reach,
            slip,
            damage,
        )
        return ShearTouch(readings, points, fields, places, refusal.why, refusal.code)

    def _damage(
        self, fields: StrainFields, places: TouchPlaces, points: ControlPoints, reach: Refusal
    ) -> Refusal:
        """Refusal of a torn skin; a contact outside the area moves marks as no model predicts."""
        marks = self.marks
        torn = self._torn or damage_of(
            fields, places, marks.reference, points, marks.bare, marks.gap, marks.pitch, moved=not reach
        )
        return Refusal("skin_torn", f"the skin looks torn: {torn}") if torn else NONE

    def _seen(self, frame: Frame) -> tuple[ControlPoints, StrainFields | None, Refusal]:
        """Marks and strain of a frame, or the refusal."""
        tracked = self.marks.follow(frame.image)
        points = tracked.points
        refusal = Refusal("no_pattern", tracked.reason) if tracked.reason else NONE
        refusal = refusal or why_unreadable(look_at(frame.image, self._box), self._look)
        if not refusal and len(points) < MIN_SEEN * len(self.marks.reference):
            refusal = Refusal(
                "too_few_marks",
                f"{len(points)} of the reference's {len(self.marks.reference)} marks are seen, and at least "
                f"{100 * MIN_SEEN:.0f} % are needed",
            )
        if refusal:
            return points, None, refusal
        try:
            fields = self._meter.fields(points)
        except RangeError as refused:
            return points, None, Refusal("too_few_marks", str(refused))
        moved = camera_motion(fields, self.marks.pitch, self.marks.px_per_unit)
        return points, None if moved else fields, moved
