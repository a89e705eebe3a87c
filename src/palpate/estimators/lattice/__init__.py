"""Marks on a regular lattice in a skin: found, named by their cell, and followed from frame to frame."""

from palpate.estimators.lattice.checkerboard import CheckerboardFind, find_checkerboard
from palpate.estimators.lattice.dotted_skin import DottedSkin, find_dots, read_skin
from palpate.estimators.lattice.lattice_growth import ControlPoints, GrownLattice, grow_lattices, named_as
from palpate.estimators.lattice.mark_tracker import MarkTracker, TrackedPoints

__all__ = [
    "CheckerboardFind", "ControlPoints", "DottedSkin", "GrownLattice", "MarkTracker", "TrackedPoints",
    "find_checkerboard", "find_dots", "grow_lattices", "named_as", "read_skin",
]  # fmt: skip
