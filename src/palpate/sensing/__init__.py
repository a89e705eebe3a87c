"""The loop in real time: a source of frames, an estimator, readings."""

from palpate.sensing.frame_sources import FrameStream, ImageFiles, RunFrames, open_source
from palpate.sensing.sensing_loop import Sensed, sense

__all__ = ["FrameStream", "ImageFiles", "RunFrames", "Sensed", "open_source", "sense"]
