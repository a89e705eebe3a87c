"""Random reads of a run's frames against PNG files, both measured here and now.

Run ``python benchmarks/recordings/frames.py``. The baseline is a folder that ``cv2.imwrite`` wrote with its
defaults, read by ``cv2.imread``. Every reader reads the same frames in the same random order, and the
readers take turns, so that a slower moment of the machine meets them all. Files are in the page cache.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from palpate.core import ManualClock
from palpate.recordings import Manifest, Run, RunWriter

HEIGHT, WIDTH = 480, 640
Reader = Callable[[int], np.ndarray]
Extra = Callable[[Path], Mapping[str, Reader]]  # from a run's folder, further readers: the packed set's


@dataclass(frozen=True)
class Result:
    """One reader on one kind of image; times in ms a frame."""

    reader: str
    median_ms: float
    quartiles_ms: tuple[float, float]
    ratio: float  # the baseline's time over this reader's: above 1 is faster than PNG files
    ratio_spread: tuple[float, float]  # least and greatest over the rounds


def noisy_grey(rng: np.random.Generator) -> np.ndarray:
    """A smooth grey image with the noise of a camera."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    phase_x, phase_y = rng.uniform(0, 2 * np.pi, 2)
    light = 100 + 60 * np.sin(x / 50 + phase_x) * np.cos(y / 70 + phase_y)
    return np.clip(light + rng.normal(0, 4, light.shape), 0, 255).astype(np.uint8)


def markers(rng: np.random.Generator) -> np.ndarray:
    """White discs on black, each moved a little, as of a binarised marker skin."""
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    for y in range(20, HEIGHT - 10, 28):
        for x in range(20, WIDTH - 10, 28):
            dx, dy = rng.integers(-4, 5, 2)
            cv2.circle(image, (x + int(dx), y + int(dy)), int(rng.integers(4, 8)), 255, -1)
    return image


def record(images: Sequence[np.ndarray], run: Path) -> int:
    """Write the images as a run; its bytes, everything counted."""
    manifest = Manifest.new(sensor="benchmark", clock="ordinal")
    with RunWriter.create(run, manifest, clock=ManualClock(), overflow="wait") as writer:
        for i, image in enumerate(images):
            writer.frame(image, time_ns=i * 1_000_000_000)
    return sum(path.stat().st_size for path in run.iterdir())


def save_png(images: Sequence[np.ndarray], folder: Path) -> int:
    """Write the images as PNG files with OpenCV's defaults; their bytes."""
    folder.mkdir()
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / f"{i:06d}.png"), image)
    return sum(path.stat().st_size for path in folder.iterdir())


def measure(readers: Mapping[str, Reader], baseline: str, frames: int, rounds: int) -> list[Result]:
    """Time every reader over the same random orders."""
    rng = np.random.default_rng(0)
    times_ms = {name: np.empty((rounds, frames)) for name in readers}
    for r in range(rounds):
        order = rng.permutation(frames)
        for i, index in enumerate(order):
            for name, read in readers.items():
                begin = time.perf_counter()
                read(int(index))
                times_ms[name][r, i] = (time.perf_counter() - begin) * 1e3
    base = times_ms[baseline].sum(axis=1)
    results = []
    for name, taken in times_ms.items():
        ratios = base / taken.sum(axis=1)
        low, median, high = np.percentile(taken, [25, 50, 75])
        spread = (float(ratios.min()), float(ratios.max()))
        results.append(
            Result(name, float(median), (float(low), float(high)), float(np.median(ratios)), spread)
        )
    return results


def overhead_ms(run: Run, repeats: int = 200) -> float:
    """What a read takes beyond decoding the PNG: finding, reading, unpacking [ms], median."""
    stored = run.segments[0].frames
    begin = time.perf_counter()
    for i in range(repeats):
        stored[i % len(stored)].message(check=True)
    return (time.perf_counter() - begin) / repeats * 1e3


def compare(images: Sequence[np.ndarray], rounds: int, extra: Extra | None = None) -> None:
    """Record and save the images, and print how the readers compare."""
    with tempfile.TemporaryDirectory() as folder:
        run_path, png_path = Path(folder, "run"), Path(folder, "png")
        run_bytes, png_bytes = record(images, run_path), save_png(images, png_path)
        run = Run.open(run_path)
        readers: dict[str, Reader] = {
            "png files": lambda i: cv2.imread(str(png_path / f"{i:06d}.png"), cv2.IMREAD_UNCHANGED),
            "run": lambda i: run.frame(i).image,
            **(extra(run_path) if extra else {}),
        }
        for i in range(len(images)):
            np.testing.assert_array_equal(readers["run"](i), readers["png files"](i))
        print(f"  bytes: run {run_bytes}, png files {png_bytes}, ratio {run_bytes / png_bytes:.3f}")
        print(f"  read and unpack with checksum, no decoding: {overhead_ms(run):.3f} ms a frame")
        for result in measure(readers, "png files", len(images), rounds):
            low, high = result.quartiles_ms
            least, most = result.ratio_spread
            print(
                f"  {result.reader:10s} median {result.median_ms:.3f} ms (quartiles {low:.3f}, {high:.3f}); "
                f"speed of png files x {result.ratio:.2f} (rounds {least:.2f} to {most:.2f})"
            )


def main(extra: Extra | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=5)
    asked = parser.parse_args()
    rng = np.random.default_rng(0)
    for make in (noisy_grey, markers):
        print(f"{make.__name__}, {asked.frames} frames of {WIDTH} x {HEIGHT}, {asked.rounds} rounds")
        compare([make(rng) for _ in range(asked.frames)], asked.rounds, extra)


if __name__ == "__main__":
    main()
