"""Marks on a regular lattice in a skin: found, named by their cell, and followed from frame to frame."""

from palpate.estimators.lattice.checkerboard import (
    CheckerboardFind as CheckerboardFind,
    find_checkerboard as find_checkerboard,
)
from palpate.estimators.lattice.control_points import ControlPoints
from palpate.estimators.lattice.dotted_skin import (
    DottedSkin as DottedSkin,
    find_dots as find_dots,
    read_skin as read_skin,
)
from palpate.estimators.lattice.lattice_growth import (
    GrownLattice as GrownLattice,
    grow_lattices as grow_lattices,
)
from palpate.estimators.lattice.lattice_identity import named_as
from palpate.estimators.lattice.mark_tracker import MarkTracker as MarkTracker, TrackedPoints as TrackedPoints
from palpate.estimators.lattice.quadrilaterals import (
    PublishedStages as PublishedStages,
    QuadSettings as QuadSettings,
    published_stages as published_stages,
    quad_midpoints as quad_midpoints,
)

__all__ = [
    "ControlPoints",
    "TrackedPoints",
    "named_as",
]
