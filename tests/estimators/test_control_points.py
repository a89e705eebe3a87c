import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError
from palpate.estimators.lattice import ControlPoints


def marks(cells, places, sigma=0.05, unit="px"):
    return ControlPoints(np.array(cells), np.array(places, float), np.full(len(cells), sigma), unit)


REST = marks([(0, 0), (1, 0), (0, 1)], [(10, 10), (20, 10), (10, 20)])


class TestSharedMarks:
    def test_marks_are_paired_by_their_cell_whatever_their_order_and_what_is_missing(self):
        now = marks([(5, 5), (0, 1), (0, 0)], [(60, 60), (11, 22), (12, 10)])
        rest, moved, cells = now.shared_with(REST)
        np.testing.assert_array_equal(cells, [(0, 0), (0, 1)])
        np.testing.assert_array_equal(rest, [(10, 10), (10, 20)])
        np.testing.assert_array_equal(moved, [(12, 10), (11, 22)])

    def test_frames_without_a_common_mark_share_none(self):
        rest, moved, cells = marks([(7, 7)], [(1, 1)]).shared_with(REST)
        assert len(rest) == len(moved) == len(cells) == 0

    def test_pixels_are_not_paired_with_metres(self):
        with refused("unit-differs", InputError):
            REST.shared_with(marks([(0, 0)], [(0.01, 0.01)], unit="m"))


class TestRefusals:
    def test_a_cell_is_one_marks_name(self):
        with pytest.raises(InputError, match="twice"):
            marks([(0, 0), (0, 0)], [(1, 1), (2, 2)])

    @pytest.mark.parametrize(("place", "sigma"), [((np.nan, 1), 0.1), ((1, 1), -0.1), ((1, 1), np.inf)])
    def test_a_place_and_its_error_are_finite_numbers(self, place, sigma):
        with pytest.raises(InputError, match="not finite"):
            marks([(0, 0)], [place], sigma)
