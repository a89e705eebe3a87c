"""A small run for the tests of the pages: presses with force, ten frames a second."""

import numpy as np

from palpate.core import ManualClock
from palpate.core.provenance import Provenance
from palpate.recordings import Manifest, RunWriter


def write_small_run(path, frames=30, sensor="made up", step_s=0.1, provenance=Provenance.MEASURED):
    """A run of three presses whose pictures grow brighter with the frame's number."""
    clock = ManualClock()
    labels = {"force_N": "number", "press": "text", "reference": "flag"}
    manifest = Manifest.new(sensor=sensor, labels=labels, targets=("force_N",), provenance=provenance)
    path.parent.mkdir(parents=True, exist_ok=True)
    with RunWriter.create(path, manifest, clock=clock, overflow="wait") as writer:
        for i in range(frames):
            force_n = float(i % 10)
            image = np.full((24, 32, 3), 5 * i, np.uint8)
            about = {"force_N": force_n, "press": f"p{i // 10}", "reference": i % 10 == 0}
            writer.frame(image, labels=about)
            writer.force((0.0, 0.0, force_n, 0.0, 0.0, 0.0))
            clock.sleep(step_s)
    return path
