"""Frames to readings: certified estimators, the novelty detector around them, the networks inside."""

from palpate.estimators.certified import Estimator, Zero, read_card
from palpate.estimators.guard import NoveltyDetector
from palpate.estimators.model_card import Card

__all__ = ["Card", "Estimator", "NoveltyDetector", "Zero", "read_card"]
