"""Marks in a skin and how far each has moved since the skin was untouched: pins, dots, bright or dark.

Pins and dots are found once in the untouched frame, on their lattice, which may take seconds, and followed
from frame to frame, in which each moves by less than half its distance to the next. Where many are lost, the
frame is searched whole and marks are named by their cell of the lattice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import cv2
import numpy as np

from palpate.core import Float, ImageError, Shaped, UInt8, ndarray
from palpate.estimators.lattice.dotted_skin import DottedSkin, find_dots
from palpate.estimators.pins import PinTracks, find_pins, follow, grey_frame

MarkKind = Literal["bright", "dark"]
Places = Float[ndarray, "m 2"]

MIN_MARKS = 9
AROUND = 16.0  # of the frame's longer side: over which the ground around a mark is seen
MIN_FOUND = 0.6  # of the marks: with fewer the whole frame is searched
ALIKE = 0.02  # of the distance of marks: by which those that moved together differ


@dataclass(frozen=True, slots=True)
class MarkMotion:
    """Marks that were found in a frame.

    Attributes:
        at_px: where each was in the untouched frame, x along columns and y along rows ``[m 2]`` [px].
        moved_px: how far each has moved since ``[m 2]`` [px].
        lost: marks of the untouched frame that are not found in this one.
    """

    at_px: Places
    moved_px: Places
    lost: int

    @property
    def largest_px(self) -> float:
        """Largest motion [px]; 0 without marks."""
        return float(np.hypot(*self.moved_px.T).max(initial=0.0))

    def apart(self) -> tuple[Float[ndarray, 2], Places]:
        """Shift that all have in common, and what each has moved beyond that and a common turn [px].

        Reference:
            Kabsch 1976, doi:10.1107/S0567739476001873.
        """
        if not len(self.at_px):
            return np.zeros(2), self.moved_px
        shift = self.moved_px.mean(axis=0)
        before = self.at_px - self.at_px.mean(axis=0)
        now = before + self.moved_px - shift
        across = float((before[:, 0] * now[:, 1] - before[:, 1] * now[:, 0]).sum())
        turn = math.atan2(across, float((before * now).sum()))
        back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        return shift, now - before @ back


class PinFollower:
    """Pins, bright or dark, followed from the untouched frame.

    Args:
        untouched: 8-bit grey or RGB frame.
        kind: whether marks are brighter or darker than what is around.
    """

    def __init__(self, untouched: Shaped[ndarray, ...], kind: MarkKind = "bright") -> None:
        self.kind = kind
        self._first = find_pins(self._bright(untouched), MIN_MARKS)
        self._now = self._first

    @cached_property
    def pitch_px(self) -> float:
        """Median distance of neighbouring marks [px]."""
        away = self._first.xy_px[:, None] - self._first.xy_px[None]
        far = np.hypot(away[..., 0], away[..., 1])
        np.fill_diagonal(far, np.inf)
        return float(np.median(far.min(axis=1)))

    def moved(self, frame: Shaped[ndarray, ...]) -> MarkMotion:
        """Return the motion of the marks in the next frame.

        After too large a step a mark may be mistaken for its neighbor; marks that all lie at their no-contact
        positions, up to a common motion, are matched there first.
        """
        grey = self._bright(frame)
        self._now = next(iter(follow([grey], self._from_here())))
        if self._now.found.mean() < MIN_FOUND:
            self._now = self._anew(grey)
        motion = self._motion(self._now)
        if _spread(motion) > ALIKE * self.pitch_px:
            back = next(iter(follow([grey], self._first)))
            released = self._motion(back)
            if back.found.mean() >= MIN_FOUND and _spread(released) <= ALIKE * self.pitch_px:
                self._now, motion = back, released
        return motion

    def _motion(self, now: PinTracks) -> MarkMotion:
        found = now.found
        at = self._first.xy_px[found]
        return MarkMotion(at, now.xy_px[found] - at, int((~found).sum()))

    def _from_here(self) -> PinTracks:
        """Where to look: a mark that was lost is looked for where the others have gone to."""
        found = self._now.found
        if found.all() or not found.any():
            return self._now if found.any() else self._first
        gone = np.median(self._now.xy_px[found] - self._first.xy_px[found], axis=0)
        places = np.where(found[:, None], self._now.xy_px, self._first.xy_px + gone)
        return replace(self._first, xy_px=places)

    def _anew(self, grey: UInt8[ndarray, "h w"]) -> PinTracks:
        """Marks of the whole frame, named by their cells; those followed, where none can be named."""
        try:
            again = find_pins(grey, MIN_MARKS)
        except ImageError:
            return self._now
        if again.cells is None or self._first.cells is None:
            return self._now
        rows = {tuple(cell): i for i, cell in enumerate(again.cells.tolist())}
        which = np.array([rows.get(tuple(cell), -1) for cell in self._first.cells.tolist()])
        places = np.where((which >= 0)[:, None], again.xy_px[which], np.nan)
        return replace(self._first, xy_px=places)

    def _bright(self, frame: Shaped[ndarray, ...]) -> UInt8[ndarray, "h w"]:
        grey = grey_frame(frame)
        if grey is None:
            raise ImageError(
                f"marks are followed in 8-bit grey or RGB frames, got {frame.dtype} {list(frame.shape)}"
            )
        return grey if self.kind == "bright" else np.subtract(255, grey, dtype=np.uint8)


def _spread(motion: MarkMotion) -> float:
    """Root mean square motion of marks apart [px]."""
    return (
        float(np.sqrt(np.mean(np.square(motion.apart()[1]).sum(axis=1)))) if len(motion.at_px) else math.inf
    )


class DotFollower:
    """Dots of a described skin, found in each frame and named by their cell.

    Args:
        untouched: 8-bit grey or RGB frame.
    """

    def __init__(self, untouched: Shaped[ndarray, ...], skin: DottedSkin) -> None:
        self._skin = skin
        self._first = find_dots(untouched, skin)

    @property
    def pitch_px(self) -> float:
        """About the distance of neighbouring dots [px]."""
        return self._skin.pitch_px

    def moved(self, frame: Shaped[ndarray, ...]) -> MarkMotion:
        """Motion of the dots in a frame; none are found in one that shows no lattice."""
        try:
            now = find_dots(frame, self._skin, self._first)
        except ImageError:
            return MarkMotion(np.empty((0, 2)), np.empty((0, 2)), len(self._first))
        at, places, _ = now.shared_with(self._first)
        return MarkMotion(at, places - at, len(self._first) - len(at))


def follow_marks(
    untouched: Shaped[ndarray, ...], marks: MarkKind | DottedSkin | Literal["any"]
) -> PinFollower | DotFollower | None:
    """Return a follower of the marks; None where `marks` is "any" and no lattice is found.

    Args:
        marks: Contrast of the marks, a description of dots, or "any": bright ones, else dark ones.
    """
    if isinstance(marks, DottedSkin):
        return DotFollower(untouched, marks)
    if marks != "any":
        return PinFollower(untouched, marks)
    kinds: tuple[MarkKind, MarkKind] = ("bright", "dark")
    for kind in kinds if _skewness(untouched) > 0 else kinds[::-1]:
        try:
            return PinFollower(untouched, kind)
        except ImageError:
            continue
    return None


def _skewness(frame: Shaped[ndarray, ...]) -> float:
    """Third moment of how grey levels differ from those around: above 0 where few are brighter."""
    grey = grey_frame(frame)
    if grey is None:
        return 0.0
    around = cv2.GaussianBlur(grey, (0, 0), max(grey.shape) / AROUND)
    return float(np.mean((grey.astype(np.float64) - around) ** 3))


MIN_TOLD_MARKS = 0.6  # fraction of the marks below which no motion is reported
MIN_NOISE_PX = 0.03  # noise along each axis from another position on the pixel grid [px]


class MarksApart:
    """Detects relative motion of marks beyond the noise of their positions.

    A touch moves marks apart; a camera or mount that moved shifts and turns all alike.

    Args:
        untouched: Motion of the marks in two or more no-contact frames.
        rate: False alarm rate.

    Attributes:
        limit_px: Largest relative motion that noise explains [px].
    """

    def __init__(self, untouched: Sequence[MarkMotion], rate: float) -> None:
        apart = [one.apart()[1] for one in untouched if len(one.at_px)]
        count = max((len(one) for one in apart), default=1)
        square = float(np.mean(np.concatenate(apart) ** 2)) if apart else 0.0
        # Each of `count` motions is a Rayleigh variable, whose tail is exp(-r^2 / 2 sigma^2).
        self.limit_px = max(math.sqrt(square), MIN_NOISE_PX) * math.sqrt(2 * math.log(count / rate))

    def told(self, marks: MarkMotion) -> tuple[Float[ndarray, 2], float] | None:
        """Common shift, and the largest motion apart over its limit; None where too few marks are found."""
        found = len(marks.at_px)
        if found < MIN_TOLD_MARKS * (found + marks.lost):
            return None
        shift, apart = marks.apart()
        return shift, float(np.hypot(*apart.T).max()) / self.limit_px
