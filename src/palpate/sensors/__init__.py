"""Sensor designs, a module or folder each: their numbers, what presses them, and how they render.

`from palpate.sensors import palm, tactip` loads designs; they are not loaded by those who only sense.
"""

from palpate.recordings.preparation import Preparation

__all__ = ["Preparation"]
