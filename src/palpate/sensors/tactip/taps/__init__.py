"""Separate taps of a TacTip: pins given their names, a virtual tip fitted to them, and poses read by it."""

from palpate.sensors.tactip.taps.tap_folder import FolderFit, RegisteredTaps, fit_folder, register_taps
from palpate.sensors.tactip.taps.tip_reader import PoseReadings, TipReader
from palpate.sensors.tactip.taps.tip_reader_file import load_reader, read_images, reader_record

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
