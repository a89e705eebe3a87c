"""NUSense with a torn skin: its frames and corners, and what a press on it bears."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate
from palpate.core import FRESH, Contact, InputError, Pose, PressHistory, RangeError
from palpate.sensors.nusense.nusense_sensor import NuSense
from palpate.sensors.nusense.nusense_spec import NuSenseSpec, Tear
from palpate.sensors.nusense.pad_view import seen_px

MM = 1e-3
WHOLE, TORN = NuSense(), palpate.sensor("nusense-torn")
ALONG_X = Tear(at_m=(0.0, 3.6e-3), turn_rad=0.0)  # through the middle of a row of tiles
SPEC = replace(NuSenseSpec(), tear=ALONG_X)


def _touch(sensor: NuSense, depth_mm: float, history: PressHistory = FRESH) -> Contact:
    return sensor.press(sensor.probe("round"), Pose(0.0, 0.0, depth_mm * MM), history=history)


def _pulled_away() -> tuple[NuSense, Contact]:
    sensor = NuSense(SPEC)
    return sensor, _touch(sensor, 1.5, PressHistory(path_m=((0.0, 0.0), (0.0, -1e-3))))


@pytest.mark.slow
def test_a_torn_pad_yields_more_and_hardly_so_far_from_the_cut() -> None:
    near, whole = _touch(NuSense(SPEC), 1.2).force_n, _touch(WHOLE, 1.2).force_n
    assert 0.85 < near / whole < 0.995
    spec = replace(SPEC, tear=replace(ALONG_X, at_m=(0.0, 17e-3)))
    assert _touch(NuSense(spec), 1.2).force_n == pytest.approx(whole, rel=1e-3)


@pytest.mark.slow
def test_pixels_beside_the_opening_are_those_that_the_motion_says() -> None:
    """Both lips of a cut that is pulled open, found in the frame, against the motion at the lips."""
    sensor, contact = _pulled_away()
    motion, view = sensor.motion(contact), sensor.view(contact)
    x = np.array([-0.5e-3, 0.0, 0.5e-3])
    lips = []
    for side in (-1, 1):
        y = np.full(3, ALONG_X.at_m[1] + side * ALONG_X.gap_m / 2)
        moved = motion.at(x, y, side)
        lips.append(seen_px(SPEC, np.column_stack([x + moved[0], y + moved[1], moved[2]])))
    for below, above in zip(*lips, strict=True):
        column, middle = round(float(below[0])), round(float((below[1] + above[1]) / 2))
        rows = view[middle - 5 : middle + 6, column].sum(axis=1)
        lit = (rows[0] + rows[-1]) / 2
        assert rows.min() < 0.5 * lit
        dark = float((1 - rows / lit).clip(0).sum())
        assert dark == pytest.approx(float(below[1] - above[1]), abs=0.5)
        assert below[1] - above[1] > 1.5


@pytest.mark.slow
def test_corners_on_both_sides_of_an_opened_cut_are_carried_apart() -> None:
    sensor, contact = _pulled_away()
    torn, whole = sensor.tile_corners(contact), WHOLE.tile_corners(contact)
    added = torn.skin_m - whole.skin_m
    beside = np.abs(torn.rest_m[:, 0]) < 2e-3
    rows = torn.rest_m[:, 1]
    before = beside & (rows > 3.6e-3) & (rows < 6e-3)
    behind = beside & (rows < 3.6e-3) & (rows > 2e-3)
    assert before.any()
    assert behind.any()
    assert added[before, 1].mean() - added[behind, 1].mean() > 50e-6


@pytest.mark.slow
def test_a_cut_is_seen_at_rest_only_where_it_goes_through_the_tiles() -> None:
    rest = _touch(NuSense(SPEC), 0.0)
    whole = WHOLE.view(rest)
    assert np.abs(NuSense(SPEC).view(rest) - whole).max() > 50
    shallow = NuSense(replace(SPEC, tear=replace(ALONG_X, depth_m=0.8e-3)))
    assert np.abs(shallow.view(rest) - whole).max() < 1e-3
    pressed = _touch(shallow, 1.2)
    assert np.abs(shallow.view(pressed) - WHOLE.view(pressed)).max() > 2


def test_torn_pads_are_named_and_others_refused() -> None:
    assert (TORN.name, palpate.sensor("nusense-torn-7").name) == ("nusense-torn", "nusense-torn-7")
    assert palpate.sensor("nusense-torn-7").spec.layers == palpate.sensor("nusense-7").spec.layers
    for words in ("nusense-torn-", "nusense-torn-soft", "nusense-tear"):
        with pytest.raises(InputError):
            palpate.sensor(words)
    with pytest.raises(RangeError, match="above 0"):
        Tear(length_m=0.0)
