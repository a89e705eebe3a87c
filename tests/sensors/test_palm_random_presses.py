"""Presses drawn for a network: the same whoever draws them, and labelled as the press they show."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.sensors import palm
from palpate.sensors.palm.random_presses import draw_presses

SPEC = palm.cropped(palm.palm(), 32, "test")


@pytest.fixture(scope="module")
def alone():
    return draw_presses(SPEC, 3, 4, np.random.default_rng(2))


@pytest.mark.slow
def test_what_is_drawn_does_not_depend_on_how_many_processes_draw(alone) -> None:
    together = draw_presses(SPEC, 3, 4, np.random.default_rng(2), processes=2)
    for part in ("images", "hanging", "press", "values"):
        np.testing.assert_array_equal(getattr(together, part), getattr(alone, part))


def test_every_frame_is_drawn_and_told_of(alone) -> None:
    told: list[tuple[int, int]] = []
    again = draw_presses(SPEC, 3, 4, np.random.default_rng(2), lambda done, total: told.append((done, total)))
    np.testing.assert_array_equal(again.images, alone.images)
    assert alone.images.shape == (12, *SPEC.frame_px[::-1], 3)
    assert alone.hanging.shape == (3, *SPEC.frame_px[::-1], 3)
    assert alone.press.tolist() == np.repeat(np.arange(3), 4).tolist()
    assert told[-1] == (15, 15)
    assert np.diff([done for done, _ in told]).min() > 0


def test_a_frame_shows_its_own_press_and_the_hanging_probe_shows_none(alone) -> None:
    differences = np.abs(alone.images.astype(float) - alone.hanging[alone.press]).mean((1, 2, 3))
    depth = alone.values[:, 0]
    # Deeper presses look less like the untouched skin; frames of all depths, so far from a perfect rank.
    ranks = [np.argsort(np.argsort(v)) for v in (differences, depth)]
    assert np.corrcoef(*ranks)[0, 1] > 0.6


@pytest.mark.parametrize(("count", "depths", "processes"), [(0, 1, 1), (1, 0, 1), (1, 1, 0)])
def test_no_press_no_depth_and_no_process_are_refused(count: int, depths: int, processes: int) -> None:
    with refused("processes" if processes < 1 else "press-count", InputError):
        draw_presses(SPEC, count, depths, np.random.default_rng(0), processes=processes)
