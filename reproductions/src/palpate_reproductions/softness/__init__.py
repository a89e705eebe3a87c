"""The report on softness rendered by two cues, on the virtual bench: its mechanics and its device."""

from palpate_reproductions.softness.softness_reproduction import reproduce_softness

__all__ = ["reproduce_softness"]
