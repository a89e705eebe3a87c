"""A live loop that runs for long: its memory stays as it is, and nothing is dropped."""

from __future__ import annotations

import gc
import os
import threading
import time

import numpy as np
import pytest
from tests.sensing.live_stand_ins import HandedFrames, MeanReader

from palpate.core import Frame
from palpate.sensing.live_loop import LiveLoop

RATE_HZ, WARM_S, SOAK_S = 30.0, 10.0, 50.0
MAX_GROWTH_MB = 4.0  # twelve frames: whatever is kept of each of 1500 is seen
MAX_DROPPED = 1e-3
MAX_LOAD = 1.5  # of a core, beyond which threads wait for the processor longer than for a frame


class Newest:
    def on_frame(self, frame, readings) -> None:
        self.frame = frame

    def on_force(self, samples) -> None:
        pass


def resident_mb() -> float:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="memory is read from /proc")
def test_memory_is_flat_and_nothing_is_dropped_over_a_minute() -> None:
    source, over = HandedFrames(waits=False), threading.Event()

    def film() -> None:
        due_s, number = time.monotonic(), 0
        while not over.is_set():
            due_s = max(due_s + 1 / RATE_HZ, time.monotonic())  # where all stood still, no burst follows
            time.sleep(max(due_s - time.monotonic(), 0.0))
            image = np.full((480, 640), number % 251, np.uint8)  # 0.3 MB, new each time
            source.give(Frame(image, number / RATE_HZ, index=number, arrived_ns=time.monotonic_ns()))
            number += 1

    with LiveLoop(lambda: source, MeanReader(), source=source, subscribers=[Newest()]) as loop:
        loop.start()
        camera = threading.Thread(target=film)
        camera.start()
        time.sleep(WARM_S)
        gc.collect()
        before, begun_mb = loop.stats, resident_mb()
        time.sleep(SOAK_S)
        gc.collect()
        after, grown_mb = loop.stats, resident_mb() - begun_mb
        over.set()
        camera.join()
    read = after.frames - before.frames
    assert grown_mb < MAX_GROWTH_MB
    assert read + after.dropped - before.dropped > 0.5 * SOAK_S * RATE_HZ
    busy = os.getloadavg()[0] / (os.cpu_count() or 1)
    if busy > MAX_LOAD:
        pytest.skip(f"memory is flat; drops say nothing at a load of {busy:.1f} a core")
    assert after.dropped - before.dropped <= MAX_DROPPED * read
