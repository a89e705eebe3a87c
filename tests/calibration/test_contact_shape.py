"""The contact's shape as a press tells it: what is there, what is not and why, and rigid from soft."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.virtual_presses import KAPPA_N_M, ideal

from palpate.calibration.compliance.contact_shape import NO_RIGID, contact_shape, rigid_plate_stretch
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import record_press, specimens_at


@pytest.fixture(scope="module")
def presses():
    spec = tactip()
    specimens = specimens_at(spec, KAPPA_N_M)
    return {
        name: [ideal(record_press(spec, specimens[name], 300 + k)).press for k in range(2)]
        for name in ("rigid", "S1", "S3")
    }


def test_the_softer_the_less_it_flattens_than_a_rigid_plate_with_the_same_ring(presses) -> None:
    rigid = rigid_plate_stretch(presses["rigid"][:1])
    told = {name: contact_shape(each[1], rigid)["flattening"] for name, each in presses.items()}
    assert_allclose(told["rigid"]["over_rigid"], 1.0, atol=0.01)
    assert told["S3"]["over_rigid"] < told["S1"]["over_rigid"] - 0.1 < 0.9
    assert told["S3"]["force_N"] < told["rigid"]["force_N"]  # its ring outgrows the rigid plate's


def test_ring_ellipse_and_cells_of_a_head_on_press_are_round_and_grown(presses) -> None:
    shape = contact_shape(presses["S1"][0], None)
    long, short = shape["ellipse"]["half_axes_px"]
    assert_allclose(long, short, rtol=0.01)
    assert_allclose(long, shape["ring_px"], rtol=0.06)
    assert -90 <= shape["ellipse"]["angle_deg"] < 90
    assert shape["cell_growth"]["mean"] > 0
    assert shape["flattening"] == {"why_not": NO_RIGID}


def test_growth_of_cells_is_the_log_of_their_areas_ratio(presses) -> None:
    press = presses["S1"][0]
    scaled = replace(press, moved_px=np.broadcast_to(0.1 * press.untouched_px, press.moved_px.shape))
    assert_allclose(contact_shape(scaled, None)["cell_growth"]["mean"], 2 * np.log(1.1))


def test_pins_that_show_no_ring_are_said_and_calibrate_no_flattening(presses) -> None:
    away = [
        replace(p, moved_px=0.01 * np.broadcast_to(p.untouched_px - 150, p.moved_px.shape))
        for p in presses["rigid"]
    ]
    assert rigid_plate_stretch(away) is None
    shape = contact_shape(away[0], None)
    assert shape["ring_px"] is None
    assert "inside the field of pins in" in shape["ellipse"]["why_not"]
