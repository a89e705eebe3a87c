"""Time of spline, strain and localisation a frame of NUSense, marks followed and marks that change.

Run ``python benchmarks/estimators/surface_strain.py [--rounds 200]``. Marks are the true corners of a press
of the virtual pad with noise of 0.05 px, 300 of them, and the surface has 164 x 164 samples. A mark set is
kept from the frame before, or has lost marks, so that its operators are made anew. The frame of the same
press is detected in the same run: by the chain that the thesis prints, and by the robust detector.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

import palpate
from palpate.core import Contact, Pose
from palpate.estimators.lattice import ControlPoints, find_checkerboard
from palpate.estimators.surface_strain import (
    PatternedSkin,
    StrainMeter,
    edge_direction,
    find_rings,
    on_plane,
    recover_traction,
)
from palpate_reproductions.nusense.quadrilaterals import QuadSettings, published_stages

SENSOR = palpate.sensor("nusense")
SIGMA_PX = 0.05
ALL_THREE = "all three, marks followed"
PUBLISHED, ROBUST = "detection, published chain", "detection, robust"


def marks(contact: Contact, rng: np.random.Generator, lost: int = 0) -> ControlPoints:
    """Corners on the pattern, without the first few."""
    truth = SENSOR.tile_corners(contact)
    places = truth.places_px + SIGMA_PX * rng.normal(size=truth.places_px.shape)
    found = ControlPoints(truth.cells[lost:], places[lost:], np.full(len(places) - lost, SIGMA_PX))
    return on_plane(found, SENSOR.spec.lens, SENSOR.spec.camera_m)


def tile_width(sensor: palpate.Sensor) -> float:
    """Width of a tile at rest, in the frame's middle [px]."""
    truth = sensor.tile_corners(sensor.press(sensor.probe("round"), Pose(0.0, 0.0, 0.0)))
    places = {tuple(cell): place for cell, place in zip(truth.cells.tolist(), truth.places_px, strict=True)}
    steps = [
        float(np.linalg.norm(place - places[i + 1, j]))
        for (i, j), place in places.items()
        if (i + 1, j) in places
    ]
    return float(np.median(steps))


def median_ms(task: Callable[[int], object], rounds: int) -> float:
    """Median time of a task, given the number of its round."""
    task(0)
    times = []
    for i in range(rounds):
        begun = time.perf_counter()
        task(i)
        times.append(time.perf_counter() - begun)
    return 1e3 * float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=200)
    rounds = parser.parse_args().rounds
    rng, spec = np.random.default_rng(0), SENSOR.spec
    rest, pressed = (
        SENSOR.press(SENSOR.probe("round"), Pose(3e-3, -2e-3, depth)) for depth in (0.0, 1.46e-3)
    )
    meter = StrainMeter(marks(rest, rng))
    frames = [marks(pressed, rng) for _ in range(8)]
    fewer = [marks(pressed, rng, lost) for lost in range(1, 41)]
    fields = [meter.fields(frame) for frame in frames]
    edge = SENSOR.press(SENSOR.probe("edge:20:30"), Pose(0.0, 0.0, 0.7e-3))
    edges = [meter.fields(marks(edge, rng)) for _ in range(8)]
    skin = PatternedSkin(spec.layers.stack, 2, spec.camera_m)
    cv2.setNumThreads(1)
    frame, tile_px = SENSOR.render(pressed, rng).image, tile_width(SENSOR)
    settings = QuadSettings(pitch_px=tile_px)
    tasks: dict[str, tuple[Callable[[int], object], int]] = {
        "spline and strain, marks followed": (lambda i: meter.fields(frames[i % 8]), rounds),
        "localisation": (lambda i: find_rings(fields[i % 8]), rounds),
        ALL_THREE: (lambda i: find_rings(meter.fields(frames[i % 8])), rounds),
        "spline and strain, marks changed": (lambda i: meter.fields(fewer[i % 40]), min(rounds, 40)),
        "edge direction with interval": (lambda i: edge_direction(edges[i % 8]), max(rounds // 20, 3)),
        "traction, frictionless": (lambda i: recover_traction(fields[i % 8], skin), max(rounds // 20, 3)),
    }
    tasks |= {
        PUBLISHED: (lambda i: published_stages(frame, settings), max(rounds // 10, 3)),
        ROBUST: (lambda i: find_checkerboard(frame, tile_px), max(rounds // 10, 3)),
    }
    taken = {name: median_ms(task, times) for name, (task, times) in tasks.items()}
    for name, ms in taken.items():
        print(f"{name:36s} {ms:8.2f} ms")
    for name in (PUBLISHED, ROBUST):
        print(f"all three, marks followed: {taken[ALL_THREE] / taken[name]:.1%} of {name}")


if __name__ == "__main__":
    main()
