"""Ten thousand frames in a row: marks keep their names in a slide, and nothing is felt where nothing touches.

The poses of the slide are rendered once and come back with fresh noise, in the order of a probe that is
dragged to and fro.
"""

from collections.abc import Iterator

import numpy as np
import pytest

import palpate
from palpate.core import Frame, Pose, PressHistory
from palpate.core.sensor import Seating
from palpate.estimators.lattice import MarkTracker
from palpate.estimators.shear import ShearReader

SENSOR = palpate.sensor("nusense")
FRAMES = 10_000
POSES = 240  # of a slide, one way
SLID_M = 14e-3  # to either side
DRIFT = 0.15  # of the light
NOISE = 2.0  # levels, beside the rendered noise


def places_of(contact, cells: np.ndarray) -> np.ndarray:
    truth = SENSOR.tile_corners(contact)
    number = {tuple(cell): i for i, cell in enumerate(truth.cells.tolist())}
    return truth.places_px[[number[tuple(cell)] for cell in cells.tolist()]]


def slide() -> tuple[list[Frame], list]:
    """Frames of a round tip pressed by 1.3 mm and dragged across the pad, and their contacts."""
    rng, probe, frames, contacts = np.random.default_rng(5), SENSOR.probe("round"), [], []
    for x in np.linspace(-SLID_M, SLID_M, POSES):
        dragged = PressHistory(path_m=((-4e-3, 1e-3), (0.0, 0.0)))
        contacts.append(SENSOR.press(probe, Pose(float(x), float(0.4 * x), 1.3e-3), history=dragged))
        frames.append(SENSOR.render(contacts[-1], rng))
    return frames, contacts


def to_and_fro(count: int) -> Iterator[int]:
    """Numbers of poses."""
    way = [*range(POSES), *range(POSES - 2, 0, -1)]
    return (way[k % len(way)] for k in range(count))


def names_of_truth(first: Frame, contact) -> tuple[MarkTracker, np.ndarray, np.ndarray]:
    """A tracker, and the true cell of each of its marks."""
    tracker = MarkTracker(first.image, 15.0)
    truth = SENSOR.tile_corners(contact)
    found = tracker.reference.points
    near = [int(np.argmin(np.hypot(*(truth.places_px - place).T))) for place in found.places]
    return tracker, found.cells, truth.cells[near]


@pytest.mark.slow
def test_no_mark_changes_its_name_in_a_slide_of_ten_thousand_frames() -> None:
    frames, contacts = slide()
    tracker, own, true = names_of_truth(frames[0], contacts[0])
    known = {tuple(a): tuple(b) for a, b in zip(own.tolist(), true.tolist(), strict=True)}
    rng, swapped, seen, squares = np.random.default_rng(6), 0, 0, 0.0
    truths = [SENSOR.tile_corners(contact) for contact in contacts]
    at = [{tuple(c): p for c, p in zip(t.cells.tolist(), t.places_px, strict=True)} for t in truths]
    for k in to_and_fro(FRAMES):
        image = frames[k].image + rng.normal(0.0, NOISE, frames[k].image.shape).astype(np.float32)
        points = tracker.follow(np.clip(np.rint(image), 0, 255).astype(np.uint8)).points
        expected = np.array([at[k][known[tuple(cell)]] for cell in points.cells.tolist()])
        off = np.hypot(*(points.places - expected).T)
        swapped += int((off > 0.5 * tracker.pitch).sum())
        seen, squares = seen + len(off), squares + float((off**2).sum())
    print(f"{swapped} of {seen} marks swapped, {np.sqrt(squares / seen):.4f} px RMS")
    assert swapped == 0
    assert seen > 0.85 * FRAMES * len(known)
    assert np.sqrt(squares / seen) < 0.05


def test_a_picture_that_jumps_by_a_whole_tile_does_change_names() -> None:
    rng = np.random.default_rng(0)
    rest = SENSOR.press(SENSOR.probe("round"), Pose(0.0, 0.0, 0.0))
    frame = SENSOR.render(rest, rng)
    tracker, own, true = names_of_truth(frame, rest)
    truth = {tuple(a): tuple(b) for a, b in zip(own.tolist(), true.tolist(), strict=True)}
    jumped = np.roll(frame.image, round(2 * tracker.pitch), axis=1)  # two tiles: one period of the colours
    points = tracker.follow(jumped).points
    places = {tuple(c): p for c, p in zip(SENSOR.tile_corners(rest).cells.tolist(),
                                          SENSOR.tile_corners(rest).places_px, strict=True)}  # fmt: skip
    still = np.array([places[truth[tuple(cell)]] for cell in points.cells.tolist()])
    moved = still + np.array([2 * tracker.pitch, 0.0])
    assert len(points) == 0 or (np.hypot(*(points.places - moved).T) > 0.5 * tracker.pitch).mean() > 0.5


@pytest.mark.slow
def test_nothing_is_felt_in_ten_thousand_frames_that_nothing_touches() -> None:
    rest = SENSOR.press(SENSOR.probe("round"), Pose(0.0, 0.0, 0.0))
    rng = np.random.default_rng(11)
    reader = ShearReader(SENSOR.shear_skin(), SENSOR.render(rest, rng))
    light, felt, unread = 1.0, 0, 0
    for _ in range(FRAMES):
        light = float(np.clip(light + rng.normal(0.0, 2e-3), 1 - DRIFT, 1 + DRIFT))
        touch = reader.touch(SENSOR.render(rest, rng, Seating(light=light)))
        unread += bool(touch.reason)
        felt += not touch.reason and touch.readings["contacts"].value != "0"
    print(f"{felt} false contacts, {unread} frames not read, of {FRAMES}")
    assert felt == 0
    assert unread <= 0.001 * FRAMES
    pressed = SENSOR.press(SENSOR.probe("round"), Pose(2e-3, 1e-3, 0.5e-3))
    assert reader.touch(SENSOR.render(pressed, rng)).readings["contacts"].value == "1"
