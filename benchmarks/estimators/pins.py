"""Pins found and followed: ours beside OpenCV's blob detector, in one process and in turns.

Run ``python benchmarks/estimators/pins.py [--frames 60]``. Frames are those of a virtual TacTip's press, with
127 and with 331 pins. The detector is set as users of the TacTip set it for such images (grey levels, area,
roundness, convexity), and finds pins anew in every frame; ours finds them once and follows them. Before
anything is timed, both must find the same pins. No time is judged, only printed.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from scipy.spatial import cKDTree

from palpate.estimators.pins import PinTracks, find_pins, follow
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import record_press

ROUNDS = 7
SAME_PX = 0.25  # the detector's centres are those of outlines, ours of brightness


def blob_detector() -> cv2.SimpleBlobDetector:
    """Bright round blobs of a pin's size."""
    asked = cv2.SimpleBlobDetector.Params()
    asked.minThreshold, asked.maxThreshold, asked.thresholdStep = 40, 180, 10
    asked.filterByColor, asked.blobColor = True, 255
    asked.filterByArea, asked.minArea, asked.maxArea = True, 8, 400
    asked.filterByCircularity, asked.minCircularity = True, 0.6
    asked.filterByConvexity, asked.minConvexity = True, 0.7
    asked.filterByInertia, asked.minInertiaRatio = True, 0.2
    asked.minDistBetweenBlobs = 3
    return cv2.SimpleBlobDetector.create(asked)


def press(pins: int, frames: int) -> np.ndarray:
    """The last frames of a press on a specimen of 50 kPa, where pins move."""
    made = record_press(tactip(pins), "specimen=1.571", seed=0)
    return np.stack(list(made.frames()))[-frames:]


def check(frames: np.ndarray, detector: cv2.SimpleBlobDetector, pins: int) -> float:
    """Greatest distance between the two detectors' places of a pin [px]."""
    found = find_pins(frames[0])
    later = [found, *follow(frames[1:], found)]
    worst = 0.0
    for frame, now in zip(frames, later, strict=True):
        theirs = np.array([point.pt for point in detector.detect(frame)])
        anew = find_pins(frame).xy_px
        assert len(theirs) == len(anew) == now.found.sum() == pins, (len(theirs), len(anew), now.found.sum())
        tree = cKDTree(theirs)
        for ours in (anew, now.xy_px):
            far, which = tree.query(ours)
            assert len(np.unique(which)) == pins
            worst = max(worst, float(far.max()))
    assert worst < SAME_PX, worst
    return worst


def each(find: Callable[[np.ndarray], object], frames: np.ndarray) -> None:
    for frame in frames:
        find(frame)


def followed(frames: np.ndarray, first: PinTracks) -> None:
    for _ in follow(frames, first):
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=60)
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"Pins in {300} x {300} px, ms a frame, one thread; load {os.getloadavg()[0]:.1f}")
    for pins in (127, 331):
        frames = press(pins, asked.frames)
        detector = blob_detector()
        apart = check(frames, detector, pins)
        first = find_pins(frames[0])
        taken = _in_turns(
            {
                "cv2.SimpleBlobDetector": partial(each, detector.detect, frames),
                "ours, found anew": partial(each, find_pins, frames),
                "ours, followed": partial(followed, frames, first),
            },
            len(frames),
        )
        base = np.median(taken["cv2.SimpleBlobDetector"])
        print(f"  {pins} pins, found by all in each of {len(frames)} frames, at most {apart:.2f} px apart")
        for name, ms in taken.items():
            ratio = base / np.median(ms)
            spread = f"{ms.min():7.3f} to {ms.max():7.3f}"
            print(f"    {name:24s} median {np.median(ms):7.3f}, {spread}; {ratio:6.1f} x")


def _in_turns(calls: dict[str, Callable[[], object]], frames: int) -> dict[str, np.ndarray]:
    taken = {name: np.empty(ROUNDS) for name in calls}
    for i in range(-1, ROUNDS):
        for name, call in calls.items():
            started = time.perf_counter()
            call()
            if i >= 0:
                taken[name][i] = 1e3 * (time.perf_counter() - started) / frames
    return taken


if __name__ == "__main__":
    main()
