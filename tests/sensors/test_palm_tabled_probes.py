"""Probes without an axis on the palm: by their finite-strain tables, and by linear layers without."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import Pose, RangeError
from palpate.mechanics.probe_contact import is_tabled_probe
from palpate.sensors import palm
from palpate.sensors.palm import fringe_orders
from palpate.sensors.palm.palm_press import LINEAR_DEPTH_M, press_layers
from palpate.sensors.palm.palm_sensor import Palm
from palpate.sensors.palm.probe_shapes import has_probe_table, probe_table_of, probes_with_table
from palpate.sensors.palm.probe_stress import laid_of

SPEC = palm.preset("debug")
PROBES = probes_with_table(SPEC).split(", ")
FEW = [PROBES[0], PROBES[-1]]


def pressed(words, depth_m, x_m=0.0, y_m=0.0, spec=SPEC, lateral_n=(0.0, 0.0)):
    return palm.press(spec, Pose(x_m, y_m, depth_m), palm.parse_probe(words), lateral_n)


def deepest(words):
    return probe_table_of(SPEC, palm.parse_probe(words)).greatest_depth * SPEC.thickness_m


def light_of(words, depth_m, **place):
    return palm.render_clean(pressed(words, depth_m, **place), SPEC)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("words", PROBES)
def test_a_probe_is_pressed_by_its_table_by_itself_to_the_tables_depth(words):
    table = probe_table_of(SPEC, palm.parse_probe(words))
    most, unit = deepest(words), SPEC.youngs_modulus_pa * SPEC.thickness_m**2
    assert most > LINEAR_DEPTH_M
    for share in (0.2, 0.5, 1.0):
        contact = pressed(f"{words}:30", share * most)
        assert is_tabled_probe(contact)
        assert contact.force_n == pytest.approx(table.at(share * table.greatest_depth).force * unit, rel=1e-9)
        cell = (contact.x_m[1] - contact.x_m[0]) ** 2
        assert contact.pressure_pa.sum() * cell == pytest.approx(contact.force_n, rel=0.01)
    with refused("outside-table", RangeError, match=f"{most * 1e3:g} mm"):
        pressed(words, most + 0.01e-3)


@pytest.mark.parametrize("words", ["cylinder:6:13", "edge:8"])
def test_without_a_table_linear_layers_press_and_hold_to_their_depth(words):
    assert not has_probe_table(SPEC, palm.parse_probe(words))
    assert not is_tabled_probe(pressed(words, 1.2e-3))
    with refused("outside-linear-range", RangeError, match=r"1\.5 mm"):
        pressed(words, 1.6e-3)


@pytest.mark.parametrize("words", FEW)
def test_a_lean_and_other_membranes_leave_a_probe_to_linear_layers(words):
    assert not has_probe_table(SPEC, palm.parse_probe(f"{words}@2"))
    for other in (
        replace(SPEC, thickness_m=9.5e-3),
        replace(SPEC, friction=0.5),
        replace(SPEC, poisson_ratio=0.48),
        replace(SPEC, diameter_m=50e-3),
    ):
        assert not has_probe_table(other, palm.parse_probe(words))


@pytest.mark.parametrize("words", FEW)
def test_a_rigs_law_of_a_probe_is_the_tables_and_reaches_as_deep(words):
    sensor, probe = Palm(SPEC), palm.parse_probe(f"{words}:20")
    law = sensor.force_law(probe)
    assert law.greatest_m == pytest.approx(deepest(words))
    for depth in (0.05e-3, 1.5e-3):
        alone = sensor.press(probe, Pose(1e-3, -2e-3, depth))
        assert np.interp(depth, law.depth_m, law.force_n) == pytest.approx(alone.force_n, rel=1e-3)
        assert np.interp(depth, law.depth_m, law.radius_m) == pytest.approx(alone.radius_m, rel=0.01)
    assert sensor.known_depth_m(probe) == pytest.approx(deepest(words))
    assert sensor.known_depth_m(probe, lateral=True) == LINEAR_DEPTH_M


def test_a_refusal_names_no_probe_that_this_membrane_has_no_table_of() -> None:
    too_deep, cylinder = Pose(0.0, 0.0, 1.6e-3), palm.parse_probe("cylinder:6:12")
    for changed in ({"friction": 0.3}, {"poisson_ratio": 0.48}, {"diameter_m": 56e-3}):
        spec = replace(SPEC, **changed)
        assert probes_with_table(spec) == ""
        with pytest.raises(RangeError) as refused:
            palm.press(spec, too_deep, cylinder)
        assert "cylinder:" not in str(refused.value)
    with pytest.raises(RangeError, match="cylinder:6:12"):
        palm.press(SPEC, too_deep, palm.parse_probe("cylinder:6:13"))


@pytest.mark.parametrize(("words", "depth"), [(PROBES[0], 0.1e-3), (PROBES[-1], 0.3e-3)])
@pytest.mark.cases(1)
def test_stress_joins_where_the_table_takes_over(words, depth):
    below, above = (laid_of(SPEC, pressed(f"{words}:30", depth + off)).far.stress_pa for off in (-1e-9, 1e-9))
    np.testing.assert_allclose(below, above, atol=1e-4 * np.abs(above).max())


def test_the_light_of_a_light_touch_is_that_of_linear_layers():
    """Of two balls, which have no edge to be rounded; its stress, read on other planes and grids."""
    words, depth = next(each for each in PROBES if each.startswith("two")), 0.05e-3
    layers = press_layers(SPEC, Pose(1e-3, 0.0, depth), palm.parse_probe(words)).contact
    alike = pressed(words, depth, 1e-3)
    assert alike.force_n == pytest.approx(layers.force_n, rel=0.01)
    for seen, other in zip(palm.render_clean(alike, SPEC), palm.render_clean(layers, SPEC), strict=True):
        assert rms(seen - other) < 2e-5
    assert rms(palm.render_clean(alike, SPEC)[0] - light_of(words, 0.06e-3, x_m=1e-3)[0]) > 3e-5


@pytest.mark.parametrize("words", FEW)
def test_the_greatest_pressure_told_is_the_tables_and_not_the_grids(words, monkeypatch):
    """Turned and moved, the grid finds less of it; by linear layers under a light touch."""
    monkeypatch.setattr(fringe_orders, "greatest_order", lambda *_: 0.0)  # which takes seconds
    table, h, E = probe_table_of(SPEC, palm.parse_probe(words)), SPEC.thickness_m, SPEC.youngs_modulus_pa
    for depth in (0.5e-3, 1.5e-3):
        contact = pressed(f"{words}:30", depth, 1e-3, 2e-3)
        told = fringe_orders.contact_summary(contact, SPEC)["peak_pressure_Pa"]
        assert told == pytest.approx(table.at(depth / h).peak_pressure * E, rel=1e-9)
        assert contact.pressure_pa.max() < 1.02 * told
    light = [fringe_orders.contact_summary(pressed(words, d), SPEC)["peak_pressure_Pa"] for d in (0, 0.01e-3)]
    assert light[0] == 0.0
    assert light[1] > pressed(words, 0.01e-3).pressure_pa.max()


@pytest.mark.parametrize("words", FEW)
@pytest.mark.parametrize("depth", [0.05e-3, 1.5e-3])
@pytest.mark.cases(2)
def test_a_lateral_load_leaves_the_press_as_it_is_and_its_shear_is_odd_in_it(words, depth):
    """Linear layers under the same probe have another force, by up to 6 %, and 40 % under a sharp wedge."""
    at = f"{words}:30"
    alone = pressed(at, depth)
    pull = 0.4 * alone.force_n
    there, back = (pressed(at, depth, lateral_n=(sign * pull, 0.0)) for sign in (1, -1))
    for contact in (there, back, pressed(at, depth, lateral_n=(1e-6 * pull, 0.0))):
        assert is_tabled_probe(contact)
        assert (contact.force_n, contact.radius_m) == (alone.force_n, alone.radius_m)
        np.testing.assert_array_equal(contact.pressure_pa, alone.pressure_pa)
        np.testing.assert_array_equal(contact.displacement_m, alone.displacement_m)
    np.testing.assert_allclose(there.shear_pa, -back.shear_pa, atol=1e-6 * np.abs(there.shear_pa).max())
    cell = (alone.x_m[1] - alone.x_m[0]) ** 2
    assert there.shear_pa[0].sum() * cell == pytest.approx(pull, rel=2e-3)
    assert np.hypot(*there.shear_pa).max() <= 1.001 * alone.pressure_pa.max()
    layers = press_layers(SPEC, Pose(0.0, 0.0, depth), palm.parse_probe(at)).contact
    assert layers.force_n != pytest.approx(alone.force_n, rel=2e-3)


@pytest.mark.parametrize("words", FEW)
def test_a_lateral_load_is_bound_to_the_depth_of_linear_layers_and_to_friction(words):
    with refused("outside-linear-range", RangeError, match=r"1\.5 mm"):
        pressed(words, 1.6e-3, lateral_n=(0.1, 0.0))
    with refused("sliding", RangeError):
        pressed(words, 1e-3, lateral_n=(1.02 * pressed(words, 1e-3).force_n, 0.0))
    with refused("no-normal-force", RangeError):
        pressed(words, 0.0, lateral_n=(0.1, 0.0))
