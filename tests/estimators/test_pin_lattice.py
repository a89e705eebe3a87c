"""Pins among reflections, in uneven light, out of focus, some hidden: none false, none lost, names kept.

The old way, one grey level for the whole frame and every spot of a pin's size (`on_lattice=False`), is the
control: the same frames must defeat it.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree
from tests.nuisance_pins import (
    NuisanceFrame,
    Nuisances,
    drawn_at_random,
    frame_of,
    layout_cells,
    layout_places,
)

from palpate.core import ImageError
from palpate.estimators.lattice.ring_layout import name_pins, ring_of
from palpate.estimators.pins import find_pins, follow

DRAWN = Nuisances(lamps=6, between=4, over=1, hidden=20, falloff=0.6, blur_px=3.0, barrel=0.06)


def judged(frame: NuisanceFrame, on_lattice: bool = True) -> tuple[int, int, float]:
    try:
        return frame.judged(find_pins(frame.image, on_lattice=on_lattice).xy_px)
    except ImageError:
        return 0, len(frame.pins), float("nan")


def of_seeds(seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """False and lost pins of each frame, by the lattice and by one level."""
    frames = [frame_of(drawn_at_random(seed), seed) for seed in seeds]
    return tuple(np.array([judged(one, way)[:2] for one in frames]) for way in (True, False))  # type: ignore


@pytest.mark.slow
def test_none_of_two_hundred_frames_has_a_false_or_a_lost_pin() -> None:
    ours, one_level = of_seeds(range(200))
    assert_array_equal(ours.sum(axis=0), 0)
    assert (one_level.sum(axis=1) > 0).mean() > 0.9


@pytest.mark.parametrize(
    ("layout", "what"),
    [
        ("hexagonal", {"falloff": 0.6, "stray": 60.0}),
        ("rings", {"blur_px": 3.0, "noise": 3.0}),
        ("hexagonal", {"hidden": 20}),
        ("rings", {"lamps": 8}),
    ],
)
def test_one_nuisance_alone_costs_no_pin_and_moves_none(layout, what) -> None:
    false, lost, worst = judged(frame_of(Nuisances(layout=layout, **what), 3))
    assert (false, lost) == (0, 0)
    assert worst < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["hexagonal", "rings"])
def test_a_pin_has_the_name_of_its_place_whichever_others_are_hidden(layout) -> None:
    names: dict[tuple[int, int], set] = {}
    what = replace(DRAWN, layout=layout, blur_px=0.7, lamps=0, between=0, over=0, turn_rad=0.2)
    for seed in range(3):
        frame = frame_of(what, seed)
        pins = find_pins(frame.image)
        assert pins.cells is not None
        which = cKDTree(frame.pins).query(pins.xy_px)[1]
        for cell, true in zip(pins.cells.tolist(), frame.cells[which].tolist(), strict=True):
            names.setdefault(tuple(true), set()).add(tuple(cell))
    assert len(names) == 127
    assert all(len(one) == 1 for one in names.values())
    # The layout was turned by less than half a sixth: names are its own cells, and none comes twice.
    assert all(one == {true} for true, one in names.items())


@pytest.mark.parametrize("layout", ["hexagonal", "rings"])
def test_the_middle_and_pins_beside_it_may_be_hidden(layout) -> None:
    cells = layout_cells(6)
    there = ~np.isin(ring_of(cells), [0]) & ~((cells == [1, 0]) | (cells == [0, 1])).all(axis=1)
    places = 150 + 19 * layout_places(cells, layout)
    named = name_pins(places[there], (300, 300))
    assert named is not None
    assert_array_equal(ring_of(named.cells), ring_of(cells[there][named.marks]))
    assert len(named.marks) == there.sum()


def test_a_spot_beyond_a_straight_edge_is_no_pin_though_it_stands_on_the_lattice() -> None:
    cells = layout_cells(6)
    places = 200 + 19 * layout_places(cells, "hexagonal")
    stray = 200 + 19 * layout_places(np.array([[7, -3]]), "hexagonal")
    named = name_pins(np.concatenate([places, stray]), (400, 400))
    assert named is not None
    assert sorted(named.marks) == list(range(127))


def test_a_square_lattice_is_one_too_and_scattered_spots_are_none() -> None:
    rng = np.random.default_rng(2)
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(8)), -1).reshape(-1, 2)
    named = name_pins(50 + 20.0 * grid, (300, 300))
    assert named is not None
    assert (named.kind, len(named.marks)) == ("square", 72)
    assert name_pins(rng.uniform(0, 400, (100, 2)), (400, 400)) is None


def test_colour_frames_are_the_mean_of_their_channels_in_either_order() -> None:
    frame = frame_of(Nuisances(), 6).image
    colour = np.stack([frame, frame // 2, frame // 4], axis=-1)
    grey, alike = find_pins(frame), find_pins(np.stack([frame] * 3, axis=-1))
    assert_array_equal(grey.xy_px, alike.xy_px)
    rgb, bgr = find_pins(colour), find_pins(np.ascontiguousarray(colour[..., ::-1]))
    assert_array_equal(rgb.xy_px, bgr.xy_px)
    assert_allclose(rgb.bright / grey.bright, (1 + 1 / 2 + 1 / 4) / 3, atol=0.01)
    (now,) = follow([colour[..., ::-1]], rgb)
    assert_allclose(now.xy_px, rgb.xy_px, atol=0.02)


def test_pins_beside_glare_are_followed_where_they_go() -> None:
    what = replace(DRAWN, blur_px=1.0, hidden=3)
    first, *later = (
        frame_of(replace(what, shift_px=(k, 0.5 * k)), 8) for k in (0.0, 1.0, 2.0, 3.0)
    )  # fmt: skip
    pins = find_pins(first.image)
    *_, last = follow([one.image for one in later], pins)
    clear = cKDTree(np.concatenate([first.partly, [[0, 0]]])).query(pins.xy_px)[0] > 2 * first.pitch_px
    moved = (last.xy_px - pins.xy_px)[clear]
    assert_allclose(np.nanmedian(moved, axis=0), [3.0, 1.5], atol=0.05)
