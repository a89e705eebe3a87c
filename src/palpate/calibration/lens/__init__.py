"""Calibration of a camera's lens from photographs of a flat board."""

from palpate.calibration.lens.boards import Board, BoardView, MissedView, find_board, read_views
from palpate.calibration.lens.lens_fit import LensFit, ViewScore, calibrate_lens, fit_lens

__all__ = [
    "Board",
    "BoardView",
    "LensFit",
    "MissedView",
    "ViewScore",
    "calibrate_lens",
    "find_board",
    "fit_lens",
    "read_views",
]
