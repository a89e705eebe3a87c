"""Modulus and radius come back through pins: spheres, rigid and soft, flats, and bodies that are neither.

Ideal marker centres with 0.02 px of noise stand for rendered frames, as in `test_tactip_compliance`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.virtual_presses import pressed

from palpate.calibration.compliance.compliance_calibration import ReferenceSpecimen, calibrate_compliance
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import shape_of, specimens_at, stiffness_of

FLATS = {"rigid": math.inf, "S1": 7.6e3, "S2": 3.1e3, "S3": 1.1e3}
SPHERES = {
    "R20": "sphere:R_mm=20",
    "R30": "sphere:R_mm=30",
    "R60": "sphere:R_mm=60",
    "S2R20": "sphere:R_mm=20,E_MPa=0.0987",
    "S2R40": "sphere:R_mm=40,E_MPa=0.0987",
    "S3R20": "sphere:R_mm=20,E_MPa=0.035",
    "S3R40": "sphere:R_mm=40,E_MPa=0.035",
}
PLANE = 1 - 0.48**2
OF_FLATS = ("stiffness", "stiffness_both", "area", "spread_rate")


@pytest.fixture(scope="module")
def spec():
    return replace(tactip(), speed_m_s=6e-3)


@pytest.fixture(scope="module")
def references(spec):
    words = specimens_at(spec, FLATS | SPHERES)
    return [
        ReferenceSpecimen(
            name, stiffness_of(one), pressed(spec, one, 3, 1000 * i, rendered=False), shape_of(spec, one)
        )
        for i, (name, one) in enumerate(words.items())
    ]


@pytest.fixture(scope="module")
def calibration(references):
    return calibrate_compliance(references)


def read(spec, calibration, body, seed=77):
    (words,) = specimens_at(spec, {"one": body}).values()
    (trial,) = pressed(spec, words, 1, seed, rendered=False)
    return read_touch(calibration, [trial.press])


@pytest.mark.parametrize(("modulus_mpa", "radius_mm"), [(0.15, 30), (0.06, 25), (0.2, 50)])
@pytest.mark.cases(1)
def test_a_soft_spheres_modulus_and_radius_are_found(spec, calibration, modulus_mpa, radius_mm) -> None:
    found = read(spec, calibration, f"sphere:R_mm={radius_mm},E_MPa={modulus_mpa}")
    E, R = 1e6 * modulus_mpa / PLANE, 1e-3 * radius_mm
    assert found.modulus.valid
    assert found.radius.valid
    assert found.modulus.low <= E <= found.modulus.high
    assert found.radius.low <= R <= found.radius.high
    assert abs(np.log(found.modulus.value / E)) < 0.2
    assert abs(found.radius.value / R - 1) < 0.1
    assert found.radius.high / found.radius.low < 2  # it tells something
    for name in OF_FLATS:
        assert "curved" in getattr(found, name).why


def test_a_rigid_spheres_radius_is_found_and_its_modulus_is_said_to_be_beyond(spec, calibration) -> None:
    found = read(spec, calibration, "sphere:R_mm=40")
    assert found.radius.valid
    assert found.radius.low <= 40e-3 <= found.radius.high
    assert not found.modulus.valid
    assert "rigid" in found.modulus.why


def test_a_flat_is_read_as_flat_and_keeps_its_stiffness(spec, calibration) -> None:
    found = read(spec, calibration, 5.3e3)
    assert found.radius.valid
    assert found.radius.low > 0.1
    assert np.isinf(found.radius.high)
    assert found.modulus.low <= 0.1687e6 / PLANE <= found.modulus.high
    for name in OF_FLATS:
        assert getattr(found, name).valid


@pytest.mark.parametrize(
    "body", ["layer:h_mm=2,E_MPa=0.1", "layer:h_mm=4,E_MPa=0.03", "layer:h_mm=8,E_MPa=0.03"]
)
@pytest.mark.cases(1)
def test_a_thin_layer_has_no_valid_modulus(spec, calibration, body) -> None:
    found = read(spec, calibration, body)
    assert not found.modulus.valid
    assert "layer on a hard base" in found.modulus.why


def test_a_calibration_on_flats_alone_refuses_a_sphere(spec, references) -> None:
    flats = calibrate_compliance([one for one in references if one.name in FLATS])
    assert flats.shape is None
    found = read(spec, flats, "sphere:R_mm=30,E_MPa=0.15")
    assert not any(one.valid for one in found.readings)
    assert "as on no reference" in found.stiffness.why


def test_the_calibration_comes_back_from_its_file(calibration, tmp_path) -> None:
    calibration.save(tmp_path / "tip.npz")
    again = type(calibration).load(tmp_path / "tip.npz")
    assert again.id == calibration.id
    np.testing.assert_allclose(again.shape.between, calibration.shape.between)
