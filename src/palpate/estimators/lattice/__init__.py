"""Marks on a regular lattice in a skin: found, named by their cell, and followed from frame to frame."""

from palpate.estimators.lattice.control_points import ControlPoints as ControlPoints
