"""Fringe orders frame by frame."""

import numpy as np
import pytest
from PIL import Image
from tests.fringe_fields import LED, colours, disc

from palpate.core import Frame, InputError
from palpate.estimators.fringe_map import ColourReader, table_of
from palpate.optics.colour import encode_srgb
from palpate.sensing.frame_readers import read_orders
from palpate.sensing.frame_sources import image_files

SHARE, _, FACE = disc()
LOADS = (0.2, 0.5, 0.8, 1.1)


def frames():
    for i, load in enumerate(LOADS):
        yield Frame(encode_srgb(0.9 * colours(SHARE * load, 0.01, i)), float(i), name=f"{load:g}")


def reader():
    return ColourReader(table_of(LED), noise=0.01, white=np.full(3, 0.9), mask=FACE)


@pytest.mark.parametrize("follow", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_each_frame_of_a_growing_load_has_its_own_orders(follow):
    for load, seen in zip(LOADS, read_orders(list(frames()), reader(), follow=follow), strict=True):
        assert seen.name == f"{load:g}"
        error = (seen.found.order - SHARE * load)[seen.found.valid]
        assert seen.found.valid.sum() > 0.98 * FACE.sum()
        assert np.abs(error).max() < 0.15
        assert seen.to_dict()["told_share"] > 0.98
        assert seen.latency_s > 0


def test_an_unreadable_frame_says_why_and_ends_nothing():
    some = list(frames())
    other = Frame(np.zeros((40, 40, 3), np.uint8), 9.0, name="small")
    got = list(read_orders([some[0], Frame.unreadable("cut off", 1.0, "x"), other, some[1]], reader()))
    assert [one.found is None for one in got] == [False, True, True, False]
    assert got[1].to_dict() == {"frame": "x", "time_s": 1.0, "read": False, "why": "cut off"}
    assert "one size" in got[2].reason


def test_a_first_frame_that_cannot_be_read_is_refused(tmp_path):
    Image.fromarray(np.full((90, 90), 40, np.uint8)).save(tmp_path / "grey.png")
    with pytest.raises(InputError, match="grey"):
        list(read_orders(image_files([tmp_path / "grey.png"]), reader()))
