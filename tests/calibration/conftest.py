"""Calibrated virtual tip that the tests of compliance share; no test writes to it."""

import pytest
from tests.virtual_presses import KAPPA_N_M, references

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    ReferenceSpecimen,
    calibrate_compliance,
)
from palpate.sensors.tactip import TacTipSpec, tactip
from palpate.workflows.tactip_trials import specimens_at


@pytest.fixture(scope="session")
def spec() -> TacTipSpec:
    return tactip()


@pytest.fixture(scope="session")
def specimens(spec) -> dict[str, str]:
    return specimens_at(spec, KAPPA_N_M)


@pytest.fixture(scope="session")
def given(spec, specimens) -> list[ReferenceSpecimen]:
    """Four trials of each reference, by marker centres with noise."""
    return references(spec, specimens, 4, 7000, rendered=False)


@pytest.fixture(scope="session")
def calibration(given) -> ComplianceCalibration:
    return calibrate_compliance(given, note="virtual")
