"""The strain that is shown lies in the picture where the skin was pressed, and grows with the press."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.core import ManualClock
from palpate.rig.virtual.virtual_hand import HandHabits, VirtualHand
from palpate.sensing.streaming.source_views import MIN_TOLD, strain_view
from palpate.sensing.streaming.touch_readers import ShearFrameReader

PLACE_M = (0.008, 0.004)


@pytest.fixture(scope="module")
def shown():
    """View and image of a NUSense untouched, and held down beside its middle."""
    spot = HandHabits(slips=0.0, spot_m=(*PLACE_M, 0.0))
    hand = VirtualHand("nusense", clock=ManualClock(), seed=3, habits=spot)
    reader = ShearFrameReader(hand.design.shear_skin(), None, "nusense")
    _, frame = hand.camera.grab()
    reader.zero(frame.image)
    found = {}
    for number in range(80):
        at_ns, frame = hand.camera.grab()
        reader.read(frame)
        state = "held" if hand.held(at_ns) else "rest" if number == 1 else ""
        if state and state not in found:
            found[state] = strain_view(*reader.seen), frame.image.astype(float)
        if len(found) == 2:
            break
    hand.close()
    return found


def test_the_contact_is_shown_where_the_picture_changed_and_shear_lies_around_it(shown) -> None:
    (rest, before), (held, after) = shown["rest"], shown["held"]
    assert rest["contacts"] == []
    assert rest["shift"] is None
    ((x, y),) = held["contacts"]
    change = np.abs(after - before)
    change = change.mean(axis=2) if change.ndim == 3 else change
    rows, columns = np.mgrid[: change.shape[0], : change.shape[1]]
    seen = change > np.quantile(change, 0.99)
    assert np.hypot(columns[seen].mean() - x, rows[seen].mean() - y) < 30
    height, width = change.shape
    assert np.hypot(columns[seen].mean() - (width - x), rows[seen].mean() - (height - y)) > 60
    dots = np.array(held["dots"])
    heavy = dots[dots[:, 2] > held["greatest"] / 3]
    assert np.hypot(*(heavy[:, :2].mean(axis=0) - (x, y))) < held["spacing_px"]


def test_dots_are_of_strain_that_is_seen_and_none_is_larger_than_the_greatest(shown) -> None:
    held, rest = shown["held"][0], shown["rest"][0]
    shears = [shear for _, _, shear in held["dots"]]
    assert min(shears) > MIN_TOLD
    assert max(shears) <= held["greatest"]
    assert held["greatest"] > 10 * rest["greatest"]
    assert len(held["dots"]) > 10 * len(rest["dots"])
    left, top, width, height = held["box"]
    assert all(left < x < left + width and top < y < top + height for x, y, _ in held["dots"])
    assert 0 < left < left + width < 640
    assert 0 < top < top + height < 480
