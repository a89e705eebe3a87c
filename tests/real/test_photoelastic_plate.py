"""Photographs of a cracked photoelastic plate in tension: a stand-in; no data of our sensors is public.

The plates' authors state C from 3.09e-11 to 3.39e-11 1/Pa, which the values here do not meet: these tests
show that several ways agree with one another, not that their C is right. Two other readings of the same
photographs, done apart from the toolkit, are compared with: one dark fringe is counted by eye along the
line above the crack at the greatest load, so that the far field lies between orders 1 and 2; and each
photograph alone, matched to a finite-element stress field of the plate with its crack, gave a median C of
4.3e-11 1/Pa (4.1e-11 to 4.9e-11 over the nine).
"""

import pytest

from palpate.calibration.stress_optic_fit import Strip, fit_stress_optic
from palpate.estimators.fringe_light import one_line

PLATE = Strip(52e-3, 5.7e-3)
SODIUM = one_line(589.3e-9)  # the photographs are sodium yellow; the lamp is not on record
FAR_BELOW, FAR_ABOVE = (20, 1080, 610, 80), (20, 80, 610, 80)  # [px], across the width, away from the crack
C_OF_EACH_PHOTOGRAPH = (4.1e-11, 4.9e-11)  # [1/Pa]


@pytest.fixture(scope="module")
def plate(real_data):
    folder = real_data / "photoelastic-plate"
    if not folder.is_dir():
        pytest.skip(f"no photographs of the photoelastic plate at {folder}")
    return folder


@pytest.mark.parametrize("region", [FAR_BELOW, FAR_ABOVE], ids=["below", "above"])
def test_light_alone_allows_a_second_slope_and_this_is_said(plate, region) -> None:
    found = fit_stress_optic(plate, plate / "labels.csv", PLATE, SODIUM, region)
    assert found.ambiguous
    twice = found.rivals[0].coefficient_per_pa / found.coefficient_per_pa
    assert twice == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("region", [FAR_BELOW, FAR_ABOVE], ids=["below", "above"])
def test_with_the_fringes_counted_the_coefficient_agrees_with_the_crack_s_field(plate, region) -> None:
    found = fit_stress_optic(plate, plate / "labels.csv", PLATE, SODIUM, region, greatest_order=2.5)
    assert not found.ambiguous
    low, high = C_OF_EACH_PHOTOGRAPH
    assert found.low_per_pa < high
    assert found.high_per_pa > low
    assert low < found.coefficient_per_pa < high
    assert found.monotone
    assert found.r_squared > 0.95
    assert any("exposure differs" in remark for remark in found.remarks)
