"""Separate taps of a TacTip: pins given their names, and a virtual tip fitted to them."""

from palpate.sensors.tactip.taps.tap_folder import RegisteredTaps, fit_folder, register_taps

__all__ = ["RegisteredTaps", "fit_folder", "register_taps"]
