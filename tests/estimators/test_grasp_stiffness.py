"""The loading part of a grasp: stiffness from a width that is held."""

import numpy as np
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.estimators.compliance.stiffness_curve import Loading, fresh, loading_slope

WIDTH = 0.05 - np.linspace(0, 0.012, 49)
FORCE = 1800.0 * (0.05 - WIDTH)
ALL = Loading(0, 48, saturated=False)


def test_a_spring_s_slope_is_its_stiffness() -> None:
    assert_allclose(loading_slope(FORCE, WIDTH, ALL), 1800.0)


def test_a_spring_read_now_and_then_has_its_stiffness_from_fresh_readings() -> None:
    held = WIDTH[np.arange(49) // 6 * 6]
    assert_allclose(loading_slope(FORCE[:-1], held[:-1], Loading(0, 42, saturated=False), held=True), 1800.0)
    assert abs(loading_slope(FORCE, held, ALL) - 1800.0) > 10.0


def test_only_new_readings_are_fresh() -> None:
    assert fresh(np.array([5.0, 5, 4, 4, 4, 3, 5])).tolist() == [0, 2, 5, 6]


def test_a_table_that_is_no_grasp_is_refused() -> None:
    with refused("force-constant", InputError):
        loading_slope(FORCE, -WIDTH, ALL)
    with refused("too-few-values", InputError):
        loading_slope(FORCE, np.full(49, 0.05), ALL)
    with refused("lengths-differ", InputError):
        loading_slope(FORCE, WIDTH[:-1], ALL)
