"""A child that records until it is killed, and notes when each frame was accepted.

Arguments: the run's folder, a file for the notes, a seed. A note is ``number time``, the time on the
machine's monotonic clock [ns] after the call returned. Frames come at an uneven rate, with pauses, so that
data must reach the disk by time and not only by size.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np

from palpate.recordings import Manifest, RunWriter


def picture(number: int) -> np.ndarray:
    """The image that a number stands for."""
    return np.random.default_rng(number).integers(0, 256, (24, 32), np.uint8)


def record(run: Path, notes: Path, seed: int) -> None:
    """Record until killed."""
    rng = np.random.default_rng(seed)
    manifest = Manifest.new(sensor="s", labels={"number": "number"})
    log = os.open(notes, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    number = 0
    with RunWriter.create(run, manifest) as writer:
        while True:
            if writer.frame(picture(number), labels={"number": number}):
                os.write(log, f"{number} {time.monotonic_ns()}\n".encode())
                number += 1
            writer.force([float(number)] * 6)
            time.sleep(rng.choice([0.001, 0.005, 0.3], p=[0.6, 0.38, 0.02]))


if __name__ == "__main__":
    record(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
