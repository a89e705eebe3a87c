"""Optical flow of touch images: Horn and Schunck's, itself and from coarse to fine, and others'."""

from palpate.estimators.flow.coarse_to_fine import CoarseToFine, coarse_to_fine
from palpate.estimators.flow.flow_sequence import along, dis, farneback
from palpate.estimators.flow.horn_schunck import FlowField, HornSchunck, divergence, flow

__all__ = [
    "CoarseToFine", "FlowField", "HornSchunck", "along", "coarse_to_fine", "dis", "divergence", "farneback",
    "flow",
]  # fmt: skip
