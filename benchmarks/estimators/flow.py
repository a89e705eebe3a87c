"""Horn and Schunck's flow with its divergence: ours beside what is run today, in one process and in turns.

Run ``python benchmarks/estimators/flow.py [--frames 200] [--threads 2]``. A sequence of 127 stretching pins,
300 x 300 px with grey noise, goes through each in rounds; the script of numpy and scipy.ndimage.convolve, the
usual one, through a few of its pairs. One line of ours reads the frames from a multi-page TIFF, too. Results
are let go as they come. Memory is that of the whole sequence and of a quarter of it. What a second thread can
give depends on whether it has a core of its own: the last line measures it with loops that touch no memory.
No number is judged, only printed.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterable
from functools import partial
from itertools import islice
from pathlib import Path
from threading import Thread

import cv2
import numba
import numpy as np
import tifffile
from scipy import ndimage

from palpate.estimators.flow.horn_schunck import HornSchunck, along, dis, divergence, flow
from palpate.recordings.exchange.frame_sequences import TiffFrames

ROUNDS, SLOW_PAIRS = 5, 3
KERNEL = np.array([[1, 2, 1], [2, 0, 2], [1, 2, 1]]) / 12


def sequence(frames: int) -> np.ndarray:
    """Pins that stretch about the middle by a tenth."""
    rng = np.random.default_rng(0)
    y, x = np.indices((300, 300))
    steps = [(i, j) for i in range(-6, 7) for j in range(-6, 7) if abs(i + j) <= 6]
    made = np.empty((frames, 300, 300), np.uint8)
    for k in range(frames):
        image = np.full((300, 300), 18.0)
        for i, j in steps:
            px, py = 149.5 + np.array([20 * (i + j / 2), 17.3 * j]) * (1 + 0.1 * k / frames)
            near = (slice(max(0, int(py) - 10), int(py) + 11), slice(max(0, int(px) - 10), int(px) + 11))
            disc = 200 * np.clip((7.5 - np.hypot(x[near] - px, y[near] - py)) / 1.5 + 0.5, 0, 1)
            image[near] = np.maximum(image[near], disc)
        made[k] = np.clip(np.rint(image + rng.normal(0, 2, image.shape)), 0, 255)
    return made


def usual_script(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A lab's usual script: two convolutions an iteration."""
    a, b = (np.pad(image / 255.0, ((0, 1), (0, 1)), mode="edge") for image in (a, b))
    x = sum(i[:-1, 1:] - i[:-1, :-1] + i[1:, 1:] - i[1:, :-1] for i in (a, b)) / 4
    y = sum(i[1:, :-1] - i[:-1, :-1] + i[1:, 1:] - i[:-1, 1:] for i in (a, b)) / 4
    d = b - a
    t = (d[:-1, :-1] + d[:-1, 1:] + d[1:, :-1] + d[1:, 1:]) / 4
    u, v = np.zeros((2, *x.shape))
    for _ in range(26):
        u_mean = ndimage.convolve(u, KERNEL, mode="nearest")
        v_mean = ndimage.convolve(v, KERNEL, mode="nearest")
        off = (x * u_mean + y * v_mean + t) / (0.01 + x**2 + y**2)
        u, v = u_mean - x * off, v_mean - y * off
    return np.gradient(u, axis=1) + np.gradient(v, axis=0)


def filtered_script(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The same with OpenCV's filters in single precision, written with care."""
    a, b = (np.pad(np.float32(i) / 255, ((0, 1), (0, 1)), mode="edge") for i in (a, b))
    c = np.stack([a, b])
    across, down, later = c[:, :, 1:] - c[:, :, :-1], c[:, 1:] - c[:, :-1], b - a
    x = (across[:, :-1] + across[:, 1:]).sum(axis=0) / 4
    y = (down[:, :, :-1] + down[:, :, 1:]).sum(axis=0) / 4
    t = (later[:-1, :-1] + later[:-1, 1:] + later[1:, :-1] + later[1:, 1:]) / 4
    g = 1 / np.sqrt(np.float32(0.01) + x * x + y * y)
    x, y, t = x * g, y * g, t * g
    u, v = np.zeros((2, *x.shape), np.float32)
    kernel = KERNEL.astype(np.float32)
    for _ in range(26):
        p = cv2.filter2D(u, -1, kernel, borderType=cv2.BORDER_REPLICATE)
        q = cv2.filter2D(v, -1, kernel, borderType=cv2.BORDER_REPLICATE)
        off = x * p + y * q + t
        u, v = p - x * off, q - y * off
    return np.gradient(u, axis=1) + np.gradient(v, axis=0)


def spread(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return divergence(flow(a, b, HornSchunck()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    frames = sequence(asked.frames)
    few = frames[: SLOW_PAIRS + 1]
    pyoptflow = _pyoptflow()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "press.tif"
        with tifffile.TiffWriter(path) as writer:
            for frame in frames:
                writer.write(frame, contiguous=False)

        def from_tiff(last: int | None = None) -> None:
            with TiffFrames(path) as pages:
                _drain(along(islice(pages, last), spread, threads=asked.threads))

        calls: dict[str, tuple[Callable[[], object], int]] = {
            "numpy + scipy.ndimage.convolve": (lambda: _drain(map(usual_script, few, few[1:])), SLOW_PAIRS),
            "numpy + cv2.filter2D": (lambda: _drain(map(filtered_script, frames[:20], frames[1:20])), 19),
            "ours, one thread": (lambda: _drain(along(frames, spread, threads=1)), len(frames) - 1),
            f"ours, {asked.threads} threads": (
                lambda: _drain(along(frames, spread, threads=asked.threads)),
                len(frames) - 1,
            ),
            f"ours, {asked.threads} threads, from a TIFF": (from_tiff, len(frames) - 1),
            "OpenCV DIS, medium": (lambda: _drain(map(dis, frames[:20], frames[1:20])), 19),
        }
        if pyoptflow:
            calls["pyoptflow"] = (lambda: _drain(map(pyoptflow, few, few[1:])), SLOW_PAIRS)
        taken = _in_turns(calls)
        memory = [_peak(partial(from_tiff, last)) for last in (asked.frames // 4, asked.frames)]
    base = taken["numpy + scipy.ndimage.convolve"]
    print(
        f"Horn-Schunck and divergence, 300 x 300 px, 26 iterations, ms a pair; load {os.getloadavg()[0]:.1f}"
    )
    for name, ms in taken.items():
        ratio = np.median(base) / np.median(ms)
        print(f"  {name:42s} median {np.median(ms):8.3f}, {ms.min():8.3f} to {ms.max():8.3f}; {ratio:6.1f} x")

    print(
        f"  memory from a TIFF: at most {memory[0] / 1e6:.1f} MB for {asked.frames // 4} frames, "
        f"{memory[1] / 1e6:.1f} MB for {asked.frames}"
    )
    print(f"  {asked.threads} threads that count do {_gain(asked.threads):.2f} times the work of one")


def _drain(results: Iterable[object]) -> None:
    for _ in results:
        pass


def _peak(call: Callable[[], object]) -> int:
    """Bytes that a call has at most."""
    tracemalloc.start()
    call()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


@numba.njit(nogil=True)
def _count(n: int) -> int:
    x = 1
    for _ in range(n):
        x = (x * 1664525 + 1013904223) ^ (x >> 7)
    return x


def _gain(threads: int) -> float:
    """Work of so many threads over that of one, in the same time."""

    def taken(many: int) -> float:
        workers = [Thread(target=_count, args=(50_000_000,)) for _ in range(many)]
        started = time.perf_counter()
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        return time.perf_counter() - started

    _count(1)
    return float(np.median([threads * taken(1) / taken(threads) for _ in range(ROUNDS)]))


def _pyoptflow() -> Callable[[np.ndarray, np.ndarray], object] | None:
    try:
        from pyoptflow import HornSchunck as Theirs  # type: ignore[import-untyped]
    except ImportError:
        return None
    return lambda a, b: Theirs(a / 255, b / 255, alpha=0.1, Niter=26)


def _in_turns(calls: dict[str, tuple[Callable[[], object], int]]) -> dict[str, np.ndarray]:
    taken = {name: np.empty(ROUNDS) for name in calls}
    for i in range(-1, ROUNDS):
        for name, (call, pairs) in calls.items():
            started = time.perf_counter()
            call()
            if i >= 0:
                taken[name][i] = 1e3 * (time.perf_counter() - started) / pairs
    return taken


if __name__ == "__main__":
    main()
