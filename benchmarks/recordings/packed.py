"""Random reads of a packed set against the same reads of a bare memory map, in one run.

Run ``python benchmarks/recordings/packed.py``. For both the file stays in the machine's page cache, so that
the work of reading is compared and not the disk.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from palpate.core import ManualClock
from palpate.recordings import Manifest, PackedSet, Run, RunWriter, pack
from palpate.recordings.preparation import Preparation

FRAMES, SIDE_PX, READS, BATCH, ROUNDS = 4000, 128, 4000, 32, 15


def packed_set(folder: Path, rng: np.random.Generator) -> PackedSet:
    manifest = Manifest.new(sensor="benchmark", clock="ordinal")
    with RunWriter.create(folder / "run", manifest, clock=ManualClock(), overflow="wait") as writer:
        for i in range(FRAMES):
            writer.frame(rng.integers(0, 256, (8, 8), dtype=np.uint8), time_ns=i)
    return pack(Run.open(folder / "run"), folder / "packed", Preparation(None, (SIDE_PX, SIDE_PX), 1))


def seconds(read: Callable[[np.ndarray], np.ndarray], batches: list[np.ndarray]) -> float:
    start = time.perf_counter()
    for rows in batches:
        read(rows)
    return time.perf_counter() - start


def main() -> None:
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        packed = packed_set(Path(folder), rng)
        bare = np.load(packed.folder / "frames.npy", mmap_mode="r")
        rows = rng.integers(0, FRAMES, BATCH)
        assert np.array_equal(packed.read(rows), bare[rows])
        ours, theirs = [], []
        for _ in range(ROUNDS):  # taken in turn, so that both see the machine's other work
            batches = np.array_split(rng.integers(0, FRAMES, READS), READS // BATCH)
            ours.append(seconds(packed.read, batches))
            theirs.append(seconds(lambda rows: bare[rows], batches))
    for name, times in (("packed set", ours), ("bare memmap", theirs)):
        micros = np.array(times) / READS * 1e6
        low, median, high = np.quantile(micros, [0.25, 0.5, 0.75])
        print(f"{name:12s} {median:6.2f} µs a frame, middle half {low:.2f} to {high:.2f}")
    ratio = np.array(theirs) / np.array(ours)
    low, median, high = np.quantile(ratio, [0.25, 0.5, 0.75])
    print(f"speed against the memmap: {median:.2f}, middle half {low:.2f} to {high:.2f} (0.3 is wanted)")


if __name__ == "__main__":
    main()
