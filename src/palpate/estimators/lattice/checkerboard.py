"""Control points of a checkerboard skin, each named by its cell.

Corners are located by the image around them and named by their lattice; missing or torn tiles remove only
their own.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palpate.core import ImageError, RangeError, Shaped, ndarray
from palpate.estimators.lattice.control_points import ControlPoints
from palpate.estimators.lattice.lattice_growth import MAX_MOVE, GrownLattice, grow_lattices, named_as
from palpate.estimators.lattice.saddle_corners import SaddleCorners, find_corners
from palpate.estimators.lattice.two_pigments import PigmentAxis, find_axis

MIN_POINTS = 12
MIN_SEEN = 0.3  # of the reference's points: with fewer the frame is not believed
MAX_SIDE = 0.25  # of the reference's points, missing along one side
MAX_SIGMA = 0.02  # of the pitch; a corner that is known less well is left out
SAME_PITCH = 1.35  # ratio within which a pitch that was given is right


@dataclass(frozen=True, eq=False)
class CheckerboardFind:
    """Checkerboard of a frame.

    Attributes:
        axis: Line of the two pigments, by which later frames are read.
        pitch: Median side of a tile [px].
        unnamed: Number of corners outside the named lattice.
    """

    points: ControlPoints
    axis: PigmentAxis
    pitch: float
    unnamed: int = field(default=0)


def find_checkerboard(
    frame: Shaped[ndarray, ...], pitch_px: float = 24.0, reference: ControlPoints | None = None
) -> CheckerboardFind:
    """Return the corners of a frame's checkerboard.

    Args:
        frame: 8-bit RGB ``[h w 3]`` or gray ``[h w]``.
        pitch_px: Side of a tile, within a factor of 1.6 [px].
        reference: Points whose names are kept. By default the first column and row are 0, and tile (i, j),
            whose first corner has that cell, is bright if i + j is even.
    """
    if not pitch_px >= 5:
        raise RangeError(f"tiles of {pitch_px} px; corners are found where tiles are 5 px wide or more")
    for _ in range(3):
        axis = find_axis(frame, pitch_px)
        corners = find_corners(axis.of(frame), pitch_px, frame)
        corners = corners.kept(corners.sigma < MAX_SIGMA * pitch_px)
        lattices = grow_lattices(corners.places, "square", corners.turn) if len(corners.places) else []
        if not lattices or max(pitch_px, lattices[0].pitch) < SAME_PITCH * min(pitch_px, lattices[0].pitch):
            break
        pitch_px = lattices[0].pitch
    if not lattices or len(lattices[0].cells) < MIN_POINTS:
        raise ImageError(
            f"{len(corners.places)} corners, {sum(len(g.cells) for g in lattices)} on a lattice, and "
            f"{MIN_POINTS} are needed; check focus, light, and the pitch of {pitch_px:.0f} px"
        )
    points = _first_names(corners, lattices[0]) if reference is None else _same(corners, lattices, reference)
    return CheckerboardFind(points, axis, lattices[0].pitch, len(corners.places) - len(points))


def _first_names(corners: SaddleCorners, lattice: GrownLattice) -> ControlPoints:
    """Points of the largest lattice, cells from 0, shifted by one if tiles would change color."""
    turn = corners.turn[lattice.marks]
    # At an even corner the bright tile begins there: bright lies along the diagonal of both axes.
    across = np.where(lattice.cells.sum(axis=1) % 2, -1.0, 1.0) * np.exp(1j * turn)
    cells = lattice.cells + np.array([int(_diagonal(corners, lattice, across.sum()) < 0), 0])
    return ControlPoints(cells, corners.places[lattice.marks], corners.sigma[lattice.marks])


def _diagonal(corners: SaddleCorners, lattice: GrownLattice, bright: complex) -> float:
    """Sign of the even corners' bright diagonal: 1 for (0, 0) to (1, 1), else -1."""
    places, cells = corners.places[lattice.marks], lattice.cells
    fit, *_ = np.linalg.lstsq(np.column_stack([np.ones(len(cells)), cells]), places, rcond=None)
    main = fit[1] + fit[2]
    return float((bright * np.conj(complex(*main) ** 2)).real)


def _same(corners: SaddleCorners, lattices: list[GrownLattice], reference: ControlPoints) -> ControlPoints:
    cells, marks = named_as(reference, lattices, corners.places, "square", MAX_MOVE)
    if len(cells) < max(MIN_POINTS, MIN_SEEN * len(reference)):
        raise ImageError(
            f"{len(cells)} of the reference's {len(reference)} points are seen, {100 * MIN_SEEN:.0f} % are "
            f"needed; give a nearer reference, within {MAX_MOVE} of a tile"
        )
    points = ControlPoints(cells, corners.places[marks], corners.sigma[marks])
    _refuse_shifted(points, reference)
    return points


def _refuse_shifted(points: ControlPoints, reference: ControlPoints) -> None:
    """Refuse names if a whole side is missing, as in a pattern shifted by whole tiles."""
    low, high = points.cells.min(axis=0), points.cells.max(axis=0)
    beyond = max((reference.cells < low).sum(axis=0).max(), (reference.cells > high).sum(axis=0).max())
    if beyond > MAX_SIDE * len(reference):
        raise ImageError(
            f"a side of the pattern, {beyond} of the reference's {len(reference)} points, is missing "
            f"({100 * MAX_SIDE:.0f} % may be); take a new reference"
        )
