"""Laws and published values of the scaled sum of shifts."""

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.surface_strain import strain_fields
from palpate.estimators.surface_strain.strain_fields import (
    PUBLISHED_ALPHA,
    PUBLISHED_SAMPLES,
    published_force_n,
    published_gamma,
    shear_from_pressure,
    shear_measure,
)


def marks(shift=(0.0, 0.0), columns=20, rows=15):
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    cells = np.column_stack([column.ravel(), row.ravel()])
    return ControlPoints(cells, 14.5 * cells + np.array(shift), np.zeros(len(cells)))


@pytest.mark.parametrize(
    ("force", "gamma", "total", "mean"), [(1, 0.6926, 12_466, 0.46), (8, 2.9579, 53_243, 1.98)]
)
def test_published_values_are_those_of_164_by_164_samples(force, gamma, total, mean):
    assert published_gamma(force) == pytest.approx(gamma, abs=5e-5)
    shift = published_gamma(force) / (PUBLISHED_ALPHA * PUBLISHED_SAMPLES)
    measure = shear_measure(strain_fields(marks(), marks((0.6 * shift, -0.8 * shift))))
    assert measure.count == measure.seen == 26_896
    assert measure.total == pytest.approx(total, abs=0.6)
    assert measure.mean == pytest.approx(mean, abs=0.005)
    assert measure.mean_form == pytest.approx(gamma, abs=5e-5)
    assert published_force_n(measure.mean_form) == pytest.approx(force, abs=1e-4)


def test_marks_that_are_missing_lower_the_sum_and_not_the_mean():
    whole, now = marks(), marks((1.0, 1.0))
    kept = np.ones(300, bool)
    kept[100:103] = kept[120:123] = False
    torn = ControlPoints(now.cells[kept], now.places[kept], now.sigma[kept])
    measure = shear_measure(strain_fields(whole, torn))
    assert measure.seen < 0.99 * measure.count
    assert measure.mean_form == pytest.approx(PUBLISHED_ALPHA * PUBLISHED_SAMPLES * 2**0.5)


def test_the_published_line_is_refused_where_it_was_not_drawn():
    for gamma in (0.0, 0.68, 2.97):
        with refused("gamma-range", RangeError):
            published_force_n(gamma)
    with refused("alpha-range", InputError):
        shear_measure(strain_fields(marks(), marks()), alpha=0.0)
    metres = ControlPoints(marks().cells, marks().places, marks().sigma, "m")
    with refused("unit-differs", InputError):
        shear_measure(strain_fields(metres, metres))


def test_shear_from_pressure_is_the_slope_of_a_gaussian():
    x, y = np.linspace(-12e-3, 12e-3, 241), np.linspace(-10e-3, 10e-3, 201)
    X, Y = np.meshgrid(x, y)
    wide, blur, peak, E, t = 1.5e-3, 0.8e-3, 3e4, 0.3e6, 2e-3
    pressure = peak * np.exp(-(X**2 + Y**2) / (2 * wide**2))
    both = wide**2 + blur**2
    blurred = peak * wide**2 / both * np.exp(-(X**2 + Y**2) / (2 * both))
    expected = -3 * t / E * blurred / both * np.stack([X, Y])
    np.testing.assert_allclose(
        shear_from_pressure(pressure, x, y, blur, E, t), expected, atol=2e-3 * np.abs(expected).max()
    )
    ring = np.hypot(X, Y)[
        np.unravel_index(np.hypot(*shear_from_pressure(pressure, x, y, blur, E, t)).argmax(), X.shape)
    ]
    assert ring == pytest.approx(both**0.5, abs=0.1e-3)
    with pytest.raises(InputError, match="even steps"):
        shear_from_pressure(pressure, x**3, y, blur, E, t)
