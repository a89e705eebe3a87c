"""The photoelastic palm's study: the source's comparison reproduced on the virtual rig, and more."""

from palpate_reproductions.palm.palm_reproduction import PARTS, reproduce_palm
from palpate_reproductions.palm.palm_setup import SCALES, Scale, scale_of

__all__ = ["PARTS", "SCALES", "Scale", "reproduce_palm", "scale_of"]
