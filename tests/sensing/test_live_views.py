"""What a live sensor's process tells beyond readings: strain of a marked skin, softness of a press."""

from __future__ import annotations

import pytest
from tests.virtual_presses import KAPPA_N_M, references

from palpate.calibration.compliance.compliance_calibration import calibrate_compliance
from palpate.sensing.live_client import LiveClient, launch_live
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import specimens_at

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
LONG_S = 200.0


def told(name, options, folder, holds):
    """The first status of a sensor's process for which something holds; the process is ended."""
    process, _ = launch_live(name, options, folder=folder)
    with LiveClient(name, folder) as client:
        try:
            return client.wait_for(holds, LONG_S)
        finally:
            client.shutdown()
            process.wait(60)


def test_a_nusense_tells_where_its_skin_is_strained(tmp_path) -> None:
    options = {"camera": "virtual:nusense", "shear": "nusense", "seed": 0}

    def pressed(status):
        strain = status["strain"] or {"contacts": [], "dots": []}
        return strain["contacts"] and len(strain["dots"]) > 10  # a first touch strains less

    status = told("live marks", options, tmp_path, pressed)
    left, top, width, height = status["strain"]["box"]
    for x, y in status["strain"]["contacts"]:
        assert left < x < left + width
        assert top < y < top + height


def test_a_tip_on_a_body_tells_its_softness_within_the_interval(tmp_path) -> None:
    spec = tactip()
    given = references(spec, specimens_at(spec, KAPPA_N_M), 2, 7000, rendered=False)
    calibrate_compliance(given, note="virtual").save(tmp_path / "tip.npz")
    options = {"camera": "virtual:tactip/S3=1.1", "compliance": str(tmp_path / "tip.npz"), "seed": 0}

    def read(status):
        return any(one["readings"] for one in status["compliance"]["presses"])

    presses = told("live tip/S3=1.1", options, tmp_path, read)["compliance"]["presses"]
    kappa = next(one["readings"][0] for one in presses if one["readings"])
    assert kappa["quantity"] == "stiffness"
    assert kappa["low"] < 1.1 < kappa["high"] < 2.0
