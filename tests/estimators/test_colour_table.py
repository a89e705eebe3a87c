"""Colours of orders measured on a known specimen, and orders read by them."""

import numpy as np
import pytest
from tests.fringe_fields import LED, beam, colours, disc, order_from_colour
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.estimators.fringe_light import Polariscope, one_line
from palpate.estimators.fringe_map import (
    ColourTable,
    disc_orders,
    line_orders,
    measured_table,
    read_table,
    table_of,
)
from palpate.optics import assumed_camera

OTHER = Polariscope(
    assumed_camera(camera_peaks_nm=(607.0, 532.0, 465.0), camera_widths_nm=(32.0, 44.0, 27.0)),
    550e-9,
    "other",
)


def measured(lamp=LED, noise=0.01):
    N = beam(3.2, 400, 120)
    known = line_orders(N.shape, (60, 0, 60, 399), (-3.2, 3.2), 100.0)
    return measured_table(colours(N, noise, lamp=lamp), known)


def test_a_beam_s_photograph_gives_the_colours_that_its_lamp_makes():
    table = measured()
    assert table.greatest_order == pytest.approx(3.2, abs=0.02)
    assert np.abs(table.light - LED.light(table.order)).max() < 5e-3
    assert np.sqrt(np.mean((table.light - LED.light(table.order)) ** 2)) < 1.2e-3
    assert table.error < 0.004


def test_a_disc_s_photograph_gives_the_same():
    N = disc_orders((160, 160), (80, 80, 150), 1.2)
    table = measured_table(colours(np.nan_to_num(N), 0.01), N)
    assert table.greatest_order > 2.5
    assert np.abs(table.light - LED.light(table.order)).max() < 0.02


def test_a_measured_table_reads_a_camera_that_no_assumed_curve_fits():
    share, _, face = disc()
    N = share * 1.2
    frame = colours(N, 0.01, seed=7, lamp=OTHER)
    found = order_from_colour(frame, measured(OTHER), noise=0.01, mask=face)
    error = (found.order - N)[found.valid]
    assert found.valid.sum() > 0.98 * face.sum()
    assert np.abs(error).max() < 0.1
    assert (error / found.sigma[found.valid]).std() == pytest.approx(1.0, abs=0.12)
    assumed = order_from_colour(frame, table_of(LED), noise=0.01, mask=face)
    assert assumed.summary()["misfit_median"] > 2 * found.summary()["misfit_median"]


def test_a_table_comes_back_from_its_file(tmp_path):
    table = measured()
    table.write(tmp_path / "beam.csv")
    again = read_table(tmp_path / "beam.csv")
    np.testing.assert_allclose(again.light, table.light, atol=1e-6)
    assert again.error == pytest.approx(table.error, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("order,red,green\n0,0,0\n", "column-missing"),
        ("order,red,green,blue\n0,0,0,0\n0.5,1,1,0.9\n1,0,0,0\n", "order-spacing"),
        ("order,red,green,blue\n0,0,0,0\n0.01,0,x,0\n0.02,0,0,0\n", "order-sequence"),
        ("order,red,green,blue\n0.02,0,0,0\n0.01,1,1,1\n0,0,0,0\n", "order-sequence"),
    ],
)
def test_a_file_that_is_no_table_is_refused(tmp_path, text, code):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with refused(code, InputError):
        read_table(path)


def test_what_shows_no_colours_of_orders_is_no_table():
    with refused("gray-table", InputError):
        table_of(one_line(550e-9))
    light = LED.light(np.arange(0, 2, 0.01))
    with refused("channel-constant", InputError):
        ColourTable(light * [1, 1, 0], "a lamp without blue")
    with refused("order-range", RangeError):
        table_of(LED, 0.1)
    frame, N = colours(beam(2.0)), beam(2.0)
    with refused("order-zero-missing", InputError):
        measured_table(frame, np.where(N > 0.5, N, np.nan))
    with refused("shape", InputError):
        measured_table(np.where(N[..., None] > 1.99, np.nan, frame), N)
    with refused("order-ends", InputError):
        line_orders((20, 50), (5, 4, 45, 4), (1.0, 1.0), 5.0)
    with refused("disc-outside-image", InputError):
        disc_orders((20, 50), (10, 10, 80), 1.0)
