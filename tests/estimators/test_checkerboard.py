"""Corners of rendered checkerboards against the truth: places, standard errors, names, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused
from tests.rendered_boards import View, board, noisy

from palpate.core import ImageError, InputError, RangeError
from palpate.estimators.lattice import ControlPoints, MarkTracker, find_checkerboard

VIEW = View(pitch=20.0, turn=0.08, shear=0.05, size=(400, 300), at=(190.0, 140.0), reach=50.0)
EXTENT = (14, 10)
MIN_CORNERS = 150


def rendered(view: View, seed: int = 0, **how) -> np.ndarray:
    return noisy(board(view, extent=EXTENT, **how), np.random.default_rng(seed))


def errors(points: ControlPoints, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the true places ``[n 2]``, and the steps from true cells to names, one row of each."""
    true = np.rint(view.lattice(points.places)).astype(int)
    return points.places - view.places(true.astype(float)), np.unique(true - points.cells, axis=0)


@pytest.fixture(scope="module")
def seen() -> np.ndarray:
    """The pattern at rest; for tests that change nothing in it."""
    return rendered(VIEW)


@pytest.fixture(scope="module")
def reference(seen) -> ControlPoints:
    return find_checkerboard(seen, 20).points


@pytest.mark.parametrize(
    ("view", "noise", "how"),
    [
        (VIEW, 3.0, {}),
        (replace(VIEW, bulge=4.0), 1.0, {"uneven": 0.6}),
        (replace(VIEW, barrel=0.3, turn=-0.6), 1.0, {"blur": 0.6}),
    ],
    ids=["noise", "pressed in uneven light", "fisheye, turned"],
)
def test_corners_lie_within_a_twentieth_of_a_pixel_and_their_errors_are_as_stated(view, noise, how) -> None:
    picture = noisy(board(view, extent=EXTENT, **how), np.random.default_rng(0), noise)
    points = find_checkerboard(picture, 20).points
    off, steps = errors(points, view)
    assert len(points) > MIN_CORNERS
    assert len(steps) == 1, "every name is right, up to the one step that no reference tells"
    assert np.sqrt((off**2).mean()) < 0.05
    # About 330 numbers: a standard deviation of 1 is found within 0.12 at three standard errors.
    assert 0.85 < (off / points.sigma[:, None]).std() < 1.2


def test_an_even_corner_begins_a_bright_tile(seen) -> None:
    for picture in (seen, np.ascontiguousarray(np.rot90(seen))):
        points = find_checkerboard(picture, 20).points
        place = dict(zip(map(tuple, points.cells.tolist()), points.places, strict=True))
        for cell, at in place.items():
            far = place.get((cell[0] + 1, cell[1] + 1))
            if far is not None:
                x, y = np.rint((at + far) / 2).astype(int)
                assert (picture[y, x, 1] > 100) == (sum(cell) % 2 == 0)


def test_tiles_painted_over_take_their_corners_and_no_name_of_others(reference) -> None:
    rng = np.random.default_rng(30)
    tiles = [(i, j) for i in range(-8, 8) for j in range(-6, 6) if (i + j) % 2 == 0]
    gone = {tiles[k] for k in rng.permutation(len(tiles))[: int(0.3 * len(tiles))]}
    view = replace(VIEW, bulge=4.0)
    points = find_checkerboard(rendered(view, painted=tuple(gone)), 20, reference).points
    off, steps = errors(points, view)
    _, truth = errors(reference, VIEW)
    assert steps.tolist() == truth.tolist()
    assert np.abs(off).max() < 0.2
    cells = np.rint(view.lattice(points.places)).astype(int).tolist()
    touched = {(i + a, j + b) for i, j in gone for a in (0, 1) for b in (0, 1)}
    assert not touched & set(map(tuple, cells))


def test_both_sides_of_a_tear_keep_their_names(reference) -> None:
    view, strip = replace(VIEW, bulge=3.0, at=(110.0, 140.0)), (0.0, 4.0, -20.0)
    points = find_checkerboard(rendered(view, torn=strip), 20, reference).points
    off, steps = errors(points, view)
    _, truth = errors(reference, VIEW)
    assert steps.tolist() == truth.tolist()
    assert np.sqrt((off**2).mean()) < 0.05
    columns = np.rint(view.lattice(points.places)).astype(int)[:, 0]
    assert (columns < strip[0]).any()
    assert (columns > strip[1]).any()


def blank(level: int) -> np.ndarray:
    return noisy(np.full((300, 400, 3), float(level)), np.random.default_rng(2))


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (lambda seen: blank(5), "dark"),
        (lambda seen: np.full_like(seen, 255), "saturated"),
        (lambda seen: np.random.default_rng(3).integers(0, 255, seen.shape, dtype=np.uint8), "corners"),
        (lambda seen: seen.astype(np.float32), "8-bit"),
        (lambda seen: seen[:40, :40], "px"),
    ],
    ids=["dark", "white", "noise only", "floats", "tiny"],
)
def test_a_frame_without_a_pattern_to_be_seen_is_refused(seen, frame, said) -> None:
    with pytest.raises(ImageError, match=said):
        find_checkerboard(frame(seen), 20)


def test_a_pattern_half_out_of_view_has_no_names(reference) -> None:
    frame = rendered(replace(VIEW, shift=(160.0, 0.0)))
    with pytest.raises(ImageError, match="reference"):
        find_checkerboard(frame, 20, reference)


def test_a_pitch_that_is_wrong_by_half_is_corrected(seen) -> None:
    right, guessed = find_checkerboard(seen, 20), find_checkerboard(seen, 30)
    assert len(guessed.points) > 0.95 * len(right.points)
    assert guessed.pitch == pytest.approx(right.pitch, rel=0.02)
    with pytest.raises(RangeError, match="5 px"):
        find_checkerboard(seen, 1.0)


@pytest.mark.parametrize("frames", [27, pytest.param(10_000, marks=pytest.mark.slow)])
def test_no_corner_takes_another_s_name_in_a_slide(frames) -> None:
    small = replace(VIEW, size=(260, 200), pitch=18.0, at=(120.0, 90.0), reach=35.0)
    rng = np.random.default_rng(4)
    extent = (8, 6)
    tracker = MarkTracker(noisy(board(small, extent=extent, samples=2), rng), 18)
    truth = np.unique(
        np.rint(small.lattice(tracker.reference.points.places)).astype(int) - tracker.reference.points.cells,
        axis=0,
    )
    furthest = 0.0
    for k in range(1, frames + 1):
        phase = 2 * np.pi * k / 100
        shift = (28 * np.sin(phase), 12 * np.sin(0.7 * phase))
        view = replace(small, shift=shift, bulge=4 * np.sin(phase) ** 2, at=(130 + 20 * np.cos(phase), 95.0))
        got = tracker.follow(noisy(board(view, extent=extent, samples=2), rng))
        named = np.rint(view.lattice(got.points.places)).astype(int) - got.points.cells
        assert (named == truth).all()
        assert len(got.points) > 0.9 * len(tracker.reference.points), (k, got.reason)
        furthest = max(furthest, abs(shift[0]))
    assert furthest > 1.5 * tracker.pitch


def test_points_followed_are_as_near_and_as_sure_as_points_found(seen) -> None:
    tracker = MarkTracker(seen, 20)
    view = replace(VIEW, bulge=1.5)
    got = tracker.follow(rendered(view, seed=5))
    assert not got.found_anew
    off, _ = errors(got.points, view)
    assert np.sqrt((off**2).mean()) < 0.05
    assert 0.85 < (off / got.points.sigma[:, None]).std() < 1.2


def test_after_lost_frames_and_a_jump_points_come_back_under_their_names(seen) -> None:
    tracker = MarkTracker(seen, 20)
    _, truth = errors(tracker.reference.points, VIEW)
    covered = tracker.follow(np.full_like(seen, 3))
    assert not len(covered.points)
    assert "dark" in covered.reason
    jumped = replace(VIEW, shift=(9.0, -6.0))
    got = tracker.follow(rendered(jumped, seed=6))
    assert got.found_anew
    assert errors(got.points, jumped)[1].tolist() == truth.tolist()
    with refused("frame-size", InputError):
        tracker.follow(seen[:-1])


def test_a_corner_that_was_covered_is_followed_again(seen) -> None:
    tracker = MarkTracker(seen, 20)
    hidden = tracker.follow(rendered(VIEW, seed=8, painted=((0, 0), (3, 1))))
    assert len(hidden.points) == len(tracker.reference.points) - 8
    assert len(tracker.follow(seen).points) == len(tracker.reference.points)
