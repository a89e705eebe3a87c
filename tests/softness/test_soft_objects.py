"""Characteristics of objects: rising throughout, inverse to themselves, each number with its unit."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.mechanics.half_space.hertz import Body
from palpate.softness import Characteristic, SoftObject, hertz_object, read_object

TABLES = """
name = "foam ball"
[force_area]
area_mm2 = [0.0, 20.0, 60.0, 130.0]
force_N = [0.0, 0.6, 1.6, 3.4]
[force_displacement]
displacement_mm = [0.0, 1.0, 2.0, 4.0]
force_N = [0.0, 0.5, 1.3, 3.6]
"""
POLYNOMIALS = """
[force_area]
N_per_cm2 = [0.554, 0.33, 1.4]
until_cm2 = 1.3
[force_displacement]
N_per_mm = [0.1, 0.9]
until_mm = 4
"""
HERTZ = """
[hertz]
modulus_kPa = 37.5
radius_mm = inf
poisson = 0.5
finger_modulus_kPa = 75
finger_radius_mm = 15
finger_poisson = 0.5
until_N = 5
"""


def from_text(tmp_path: Path, text: str) -> SoftObject:
    path = tmp_path / "object.toml"
    path.write_text(text)
    return read_object(path)


def test_a_hertz_object_is_its_closed_form_within_a_ten_thousandth() -> None:
    ball, finger = Body(5e4, 10e-3), Body(1e5, 15e-3)
    soft, both = hertz_object("ball", ball, finger, 5.0), ball.against(finger)
    F = np.linspace(0.05, 5.0, 77)
    assert_allclose(soft.area.at_force(F), both.area_m2(F), rtol=1e-4)
    assert_allclose(soft.displacement.at_force(F), both.approach_m(F), rtol=1e-4)


def test_tables_polynomials_and_bodies_are_read_in_their_units(tmp_path: Path) -> None:
    tables = from_text(tmp_path, TABLES)
    assert tables.name == "foam ball"
    assert_allclose(tables.area.force_at(40e-6), 1.1)
    assert_allclose(tables.displacement.force_at(3e-3), 2.45)
    polynomials = from_text(tmp_path, POLYNOMIALS)
    assert_allclose(polynomials.area.force_at(1e-4), 0.554 + 0.33 + 1.4, rtol=1e-6)
    assert_allclose(polynomials.displacement.force_at(2e-3), 1.9, rtol=1e-9)
    flat = from_text(tmp_path, HERTZ)
    both = Body(50e3, math.inf).against(Body(100e3, 15e-3))  # over 1 - nu²
    assert_allclose(flat.displacement.at_force(2.0), both.approach_m(2.0), rtol=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("area_mm2", "area", "unit-missing"),
        ("displacement_mm", "displacement_cm2", "unit-missing"),
        ("0.6, 1.6", "1.6, 0.6", "not-monotone"),
        ("20.0, 60.0", "20.0, 20.0", "not-monotone"),
        ("[0.0, 0.5", "[-0.1, 0.5", "below-zero"),
        ("0.5, 1.3", "nan, 1.3", "not-finite"),
        ("0.5, 1.3", '"a", 1.3', "not-a-list"),
        ("0.5, 1.3", "1.3", "table-size"),
        ("[force_displacement]", "[force_depth]", "field-unknown"),
        ('name = "foam ball"', "name = ", "toml"),
    ],
)
def test_files_that_say_no_object_are_refused_by_what_is_wrong(
    tmp_path: Path, old: str, new: str, code: str
) -> None:
    with refused(code, InputError):
        from_text(tmp_path, TABLES.replace(old, new, 1))


def test_fields_of_bodies_are_checked(tmp_path: Path) -> None:
    with refused("poisson", InputError):
        from_text(tmp_path, HERTZ.replace("poisson = 0.5", "poisson = 0.7", 1))
    with refused("not-a-number", InputError, match="finger_modulus_kPa"):
        from_text(tmp_path, HERTZ.replace("finger_modulus_kPa = 75", ""))
    with pytest.raises(InputError, match="measured curve"):
        from_text(tmp_path, HERTZ + TABLES.replace('name = "foam ball"', ""))
    with refused("force-range", RangeError):
        from_text(tmp_path, HERTZ.replace("until_N = 5", "until_N = 0"))
    with refused("file-missing", InputError):
        read_object(tmp_path / "none.toml")


def test_a_force_that_no_table_has_is_refused() -> None:
    curve = Characteristic("displacement", np.array([0.0, 1e-3]), np.array([0.0, 1.0]))
    for wrong in (-0.1, 1.1, math.nan):
        with pytest.raises(RangeError):
            curve.at_force(wrong)
        with pytest.raises(RangeError):
            curve.force_at(1e-3 * wrong)
