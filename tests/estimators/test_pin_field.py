"""The circle through untouched pins, whichever are hidden."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.nuisance_pins import layout_cells, layout_places
from tests.refusals import refused

from palpate.core import InputError
from palpate.estimators.compliance.contact_area import pin_field
from palpate.estimators.compliance.spread_rate import circle_through_pins

MIDDLE, PITCH = np.array([150.0, 140.0]), 19.0


def field(layout: str, barrel: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    cells = layout_cells(6)
    plane = layout_places(cells, layout)
    drawn_in = 1 - barrel * (plane**2).sum(axis=1, keepdims=True) / 36
    return MIDDLE + PITCH * drawn_in * plane, cells


@pytest.mark.parametrize("layout", ["hexagonal", "rings"])
def test_hidden_middle_and_edge_leave_the_area(layout) -> None:
    places, cells = field(layout)
    hidden = (cells == 0).all(axis=1) | (cells == [6, 0]).all(axis=1) | (cells == [0, 6]).all(axis=1)
    found = pin_field(places[~hidden], cells[~hidden])
    assert_allclose(found.middle, MIDDLE, atol=0.05)
    assert_allclose(found.area, np.pi * (6 * PITCH * 0.9) ** 2, rtol=0.002)
    assert len(found.edge) == (6 if layout == "hexagonal" else 36)


def test_the_circle_is_that_of_all_pins_where_the_middle_is_hidden() -> None:
    places, cells = field("hexagonal")
    shown = (cells != 0).any(axis=1)
    whole = circle_through_pins(places, 300, 300)
    assert (circle_through_pins(places, 300, 300, cells) == whole).all()
    told = circle_through_pins(places[shown], 300, 300, cells[shown])
    assert abs(told.sum() / whole.sum() - 1) < 0.005
    # Without names another pin is taken for the middle, and the circle is too large.
    assert circle_through_pins(places[shown], 300, 300).sum() / whole.sum() > 1.1


def test_too_few_pins_tell_no_field() -> None:
    with refused("too-few-pins", InputError):
        pin_field(np.zeros((3, 2)), np.array([[0, 0], [1, 0], [0, 1]]))
