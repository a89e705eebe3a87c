import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from palpate.core import Pose
from palpate.sensors import palm
from palpate.sensors.palm import fringe_orders

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from oracles import first_prototype

SPEC = palm.debug()
GREEN_M = 550e-9
HERTZ = 0.439  # greatest order under a Hertzian contact seen edge-on, in C F / (a lambda), at z = 0.66 a


def pressed(depth_m, x_m=0.0, y_m=0.0):
    return palm.press(SPEC, Pose(x_m, y_m, depth_m))


def test_from_below_a_dark_cross_lies_along_the_polarisers():
    along = replace(SPEC, polariser_rad=0.0)
    seen = first_prototype.from_below(pressed(3e-3), along, pixels=101)
    leak = (1 - first_prototype.POLARISED) / 2 + first_prototype.POLARISED * SPEC.extinction
    rim = (
        first_prototype.MIDDLE_OVER_RIM
        + (1 - first_prototype.MIDDLE_OVER_RIM) * (seen.x_m / SPEC.radius_m) ** 2
    )
    np.testing.assert_allclose(seen.light[50], rim[:, None] * leak * np.ones(3), atol=1e-6)
    np.testing.assert_allclose(seen.light[:, 50], rim[:, None] * leak * np.ones(3), atol=1e-6)
    diagonal = seen.light[np.arange(101), np.arange(101), 1]
    assert diagonal.max() > 1.3 * leak * rim[50]


@pytest.mark.parametrize("force_n", [2.0])
def test_a_light_touch_has_the_orders_of_a_hertzian_contact(force_n):
    # the resin is dented by 1e-6 m to 1e-5 m: Hertz's law holds, and the fringes fit into some 0.1 mm
    resin = palm.casting_resin()
    contact = palm.press_to_force(resin, force_n)
    C = float(resin.stress_optic.at(np.array([GREEN_M]))[0])
    wanted = HERTZ * C * force_n / (contact.radius_m * GREEN_M)
    found = fringe_orders.edge_on(resin, contact.pose.depth_m, points=31).greatest
    assert found == pytest.approx(wanted, rel=0.03)  # the table's knots, and a percentile for the greatest


@pytest.mark.parametrize("force_n", [2.0])
def test_at_equal_load_the_reports_choice_shows_most_orders(force_n):
    def greatest(name):
        spec = palm.preset(name)
        return fringe_orders.edge_on(
            spec, palm.press_to_force(spec, force_n).pose.depth_m, points=31
        ).greatest

    solaris, resin, sylgard = map(greatest, ("solaris", "casting-resin", "sylgard-184"))
    assert solaris > resin > 2 * sylgard  # solaris leads the resin by 8 % at 2 N and by 41 % at 15 N


def test_facts_name_a_contact_s_numbers_with_their_units(monkeypatch):
    monkeypatch.setattr(fringe_orders, "edge_on", partial(fringe_orders.edge_on, points=31))
    contact = pressed(0.5e-3, 18e-3, -14e-3)
    found = palm.contact_summary(contact, SPEC)
    assert found["force_N"] == contact.force_n
    assert found["contact_radius_mm"] == contact.radius_m * 1e3
    assert found["peak_pressure_Pa"] == pytest.approx(contact.pressure_pa.max(), rel=0.02)
    assert found["fringe_order_max"] == fringe_orders.edge_on(SPEC, 0.5e-3).greatest
    assert (found["youngs_modulus_Pa"], found["thickness_mm"]) == (0.32e6, 10.0)
    assert found["seen_edge_on"] is False, "behind the rays that graze the rim"
    assert "finite-strain" in found["model"]
