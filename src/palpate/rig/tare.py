"""The force sensor's mounting under its former name: see `palpate.devices.force_bias`."""

from palpate.devices.force_bias import Mounting

__all__ = ["Mounting"]
