"""Time of spline, strain and localisation a frame of NUSense, marks followed and marks that change.

Run ``python benchmarks/estimators/surface_strain.py [--rounds 200]``. Marks are the true corners of a press
of the virtual pad with noise of 0.05 px, 300 of them, and the surface has 164 x 164 samples. A mark set is
kept from the frame before, or has lost marks, so that its operators are made anew.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

import palpate
from palpate.core import Contact, Pose
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.surface_strain import (
    PatternedSkin,
    StrainMeter,
    edge_direction,
    find_rings,
    on_plane,
    recover_traction,
)

SENSOR = palpate.sensor("nusense")
SIGMA_PX = 0.05


def marks(contact: Contact, rng: np.random.Generator, lost: int = 0) -> ControlPoints:
    """Corners on the pattern, without the first few."""
    truth = SENSOR.tile_corners(contact)
    places = truth.places_px + SIGMA_PX * rng.normal(size=truth.places_px.shape)
    found = ControlPoints(truth.cells[lost:], places[lost:], np.full(len(places) - lost, SIGMA_PX))
    return on_plane(found, SENSOR.spec.lens, SENSOR.spec.camera_m)


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
    tasks: dict[str, tuple[Callable[[int], object], int]] = {
        "spline and strain, marks followed": (lambda i: meter.fields(frames[i % 8]), rounds),
        "localisation": (lambda i: find_rings(fields[i % 8]), rounds),
        "all three, marks followed": (lambda i: find_rings(meter.fields(frames[i % 8])), rounds),
        "spline and strain, marks changed": (lambda i: meter.fields(fewer[i % 40]), min(rounds, 40)),
        "standard errors of all fields": (lambda i: fields[i % 8].errors(), max(rounds // 20, 3)),
        "edge direction with interval": (lambda i: edge_direction(edges[i % 8]), max(rounds // 20, 3)),
        "traction, frictionless": (lambda i: recover_traction(fields[i % 8], skin), max(rounds // 20, 3)),
    }
    for name, (task, times) in tasks.items():
        print(f"{name:36s} {median_ms(task, times):8.2f} ms")


if __name__ == "__main__":
    main()
