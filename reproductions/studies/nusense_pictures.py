"""Pictures of NUSense for its explanation: frames, and how far the tiles move.

Run ``python reproductions/studies/nusense_pictures.py docs/images``; it writes both as PNG.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt

import palpate
from palpate.core import Pose
from palpate.sensors.nusense.nusense_sensor import NuSense

FORCE_N = 8.0
SHOWN = {"round, 8 N": "round", "flat, 8 N": "flat", "edge of 25 mm at 60 degrees, 8 N": "edge:25:60"}
STEPS = 24


def depth_of(sensor: NuSense, words: str, force_n: float) -> float:
    """Depth at which an indenter bears a force, by halving [m]."""
    probe = sensor.probe(words)
    low, high = 0.0, sensor.known_depth_m(probe)
    for _ in range(STEPS):
        middle = (low + high) / 2
        below = sensor.press(probe, Pose(0.0, 0.0, middle)).force_n < force_n
        low, high = (middle, high) if below else (low, middle)
    return low


def main(folder: Path) -> None:
    """Draw both pictures."""
    sensor = NuSense()
    x0, y0, w, h = sensor.regions()["pad"]
    frames, frame_axes = plt.subplots(1, 3, figsize=(12, 3.9))
    rings, ring_axes = plt.subplots(1, 3, figsize=(12, 3.6))
    for (title, words), shown, ring in zip(SHOWN.items(), frame_axes, ring_axes, strict=True):
        contact = sensor.press(sensor.probe(words), Pose(0.0, 0.0, depth_of(sensor, words, FORCE_N)))
        frame = sensor.render(contact, np.random.default_rng(0)).image
        shown.imshow(frame[y0 : y0 + h, x0 : x0 + w])
        shown.set(title=title, xticks=[], yticks=[])
        x, y = np.meshgrid(np.linspace(-25e-3, 25e-3, 126), np.linspace(-19e-3, 19e-3, 96))
        moved = sensor.motion(contact).at(x.ravel(), y.ravel()).reshape(3, *x.shape)
        far = ring.pcolormesh(1e3 * x, 1e3 * y, 1e3 * np.hypot(*moved[:2]), shading="gouraud")
        truth = sensor.tile_corners(contact)
        ring.quiver(
            *(1e3 * truth.rest_m.T), *(1e3 * (truth.skin_m[:, :2] - truth.rest_m).T), color="w", scale=10
        )
        ring.set(title=title, xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
        rings.colorbar(far, ax=ring, label="moved along the pad [mm]", orientation="horizontal")
    frames.tight_layout()
    rings.tight_layout()
    frames.savefig(folder / "nusense-frames.png", dpi=80)
    rings.savefig(folder / "nusense-ring.png", dpi=80)
    print(palpate.__name__, "pictures in", folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
