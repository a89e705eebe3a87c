"""Find what a valid reading of softness does not show: other sensors than the calibrated one, other levers.

    python tools/softness_limits.py                     # all, some ten minutes of one core
    python tools/softness_limits.py --only levers       # one part
    python tools/softness_limits.py --seeds 5           # fewer calibrations

Every seed is one calibration, by the presses that `palpate render tactip --seed N` writes; it reads other
presses of the virtual TacTip. Numbers are medians over seeds; they stand in docs/explanations/tactip.md and
docs/decisions/0012. How often intervals hold the truth under nuisances is `compliance_coverage.py`'s.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    calibrate_compliance,
    load_references,
    rate_by_areas,
)
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_nuisances import NONE
from palpate.core import InputError
from palpate.estimators.compliance.pin_press import follow_press
from palpate.sensors.tactip import TacTipSpec, fitted_tactip
from palpate.sensors.tactip.tactip_press import modulus_pa
from palpate.workflows.tactip_trials import (
    REPORT_N_M,
    UNKNOWN,
    record_press,
    record_trials,
    specimens_at,
    stiffness_of,
)

REFERENCES = {name: kappa for name, kappa in REPORT_N_M.items() if name not in UNKNOWN}
SPECIMENS = ("A=2", "new=5.3", "B=6.5", "S1=7.6", "S2=3.1", "S3=1.1")  # N/mm; the last three are references
LONGER_M = 0.66e-3  # lever that the same real taps ask for where tilted ones weigh more
FIRST_SEED = 10_000_000  # of presses that no calibration has seen

Row = tuple[float, float, float, float, bool]  # value, low, high, truth, validity


@cache
def calibration(spec: TacTipSpec, seed: int) -> ComplianceCalibration:
    """The calibration of a virtual experiment, by its files."""
    with tempfile.TemporaryDirectory() as folder:
        words = specimens_at(spec, REFERENCES)
        experiment = record_trials(Path(folder) / "experiment", spec, words, seed=seed)
        return calibrate_compliance(load_references(experiment))


def read(calibrated: ComplianceCalibration, spec: TacTipSpec, words: str, number: int) -> dict[str, Row]:
    """Every quantity of a press, with its true value."""
    made = record_press(spec, words, number)
    press = follow_press(list(made.frames()), made.raw_n, made.frame_sample, made.position_m, made.time_s)
    kappa = stiffness_of(words)
    truths = {
        "stiffness": kappa,
        "stiffness_both": kappa,
        "area": float(made.sensor.on(words).area_m2(np.array([4.0]))[0]),
        "spread_rate": rate_by_areas(press.force_n, made.true_area_m2[made.frame_sample[press.frame]]),
        "modulus": modulus_pa(spec.table, kappa) / (1 - spec.table.poisson_ratio**2),
    }
    reading = read_touch(calibrated, [press])
    found = {name: getattr(reading, name) for name in truths}
    return {name: (one.value, one.low, one.high, truths[name], one.valid) for name, one in found.items()}


def sensors(seeds: int) -> Iterator[str]:
    """Readings of the specimen of 5.3 N/mm by sensors and at speeds other than the calibrated ones.

    Intervals contain nuisances of their standard sizes.
    """
    spec = TacTipSpec()
    longer = replace(spec.pins, length_m=1.02 * spec.pins.length_m)
    others = {
        "as calibrated": spec,
        "levers 2 % longer": replace(spec, pins=longer),
        "2.5 mm/s": replace(spec, speed_m_s=2.5e-3),
        "10 mm/s": replace(spec, speed_m_s=10e-3),
        "tip of a softer skin": replace(spec, tip="soft-skin"),
        "tip of a stiffer skin": replace(spec, tip="stiff-skin"),
    }
    for name, other in others.items():
        presses = []
        for seed in range(seeds):
            with suppress(InputError):  # refused: too much force before contact
                presses.append(read(calibration(spec, seed), other, "new=5.3", FIRST_SEED + 100 * seed))
        yield from told(name, presses)


def levers(seeds: int) -> Iterator[str]:
    """A lever and a camera as fitted to a real tip, and a longer lever, on the calibration's very bench."""
    fitted = fitted_tactip()
    for length_m in (fitted.pins.length_m, LONGER_M):
        spec = replace(fitted, pins=replace(fitted.pins, length_m=length_m))
        presses = defaultdict(list)
        for seed in range(seeds):
            calibrated = replace(calibration(spec, seed), nuisances=NONE)
            for i, words in enumerate(SPECIMENS):
                presses[words].append(read(calibrated, spec, words, FIRST_SEED + 100 * seed + i))
        for words, some in presses.items():
            yield from told(f"331 levers of {1e3 * length_m:g} mm, {words}", some)


def told(name: str, presses: list[dict[str, Row]]) -> Iterator[str]:
    """Of every quantity its median, how many are valid, how many hold the truth, and errors."""
    for quantity in presses[0] if presses else ():
        value, low, high, truth, valid = np.array([press[quantity] for press in presses]).T
        held, error = (low <= truth) & (truth <= high), 100 * (value / truth - 1)
        yield (
            f"{name}; {quantity}: {np.median(value):.4g}, {valid.sum():.0f} of {len(valid)} valid, of these "
            f"{np.sum((valid > 0) & ~held)} with the truth outside; held {100 * held.mean():.0f} %, error "
            f"{np.median(error):+.1f} % (absolute median {np.median(np.abs(error)):.1f} %)"
        )


PARTS = {"sensors": sensors, "levers": levers}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=list(PARTS), action="append")
    parser.add_argument("--seeds", type=int, default=20)
    asked = parser.parse_args()
    for name in asked.only or PARTS:
        print(f"\n{name}", *PARTS[name](asked.seeds), sep="\n", flush=True)


if __name__ == "__main__":
    main()
