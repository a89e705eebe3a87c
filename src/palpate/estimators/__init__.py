"""Frames to readings: certified estimators, the guard around them, the networks inside."""

from palpate.estimators.card import Card
from palpate.estimators.certified import Estimator, Zero, read_card
from palpate.estimators.guard import Guard

__all__ = ["Card", "Estimator", "Guard", "Zero", "read_card"]
