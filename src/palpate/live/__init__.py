"""The loop in real time: a source of frames, an estimator, readings."""

from palpate.live.sense import Sensed, sense
from palpate.live.sources import ImageFiles, RunFrames, Source, open_source

__all__ = ["ImageFiles", "RunFrames", "Sensed", "Source", "open_source", "sense"]
