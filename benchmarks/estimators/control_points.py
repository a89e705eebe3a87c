"""Control points of a patterned pad: the published chain, the robust detector, and following.

Run ``python benchmarks/estimators/control_points.py [--rounds 9]``. Frames are 1280 x 960 px, a checkerboard
of 48 px tiles rendered with noise; loading is not counted. The published chain is what a user would write
from the paper with OpenCV and NumPy.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.rendered_boards import View, board, noisy

from palpate.estimators.lattice import (
    MarkTracker,
    find_checkerboard,
)
from palpate_reproductions.nusense.quadrilaterals import (
    QuadSettings,
    published_stages,
)


def frames() -> list[np.ndarray]:
    """A pad at rest and pressed a little."""
    rng = np.random.default_rng(0)
    views = [
        View(pitch=48.0, turn=0.08, shear=0.05, size=(1280, 960), at=(600, 450), reach=120, bulge=b)
        for b in (0.0, 2.0)
    ]
    return [noisy(board(view, samples=2), rng) for view in views]


def timed(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, np.ndarray]:
    """Milliseconds of each call, in turns, after one that does not count."""
    taken = {name: np.empty(rounds) for name in calls}
    for k in range(-1, rounds):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            if k >= 0:
                taken[name][k] = 1e3 * (time.perf_counter() - started)
    return taken


def table(title: str, taken: dict[str, np.ndarray]) -> None:
    print(f"{title}; load {os.getloadavg()[0]:.1f}")
    base = np.median(next(iter(taken.values())))
    for name, ms in taken.items():
        spread = f"{ms.min():8.2f} to {ms.max():8.2f}"
        print(f"  {name:34s} median {np.median(ms):8.2f}, {spread}; {base / np.median(ms):6.1f} x")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    cv2.setNumThreads(1)
    rest, pressed = frames()
    settings = QuadSettings(pitch_px=45.0)
    midpoints = published_stages(rest, settings).midpoints
    tracker = MarkTracker(rest, 45.0)
    pair = [pressed, rest]
    tracked = []

    def follow() -> None:
        pair.reverse()
        tracked.append(tracker.follow(pair[0]).found_anew)

    taken = timed(
        {
            "published chain": lambda: published_stages(rest, settings),
            "robust detector, with errors": lambda: find_checkerboard(rest, 45.0),
            "followed, with errors": follow,
        },
        rounds,
    )
    assert not any(tracked)
    table(f"{len(midpoints)} midpoints, 1280 x 960 px, ms a frame, one thread", taken)


if __name__ == "__main__":
    main()
