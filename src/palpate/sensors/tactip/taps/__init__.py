"""Separate taps of a TacTip: pins identified, a virtual tip fitted, and poses read."""

from palpate.sensors.tactip.taps.tap_folder import FolderFit, RegisteredTaps, fit_folder, register_taps
from palpate.sensors.tactip.taps.tip_reader import (
    PoseReadings,
    TipReader,
    load_reader,
    read_images,
    reader_record,
)

__all__ = [
    "FolderFit",
    "PoseReadings",
    "RegisteredTaps",
    "TipReader",
    "fit_folder",
    "load_reader",
    "read_images",
    "reader_record",
    "register_taps",
]
