"""Control points of a checkerboard tracked from frame to frame, and searched again where tracking fails.

Corners are located from where they were, if they moved by less than a third of a tile; lost ones where their
neighbors predict them. If too many are lost or all have jumped, the whole frame is searched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Bool, Float, ImageError, InputError, Shaped, ndarray
from palpate.estimators.lattice.checkerboard import (
    MIN_HALF_TURN,
    CheckerboardFind,
    find_checkerboard,
    half_turn,
    look_of,
    noise_at,
    refined,
    ring_levels,
)
from palpate.estimators.lattice.lattice_growth import ControlPoints

ROUNDS = 2
NEIGHBOURS = 8
MORE_LOOKS = 3  # at a frame in which marks are lost
MAX_STEP = 0.3  # of the pitch between frames, each corner
MAX_STRAY = 0.2  # of the pitch, from the median step of its neighbours
MIN_FOLLOWED = 0.7  # of the points that the last search found
MIN_OF_CONTRAST = 0.4  # of a corner's contrast when it was found
MIN_NOISIER = 1.2  # of a frame's noise over the reference's, which is then an average of two frames or more
MAX_TURNED = 0.6  # rad of twice the angle, between frames


@dataclass(frozen=True, eq=False)
class TrackedPoints:
    """Points of one frame.

    Attributes:
        points: Points found; none if the frame is refused.
        found_anew: Whether the whole frame was searched.
        reason: Reason of the refusal; else empty.
    """

    points: ControlPoints
    found_anew: bool
    reason: str = ""


class MarkTracker:
    """Tracker of a reference frame's points (8-bit, RGB or gray), for tiles of about `pitch_px`."""

    def __init__(self, reference: Shaped[ndarray, ...], pitch_px: float = 24.0) -> None:
        self.reference: CheckerboardFind = find_checkerboard(reference, pitch_px)
        self.pitch = self.reference.pitch
        points = self.reference.points
        self._shape = reference.shape
        self._cells = points.cells
        self._number = {cell: i for i, cell in enumerate(map(tuple, points.cells.tolist()))}
        near = cKDTree(points.cells).query(points.cells, k=min(NEIGHBOURS + 1, len(points)))[1]
        self._near = near[:, 1:]
        axis = self.reference.axis.of(reference)
        turn, contrast, _ = look_of(ring_levels(axis, points.places, self.pitch)[..., 0])
        _, gain, _ = refined(axis, points.places, self.pitch, 1)
        self._contrast = contrast
        self._noise = points.sigma / gain
        self._noisier: float | None = None  # a frame than the reference, which may be an average of some
        self._spread = points.sigma * contrast  # standard error for a contrast of one level
        self._places, self._turn = points.places.copy(), turn
        self._alive = np.ones(len(points), bool)

    def follow(self, frame: Shaped[ndarray, ...]) -> TrackedPoints:
        if frame.dtype != np.uint8 or frame.shape != self._shape:
            raise InputError(
                f"a frame {frame.dtype} {list(frame.shape)}; give 8-bit frames of {list(self._shape)}",
                code="frame-size",
            )
        if self._noisier is None:
            self._noisier = self._noise_over_the_references(frame)
        places, sigma, turn, sound = self._followed(frame, self._noisier)
        if (sound & self._alive).sum() >= MIN_FOLLOWED * max(self._alive.sum(), 1):
            self._take(places, turn, sound)
            return TrackedPoints(ControlPoints(self._cells[sound], places[sound], sigma[sound]), False)
        return self.search(frame)

    def settled(self, tracked: TrackedPoints, frame: Shaped[ndarray, ...], count: int) -> TrackedPoints:
        """Return the points of a frame after searching again for lost ones, until `count` are found."""
        for _ in range(MORE_LOOKS):
            if not 0 < len(tracked.points) < count:
                break
            again = self.follow(frame)
            if len(again.points) <= len(tracked.points):
                break
            tracked = again
        return tracked

    def _noise_over_the_references(self, frame: Shaped[ndarray, ...]) -> float:
        """Noise of a frame over the reference's; 1 within the usual difference."""
        there = noise_at(self.reference.axis.of(frame), self.reference.points.places, self.pitch)
        ratio = float(np.median(there) / max(np.median(self._noise), 1e-9))
        return ratio if ratio > MIN_NOISIER else 1.0

    def _followed(
        self, frame: Shaped[ndarray, ...], noisier: float
    ) -> tuple[Float[ndarray, "n 2"], Float[ndarray, " n"], Float[ndarray, " n"], Bool[ndarray, " n"]]:
        """Positions, standard errors, angles, and validity of all corners."""
        weights = self.reference.axis.weights
        places, _, sound = refined(frame, self._places, self.pitch, ROUNDS, gains=False, weights=weights)
        ring = ring_levels(frame, places, self.pitch)
        turn, contrast, fourfold = look_of(ring @ weights[0, :-1])
        sound &= (contrast > MIN_OF_CONTRAST * self._contrast) & (fourfold > 0.5)
        noise = (noisier * self._noise / np.maximum(contrast, 1.0)) ** 2
        sound &= half_turn(ring) > MIN_HALF_TURN - noise
        sound &= np.cos(turn - self._turn) > np.cos(MAX_TURNED)
        step = places - self._places
        sound &= np.hypot(*step.T) < MAX_STEP * self.pitch
        usual = self._usual(step, sound)
        sound &= np.hypot(*(step - usual).T) < MAX_STRAY * self.pitch
        return places, noisier * self._spread / np.maximum(contrast, 1.0), turn, sound

    def _usual(self, step: Float[ndarray, "n 2"], sound: Bool[ndarray, " n"]) -> Float[ndarray, "n 2"]:
        """Median step of each corner's valid neighbors, or of all."""
        if not sound.any():
            return np.zeros_like(step)
        everywhere = np.median(step[sound], axis=0)
        around, told = step[self._near], sound[self._near]
        ordered = np.sort(np.where(told[..., None], around, np.inf), axis=1)
        count = told.sum(axis=1)
        rows, middle = np.arange(len(step)), np.maximum(count - 1, 0)
        both = (ordered[rows, middle // 2] + ordered[rows, np.maximum(count, 1) // 2]) / 2
        return np.where((count > 2)[:, None], both, everywhere)

    def _take(self, places: np.ndarray, turn: np.ndarray, sound: np.ndarray) -> None:
        """Keep what was found; move lost corners with their neighbors."""
        moved = self._usual(places - self._places, sound)
        lost = self._places + moved
        held = ((lost > 0) & (lost < np.array(self._shape[1::-1]))).all(axis=1)
        self._places = np.where(sound[:, None], places, np.where(held[:, None], lost, self._places))
        self._turn = np.where(sound, turn, self._turn)
        self._alive = sound

    def search(self, frame: Shaped[ndarray, ...]) -> TrackedPoints:
        """Return points found in the whole frame, named by their last position, or the reason."""
        last = ControlPoints(self._cells, self._places, np.zeros(len(self._cells)))
        try:
            found = find_checkerboard(frame, self.pitch, last).points
        except ImageError as refusal:
            none = ControlPoints(np.empty((0, 2), int), np.empty((0, 2)), np.empty(0))
            return TrackedPoints(none, True, str(refusal))
        known = [self._number.get(cell, -1) for cell in map(tuple, found.cells.tolist())]
        rows = np.array(known)
        found = ControlPoints(found.cells[rows >= 0], found.places[rows >= 0], found.sigma[rows >= 0])
        rows = rows[rows >= 0]
        places, sound = self._places.copy(), np.zeros(len(self._cells), bool)
        places[rows], sound[rows] = found.places, True
        ring = ring_levels(self.reference.axis.of(frame), places, self.pitch)
        turn, _, _ = look_of(ring[..., 0])
        self._take(places, turn, sound)
        return TrackedPoints(found, True)
