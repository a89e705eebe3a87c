"""Limits under their former name: see `palpate.devices.limits`."""

from palpate.devices.limits import Limits

__all__ = ["Limits"]
