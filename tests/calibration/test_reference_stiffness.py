"""A stated stiffness that the presses contradict is refused, before anything is written."""

from dataclasses import replace

import numpy as np
import pytest
from tests.virtual_presses import KAPPA_N_M, references, without_area

from palpate.calibration.compliance.compliance_calibration import calibrate_compliance
from palpate.calibration.compliance.reference_stiffness import ReferenceStiffnessError
from palpate.core.errors import InputError
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import specimens_at

KNOWN = {**KAPPA_N_M, "S2": 2.3e3}


@pytest.fixture(scope="module")
def given():
    spec = tactip()
    return references(spec, specimens_at(spec, KNOWN), 2, 9000, rendered=False)


def typed(given, name: str, factor: float):
    return [replace(one, kappa_n_m=one.kappa_n_m * factor) if one.name == name else one for one in given]


def without_position(given):
    return [
        replace(one, trials=tuple(replace(t, press=replace(t.press, position_m=None)) for t in one.trials))
        for one in given
    ]


def test_sound_references_calibrate(given) -> None:
    assert calibrate_compliance(without_area(without_position(given))).both is None
    # as well as a plate measures it
    assert calibrate_compliance(without_area(typed(given, "S2", 1.08))).both is not None


@pytest.mark.parametrize("name", ["S1", "S2", "S3"])
@pytest.mark.parametrize("factor", [0.1, 0.5, 0.7, 1.45, 2.0, 10.0])
@pytest.mark.cases(3)
def test_a_wrong_stiffness_is_refused_with_its_name_and_both_numbers(given, name, factor) -> None:
    with pytest.raises(ReferenceStiffnessError) as refused:
        calibrate_compliance(typed(given, name, factor))
    assert isinstance(refused.value, InputError)
    assert refused.value.code == "reference-stiffness"
    assert refused.value.reference == name
    assert refused.value.stated_n_m == pytest.approx(factor * KNOWN[name])
    assert refused.value.expected_n_m == pytest.approx(KNOWN[name], rel=0.1)
    for number in (refused.value.stated_n_m, refused.value.expected_n_m):
        assert f"{1e-3 * number:.3g} N/mm" in str(refused.value)


def test_two_references_that_were_exchanged_are_refused(given) -> None:
    kappa = {"S1": KNOWN["S2"], "S2": KNOWN["S1"]}
    swapped = [replace(one, kappa_n_m=kappa.get(one.name, one.kappa_n_m)) for one in given]
    for some in (swapped, without_position(swapped)):
        with pytest.raises(ReferenceStiffnessError):
            calibrate_compliance(some)


@pytest.mark.parametrize(("name", "factor"), [("S2", 10.0), ("S2", 0.1), ("S1", 10.0)])
@pytest.mark.cases(1)
def test_without_positions_the_others_read_a_reference_between_them(given, name, factor) -> None:
    with pytest.raises(ReferenceStiffnessError) as refused:
        calibrate_compliance(typed(without_position(given), name, factor))
    assert abs(np.log(refused.value.expected_n_m / refused.value.stated_n_m)) > 1
