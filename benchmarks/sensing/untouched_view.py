"""Time of a look at a frame without a calibration, beside the plain way: differences at full size, by SciPy.

The plain way smooths the difference of every pixel, thresholds it and labels what is left; it knows no change
of brightness, no noise of each place, and no moved camera. Frames are in memory; CPU time of one thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy import ndimage

LOOKS, ROUNDS = 20, 5
NOISE, LEVEL = 2.0, 20.0  # grey levels


def frames(size: tuple[int, int], channels: int, count: int) -> list[np.ndarray]:
    """Frames of an evenly lit skin, with noise."""
    rng = np.random.default_rng(0)
    shape = (size[1], size[0], channels) if channels > 1 else (size[1], size[0])
    noisy = (rng.normal(100, NOISE, shape).astype(np.float32) for _ in range(count))
    return [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in noisy]


def pressed(frame: np.ndarray) -> np.ndarray:
    """A frame with a disc that differs."""
    height, width = frame.shape[:2]
    disc = np.zeros((height, width), np.uint8)
    cv2.circle(disc, (width // 3, height // 2), height // 8, 1, -1)
    return frame + (LEVEL * disc).astype(np.uint8).reshape(height, width, *([1] * (frame.ndim - 2)))


def plain(mean: np.ndarray, frame: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre and area of the largest difference of more than half the level, the plain way."""
    apart = np.abs(frame.astype(np.float64) - mean)
    apart = apart if apart.ndim == 2 else apart.mean(axis=2)
    label, count = ndimage.label(ndimage.gaussian_filter(apart, 3.0) > LEVEL / 2)
    if count == 0:
        return np.full(2, np.nan), 0.0
    sizes = ndimage.sum_labels(np.ones_like(label), label, np.arange(1, count + 1))
    best = 1 + int(np.argmax(sizes))
    return np.array(ndimage.center_of_mass(label == best))[::-1], float(sizes.max())


def milliseconds(call: Callable[[], object]) -> np.ndarray:
    """CPU time of a call in each round [ms]."""
    call()
    taken = np.empty(ROUNDS)
    for i in range(ROUNDS):
        started = time.process_time()
        for _ in range(LOOKS):
            call()
        taken[i] = (time.process_time() - started) / LOOKS
    return 1e3 * taken


def main() -> None:
    from palpate.sensing.untouched_view import UntouchedView

    cv2.setNumThreads(1)
    print("CPU time of a look [ms], median and range of rounds; the plain way in the same run")
    print("frame               touched          untouched        plain way         ratio")
    for size, channels in (((640, 480), 1), ((640, 480), 3), ((1280, 720), 3)):
        still = frames(size, channels, 9)
        view, mean = UntouchedView(still[:8]), np.mean(still[:8], axis=0)
        touched = pressed(still[8])
        seen, (centre, area) = view.seen(touched).region, plain(mean, touched)
        assert seen is not None
        assert np.hypot(*(np.array(seen.centre_px) - centre)) < 1
        assert abs(seen.area_px / area - 1) < 0.03
        times = [
            milliseconds(lambda v=view, f=touched: v.seen(f)),
            milliseconds(lambda v=view, f=still[8]: v.seen(f)),
            milliseconds(lambda m=mean, f=touched: plain(m, f)),
        ]
        told = "  ".join(f"{np.median(t):6.2f} ({t.min():.2f}-{t.max():.2f})" for t in times)
        ratio = np.median(times[2]) / np.median(times[0])
        print(f"{size[0]:4} x {size[1]:4} {'grey' if channels == 1 else 'RGB ':4}  {told}  {ratio:5.1f}")


if __name__ == "__main__":
    main()
