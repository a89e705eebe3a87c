"""Known stiffness comes back: virtual tips on the report's specimens, upright and inclined, many seeds.

Ideal marker centres with 0.02 px of noise stand for rendered frames, in which pins are found to about that.
Every seed calibrates on five trials of a rigid plate and of S1, S2 and S3, and reads five other trials of
each specimen and of the new one as one. "new" is among no references.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.virtual_presses import KAPPA_N_M, pressed, references

from palpate.calibration.compliance.compliance_calibration import calibrate_compliance
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import specimens_at

SEEDS, FEW_SEEDS, TRIALS = 20, 5, 5
STIFFEST_FIRST = ("S1", "new", "S2", "S3")
TIPS = ("base", "soft-skin", "stiff-skin", "even")
BOTH_WITHIN = 0.06


def told(spec, specimens, tilt_rad: float, seed: int) -> tuple[dict[str, float], dict[str, float], bool]:
    """Stiffness of every specimen by touch and by both cues; whether the new one's interval holds it."""
    start = 100_000 * (seed + 1)
    calibration = calibrate_compliance(
        references(spec, specimens, TRIALS, start, rendered=False), tilt_rad=tilt_rad
    )
    touch, both, held = {}, {}, False
    for i, name in enumerate(STIFFEST_FIRST):
        trials = pressed(spec, specimens[name], TRIALS, start + 1000 * (i + 1), rendered=False)
        found = read_touch(calibration, [trial.press for trial in trials])
        touch[name], both[name] = found.stiffness.value, found.stiffness_both.value
        if name == "new":
            held = found.stiffness.low <= KAPPA_N_M[name] <= found.stiffness.high
    return touch, both, held


@pytest.mark.slow
@pytest.mark.parametrize("tip", TIPS)
@pytest.mark.parametrize(("tilt_deg", "within"), [(0, 0.15), (30, 0.25), (45, 0.25)])
def test_specimens_are_ordered_and_the_new_ones_stiffness_found(tip, tilt_deg, within) -> None:
    ordered_and_found(replace(tactip(), tip=tip), tilt_deg, within, SEEDS)


@pytest.mark.slow
def test_specimens_at_30_degrees_of_finite_strain_are_ordered_and_told_too() -> None:
    ordered_and_found(replace(tactip(), friction=0.0), 30, 0.25, FEW_SEEDS)


def ordered_and_found(spec, tilt_deg: int, within: float, seeds: int) -> None:
    tip, tilt = spec.tip, float(np.deg2rad(tilt_deg))
    specimens = specimens_at(spec, KAPPA_N_M, tilt)
    found = [told(spec, specimens, tilt, seed) for seed in range(seeds)]
    touch = np.array([[one[name] for name in STIFFEST_FIRST] for one, _, _ in found])
    new, both = (np.array([one[i]["new"] for one in found]) / KAPPA_N_M["new"] - 1 for i in range(2))
    ordered = (np.diff(touch, axis=1) < 0).all(axis=1)
    print(
        f"\n{tip} at {tilt_deg} degrees: ordered in {ordered.sum()} of {seeds}; new by touch "
        f"{100 * new.mean():+.1f} % (median error {100 * np.median(np.abs(new)):.1f}, worst "
        f"{100 * new[np.abs(new).argmax()]:+.1f} %), by both cues {100 * both.mean():+.1f} % (worst "
        f"{100 * both[np.abs(both).argmax()]:+.1f} %); the interval by touch holds it in "
        f"{sum(held for _, _, held in found)} of {seeds}"
    )
    assert ordered.all(), touch[~ordered]
    assert np.abs(new).max() < within
    if tip == "base":
        assert np.abs(both).max() < BOTH_WITHIN
