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
from palpate.sensing.live_sources import LiveFrame

RATE_HZ, WARM_S, SOAK_S = 60.0, 10.0, 50.0
MAX_GROWTH_MB = 4.0  # twelve frames: whatever is kept of each of three thousand is seen
MAX_DROPPED = 1e-3


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
        begun_s, number = time.monotonic(), 0
        while not over.is_set():
            time.sleep(max(begun_s + number / RATE_HZ - time.monotonic(), 0.0))
            image = np.full((480, 640), number % 251, np.uint8)  # 0.3 MB, new each time
            source.give(LiveFrame(Frame(image, number / RATE_HZ), time.monotonic_ns(), number))
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
    assert read > 0.9 * SOAK_S * RATE_HZ
    assert after.dropped - before.dropped <= MAX_DROPPED * read
    assert grown_mb < MAX_GROWTH_MB
