"""Objects that a named finger presses, from files: units in keys, nothing too much, nothing impossible."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.calibration.compliance.press_cues import reading_record
from palpate.core import InputError, PalpateError, RangeError, Reading, UnitError
from palpate.mechanics.half_space.hertz import Body
from palpate.softness import SoftObject, read_object

FINGER = Body(75e3 / 0.75, 15e-3)
HERTZ = """
[fingertip]
model = "hertz"
modulus_kPa = 75
radius_mm = 15
poisson = 0.5
until_N = 2.4
"""
EXPONENTIAL = """
[fingertip]
model = "exponential"
b_N = 0.1
m_per_mm = 1.5
area_at_1_N_mm2 = 80
area_exponent = 0.5
until_N = 2
"""
TIP = """
[fingertip]
model = "finite-strain"
tip = "base"
radius_mm = 20
gel_modulus_kPa = 15
until_N = 4
"""
SILICONE = """
[material]
name = "some silicone"
modulus_kPa = 150
poisson = 0.49
"""
MEASURED = """
[compliance]
readings = "press/readings.json"
use = "modulus"
"""
BY_STIFFNESS = """
[compliance]
readings = "press/readings.json"
use = "stiffness"
specimen_radius_mm = 20
specimen_height_mm = 40
poisson = 0.5
"""
SPECIMEN = """
[specimen]
class = "CL3"
number = 2
moduli_kPa = [800, 500, 300, 150, 100]
poisson = 0.499
finger_modulus_kPa = 75
finger_radius_mm = 15
finger_poisson = 0.5
until_N = 1.5
"""
FORCES = np.array([0.3, 1.0, 1.9])


def reading(quantity: str, unit: str, value: float) -> Reading:
    return Reading(
        quantity=quantity, unit=unit, value=value, low=0.8 * value, high=math.inf, coverage=0.9, valid=True,
        why="", drift=None, calibration="compliance-51b9", calibrated_range=(0.0, math.inf), frame="new",
        time_s=0.0,
    )  # fmt: skip


MODULUS, STIFFNESS = reading("modulus", "Pa", 0.2e6), reading("stiffness", "N_per_m", 5.0e3)


def touched(folder: Path, *readings: Reading, **changes: Any) -> None:
    """What `palpate read` writes of these readings, with values put in."""
    (folder / "press").mkdir(exist_ok=True)
    record = {"readings": [reading_record(one) | changes for one in readings], "flags": []}
    (folder / "press" / "readings.json").write_text(json.dumps(record))


def from_text(folder: Path, text: str) -> SoftObject:
    path = folder / "thing.toml"
    path.write_text(text)
    return read_object(path)


def check_hertz(soft: SoftObject, both: Body) -> None:
    assert_allclose(soft.displacement.at_force(FORCES), both.approach_m(FORCES), rtol=1e-4)
    assert_allclose(soft.area.at_force(FORCES), both.area_m2(FORCES), rtol=1e-4)


def test_a_finger_alone_is_on_a_rigid_flat(tmp_path: Path) -> None:
    soft = from_text(tmp_path, HERTZ)
    check_hertz(soft, FINGER)
    assert soft.name == "thing"
    assert soft.source.startswith("rigid flat; Hertz")
    assert_allclose(soft.greatest_n, 2.4)


def test_a_material_is_a_flat_of_its_modulus(tmp_path: Path) -> None:
    soft = from_text(tmp_path, HERTZ + SILICONE)
    check_hertz(soft, Body(150e3 / (1 - 0.49**2), math.inf).against(FINGER))
    assert soft.source.startswith("some silicone: 150 kPa, Poisson's ratio 0.49; Hertz")


def test_a_measured_modulus_is_over_one_less_its_poisson_squared_already(tmp_path: Path) -> None:
    touched(tmp_path, STIFFNESS, MODULUS)
    soft = from_text(tmp_path, HERTZ + MEASURED)
    check_hertz(soft, Body(0.2e6, math.inf).against(FINGER))
    assert "calibration compliance-51b9" in soft.source


def test_a_measured_stiffness_is_of_a_cylinder_that_sticks_to_its_plates(tmp_path: Path) -> None:
    touched(tmp_path, STIFFNESS)
    soft = from_text(tmp_path, HERTZ + BY_STIFFNESS)
    E = 5e3 * 40e-3 / (math.pi * 20e-3**2) / (1 + 2 * 0.25**2)
    check_hertz(soft, Body(E / 0.75, math.inf).against(FINGER))
    assert "N_per_mm (4" in soft.source


@pytest.mark.parametrize(
    ("text", "old", "new", "error", "code"),
    [
        (HERTZ, '"hertz"', '"thumb"', InputError, "word-unknown"),
        (HERTZ, "radius_mm", "radius", InputError, "field-unknown"),
        (HERTZ, "= 75", "= -75", RangeError, "not-positive"),
        (HERTZ, "= 75", "= inf", RangeError, "not-positive"),
        (HERTZ, "until_N = 2.4", "until_N = 4", RangeError, "outside-law"),
        (HERTZ, "until_N = 2.4", "until_N = 0", RangeError, "not-positive"),
        (HERTZ, "poisson = 0.5", "poisson = 0.6", RangeError, "poisson"),
        (EXPONENTIAL, "m_per_mm", "m_per_cm", InputError, "field-unknown"),
        (EXPONENTIAL, "exponent = 0.5", "exponent = 0.8", RangeError, "exponent-range"),
        (EXPONENTIAL, "until_N = 2", "until_N = 2.1", RangeError, "outside-law"),
        (TIP, '"base"', '"toe"', InputError, "unknown-name"),
        (HERTZ + SILICONE, "= 150", "= 0", RangeError, "not-positive"),
        (HERTZ + SILICONE, "until_N = 2.4", "until_N = 2.6", RangeError, "outside-law"),
        (HERTZ + SILICONE, "0.49", '"soft"', InputError, "not-a-number"),
        (HERTZ + SILICONE, "modulus_kPa = 150", "", InputError, "not-a-number"),
        (HERTZ + SILICONE, '"some silicone"', "3", InputError, "word-unknown"),
        (HERTZ + SILICONE + MEASURED, "", "", InputError, "tables-exclude"),
        (SILICONE, "", "", InputError, "table-missing"),
        (HERTZ + SPECIMEN, "", "", InputError, "tables-exclude"),
        ('source = "me"\n' + HERTZ, "", "", InputError, "source-excluded"),
        (SPECIMEN, '"CL3"', '"CL4"', InputError, "word-unknown"),
        (SPECIMEN, "number = 2", "number = 0", RangeError, "specimen-number"),
        (SPECIMEN, "number = 2", "number = 1.5", RangeError, "specimen-number"),
        (SPECIMEN, ", 100]", "]", InputError, "moduli-count"),
        (SPECIMEN, "0.499", "0.5", RangeError, "poisson"),
        (SPECIMEN, "until_N = 1.5", "until_N = 50", RangeError, "outside-law"),
        (SPECIMEN, "moduli_kPa", "moduli", InputError, "field-unknown"),
    ],
)
def test_files_of_no_object_are_refused_by_what_is_wrong(
    tmp_path: Path, text: str, old: str, new: str, error: type[PalpateError], code: str
) -> None:
    with refused(code, error):
        from_text(tmp_path, text.replace(old, new, 1) if old else text)


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"valid": False, "why": "drifted"}, InputError, "reading-invalid"),
        ({"unit": "kPa"}, UnitError, "unit"),
        ({"value": None}, RangeError, "range"),
        ({"value": -0.2}, RangeError, "range"),
        ({"low": -1.0}, RangeError, "range"),
        ({"quantity": "radius"}, InputError, "reading-count"),
    ],
)
def test_readings_that_say_no_modulus_are_refused(
    tmp_path: Path, changes: dict[str, Any], error: type[PalpateError], said: str
) -> None:
    touched(tmp_path, MODULUS, **changes)
    with refused(said, error):
        from_text(tmp_path, HERTZ + MEASURED)


def test_a_record_that_is_none_or_has_two_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"readings\.json"):
        from_text(tmp_path, HERTZ + MEASURED)
    touched(tmp_path, MODULUS, replace(MODULUS, frame="other"))
    with refused("reading-count", InputError, match="2 readings"):
        from_text(tmp_path, HERTZ + MEASURED)
    for text in ("[]", "nothing", '{"readings": 3}'):
        (tmp_path / "press" / "readings.json").write_text(text)
        with pytest.raises(InputError, match="no record"):
            from_text(tmp_path, HERTZ + MEASURED)
    (tmp_path / "press" / "readings.json").write_text('{"readings": [{"quantity": "modulus"}]}')
    with refused("reading-incomplete", InputError, match="'value'"):
        from_text(tmp_path, HERTZ + MEASURED)


def test_a_stiffness_without_its_specimens_size_is_refused(tmp_path: Path) -> None:
    touched(tmp_path, STIFFNESS)
    with refused("not-a-number", InputError, match="specimen_height_mm"):
        from_text(tmp_path, HERTZ + BY_STIFFNESS.replace("specimen_height_mm = 40", ""))
    with refused("field-unknown", InputError, match="'poisson'"):
        from_text(tmp_path, HERTZ + MEASURED + "poisson = 0.5\n")
