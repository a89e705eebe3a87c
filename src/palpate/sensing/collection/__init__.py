"""Labelled presses by hand: steady plateaus, what is missing, and what more presses would bring."""

from palpate.sensing.collection.plateau_finder import PlateauRule, Weighing
from palpate.sensing.collection.press_collector import PressCollector
from palpate.sensing.collection.press_coverage import PressCoverage

__all__ = ["PlateauRule", "PressCollector", "PressCoverage", "Weighing"]
