"""Fringe orders by pixel: how right, beside each pixel's nearest colour and one channel inverted; how fast.

Run ``python benchmarks/estimators/fringe_orders.py [--rounds 15] [--picture orders.png]``. A disc pressed
across its diameter fills 640 x 480 px, in 8-bit sRGB with photon and read noise and a blur of 0.7 px, once
with the assumed lamp and camera, once with others; it is read by the assumed table and by one measured on a
beam in bending under the same light. Errors are of pixels within the table's orders. No number is judged,
only printed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.core import new_file
from palpate.estimators.fringe_light import Polariscope, white_led
from palpate.estimators.fringe_map import (
    ColourReader,
    OrderMap,
    flat_field,
    grey_order,
    line_orders,
    measured_table,
    nearest_colour,
    table_of,
)
from palpate.mechanics.probe_contact import disc_difference
from palpate.optics import assumed_camera, electrons, encode_srgb
from palpate.optics.colour import linear_light
from palpate.reports.field_figures import draw_orders

SIZE = 480, 640
WELL, READ_E, LEAK, FULL = 12_000, 8.0, 0.005, 0.9
AT_CENTRE, TOP = 1.2, 3.6  # orders
COLOUR_ERROR = 0.02
OTHER = Polariscope(
    assumed_camera(
        camera_peaks_nm=(607.0, 532.0, 465.0),
        camera_widths_nm=(32.0, 44.0, 27.0),
        led_peaks_nm=(455.0, 565.0),
    ),
    550e-9,
    "another lamp and camera",
    dispersion_m2=1e-14,
)


def disc() -> tuple[np.ndarray, np.ndarray]:
    """Orders over the centre's, and where the disc is."""
    h, w = SIZE
    y, x = np.mgrid[-1 : 1 : h * 1j, -w / h : w / h : w * 1j]
    share, _ = disc_difference(x / 0.97, y / 0.97)
    inside = np.hypot(x, y) < 0.95
    return np.where(inside, np.minimum(np.nan_to_num(share), 8), 0.0), inside


def photograph(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """8-bit codes of what passes the polarisers."""
    blurred = gaussian_filter(LEAK + FULL * light, (0.7, 0.7, *[0] * (light.ndim - 2)))
    return encode_srgb(electrons(blurred * WELL, READ_E, rng) / WELL)


def told(
    name: str, order: np.ndarray, truth: np.ndarray, use: np.ndarray, found: OrderMap | None = None
) -> None:
    """Print errors where an order is told."""
    valid = use if found is None else use & found.valid
    error = (order - truth)[valid]
    line = (
        f"{name:<46}{valid.sum() / use.sum():>7.1%} told, median error {np.median(np.abs(error)):.4f}, "
        f"rms {np.sqrt(np.mean(error**2)):.3f}, off by 0.2 or more {np.mean(np.abs(error) > 0.2):.2%}"
    )
    if found is not None:
        line += f", within 1.96 sigma {np.mean(np.abs(error / found.sigma[valid]) < 1.96):.1%}"
    print(line)


def took(name: str, work: Callable[[], Any], rounds: int) -> None:
    """Print the median time, once compiled."""
    work()
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    print(f"{name:<46}{1e3 * median(times):>7.1f} ms a frame (best {1e3 * min(times):.1f})")


def main() -> None:
    """Print all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--picture", type=Path, help="PNG of the second disc's map; must not exist")
    given = parser.parse_args()
    rounds = given.rounds
    share, inside = disc()
    truth, rng = AT_CENTRE * share, np.random.default_rng(0)
    use = inside & (truth < TOP - 0.3)
    h, w = SIZE
    y = np.arange(h)[:, None] * np.ones(w)
    bent = np.where((y >= 60) & (y <= 420), np.abs(TOP * (y - 240) / 180), 0)
    known = line_orders(SIZE, (320, 60, 320, 420), (-TOP, TOP), 300)
    for lamp in (white_led(), OTHER):
        frame = photograph(lamp.light(truth) * inside[..., None], rng)
        white = flat_field(linear_light(photograph(np.ones((h, w, 3)), rng), "srgb"))
        beam = linear_light(photograph(lamp.light(bent), rng), "srgb")
        measured = measured_table(beam, known)
        light = linear_light(frame, "srgb")
        print(f"{lamp.lamp}; {w} x {h} px, {use.sum()} px read")
        told("  one channel (green) inverted", grey_order(light[..., 1] / FULL), truth, use)
        told("  nearest colour, measured table", nearest_colour(light, measured), truth, use)
        told(
            "  nearest colour, assumed table", nearest_colour(light / FULL, table_of(white_led())), truth, use
        )
        by_beam = ColourReader(measured, mask=inside).read(frame)
        told("  measured table", by_beam.order, truth, use, by_beam)
        assumed = table_of(white_led(), error=COLOUR_ERROR)
        by_curve = ColourReader(assumed, white=white, mask=inside).read(frame)
        told("  assumed table", by_curve.order, truth, use, by_curve)
    if given.picture is not None:
        with new_file(given.picture) as building:
            draw_orders(frame, by_beam).savefig(building, format="png", dpi=90)
    for name, options in (("measured table", {}), ("with the frame before", {"before": by_beam})):
        reader = ColourReader(measured, mask=inside)
        took(f"  {name}", lambda reader=reader, o=options: reader.read(frame, **o), rounds)
    reader = ColourReader(measured)
    took("  measured table, whole frame", lambda: reader.read(frame), rounds)
    free = ColourReader(assumed, white=white, isoclinics=True)
    took("  plane polariscope, isoclinics free", lambda: free.read(frame), max(rounds // 5, 1))
    took("  nearest colour", lambda: nearest_colour(light, measured), max(rounds // 5, 1))


if __name__ == "__main__":
    main()
