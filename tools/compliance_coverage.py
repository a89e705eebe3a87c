"""How often intervals of compliance presses contain the truth: many presses, by their pins' centres.

    python tools/compliance_coverage.py                             # all presets, 0, 30 and 45 degrees
    python tools/compliance_coverage.py --preset 331-fitted --tilt 0 --presses 900 --calibrations 20

Every press has a specimen of its own (1.5 to 6.5 N/mm), its own seating, noise and nuisances, and is read
under nothing, under each nuisance of its stated size and either sign, and under all of them drawn at once.
Calibrations are many, of presses of their own. An inclined specimen that no table holds takes ten seconds.
`--draws development` takes other seeds, for setting anything; the figures in docs/how-to/measure-softness.md
are of the others, which set nothing.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np
from centre_presses import CentrePress
from scipy.stats import binom

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    ReferenceSpecimen,
    calibrate_compliance,
    rate_by_areas,
)
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_nuisances import Nuisances
from palpate.core import InputError, RangeError
from palpate.sensors.tactip import TacTipSpec, fitted_tactip
from palpate.sensors.tactip.tactip_press import modulus_pa
from palpate.workflows.tactip_trials import REPORT_N_M, UNKNOWN, record_press

PRESETS = {
    "127": TacTipSpec(),
    "331-fitted": fitted_tactip(),
    "331-smooth": replace(fitted_tactip(), friction=0.0),  # whose inclined presses are of finite strain
}
TILTS_DEG = (0, 30, 45)
REFERENCES = {name: kappa for name, kappa in REPORT_N_M.items() if name not in UNKNOWN}
TRIALS = 5  # of each reference
KAPPA_N_M = (1.5e3, 6.5e3)
SEEDS = {"test": 10_000_000, "development": 500_000_000}
NUISANCES = tuple(one.name for one in fields(Nuisances))
CONDITIONS = ("none", *NUISANCES, "all")
QUANTITIES = ("stiffness", "stiffness_both", "area", "spread_rate", "modulus", "radius")
REPEATED, REPEATS = 5.3, 5  # N/mm of a specimen, and its presses a calibration, for repeatability

Asked = tuple[str, Mapping[str, float], Mapping[str, float]]  # condition, sizes, truths


def words_of(kappa_n_m: float, tilt_deg: int) -> str:
    """What is pressed, as the TacTip has it."""
    face = "rigid" if math.isinf(kappa_n_m) else f"specimen={1e-3 * kappa_n_m:.15g}"
    return f"{face}@{tilt_deg}" if tilt_deg else face


def calibration_of(spec: TacTipSpec, tilt_deg: int, seed: int) -> ComplianceCalibration:
    """A calibration on five presses of each reference."""
    references = []
    for i, (name, kappa) in enumerate(REFERENCES.items()):
        words, first = words_of(kappa, tilt_deg), seed + 10 * i
        trials = [CentrePress(record_press(spec, words, first + k)).trial() for k in range(TRIALS)]
        references.append(ReferenceSpecimen(name, kappa, tuple(trials)))
    return calibrate_compliance(references, tilt_rad=math.radians(tilt_deg))


def sizes_of(condition: str, rng: np.random.Generator) -> dict[str, float]:
    """Nuisances of a press: none, one of its standard size and either sign, or all from normal laws."""
    standard = Nuisances()
    if condition == "none":
        return {}
    if condition == "all":
        return {name: getattr(standard, name) * rng.standard_normal() for name in NUISANCES}
    return {condition: getattr(standard, condition) * rng.choice((-1.0, 1.0))}


def truths_of(pressed: CentrePress, kappa_n_m: float) -> dict[str, float]:
    """True value of every quantity of a press."""
    made, press = pressed.made, pressed.press({})
    table, tip = made.sensor.spec.table, made.sensor.on(made.words)
    force_n = made.true_force_n[made.frame_sample[press.frame]]
    return {
        "stiffness": kappa_n_m,
        "stiffness_both": kappa_n_m,
        "area": float(tip.area_m2(np.array([4.0]))[0]),
        "spread_rate": rate_by_areas(force_n, pressed.true_area_m2(press)),
        "modulus": modulus_pa(table, kappa_n_m) / (1 - table.poisson_ratio**2),
        "radius": math.inf,
    }


@dataclass
class Readings:
    """What presses were read as.

    Attributes:
        rows: value, low, high, truth and validity of every reading, by condition and quantity.
        refused: presses that could not be read at all, by condition.
        repeated: relative variance of the area at 4 N over presses of one specimen, of every calibration.
    """

    rows: dict[tuple[str, str], list[tuple[float, float, float, float, bool]]] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    repeated: list[float] = field(default_factory=list)

    def add(self, calibration: ComplianceCalibration, pressed: CentrePress, asked: Asked) -> None:
        """Read a press under a condition."""
        condition, sizes, truths = asked
        self.refused.setdefault(condition, 0)
        try:
            reading = read_touch(calibration, [pressed.press(sizes)])
        except (InputError, RangeError):
            self.refused[condition] += 1
            return
        for name in QUANTITIES:
            one = getattr(reading, name)
            if one is not None:
                row = (one.value, one.low, one.high, truths[name], one.valid)
                self.rows.setdefault((condition, name), []).append(row)

    def told(self) -> Iterator[str]:
        """Coverage of valid readings, errors, and the repeatability."""
        for (condition, name), some in self.rows.items():
            value, low, high, truth, valid = np.array(some, np.float64).T
            good = valid > 0
            n, out = int(good.sum()), f"{condition:16s} {name:15s}"
            if not n:
                yield f"{out} none of {len(good)} valid"
                continue
            held = ((low <= truth) & (truth <= high))[good]
            error = (value / truth - 1)[good]
            band = 100 * binom.ppf([0.025, 0.975], n, 0.9) / n
            yield (
                f"{out} {n:4d} valid, {len(good) - n:3d} not, {self.refused[condition]:3d} refused: covered "
                f"{100 * held.mean():5.1f} % (of 90 %: {band[0]:.1f} to {band[1]:.1f}); error median "
                f"{100 * np.median(np.abs(error)):.2f} %, worst {100 * np.abs(error).max():.1f} %, bias "
                f"{100 * np.median(error):+.2f} %; half width "
                f"{100 * np.median(((high - low) / truth / 2)[good]):.1f} %"
            )
        if self.repeated:
            yield f"area at 4 N repeats to {100 * math.sqrt(np.mean(self.repeated)):.2f} %"


def read_presses(
    spec: TacTipSpec, tilt_deg: int, counts: Mapping[str, int], calibrations: int, seed: int
) -> Readings:
    """Presses of every condition, as many as asked for, spread evenly over calibrations."""
    results = Readings()
    for c in range(calibrations):
        begun = seed + 100_000 * c
        calibration = calibration_of(spec, tilt_deg, begun)
        results.repeated.append(_repeatability(spec, tilt_deg, calibration, begun + 500))
        for k in range(-(-max(counts.values()) // calibrations)):
            number = begun + 1000 + k
            rng = np.random.default_rng([number, 9])
            kappa = float(rng.uniform(*KAPPA_N_M))
            pressed = CentrePress(record_press(spec, words_of(kappa, tilt_deg), number))
            truths = truths_of(pressed, kappa)
            for condition, count in counts.items():
                sizes = sizes_of(condition, rng)
                if k < -(-count // calibrations):
                    results.add(calibration, pressed, (condition, sizes, truths))
        print(f"  {c + 1} of {calibrations} calibrations", time.strftime("%H:%M:%S"), flush=True)
    return results


def _repeatability(spec: TacTipSpec, tilt_deg: int, calibration: ComplianceCalibration, seed: int) -> float:
    """Relative variance of the area at 4 N over presses of one specimen."""
    words = words_of(1e3 * REPEATED, tilt_deg)
    pressed = [CentrePress(record_press(spec, words, seed + k)).press({}) for k in range(REPEATS)]
    areas = [one.value for press in pressed if (one := read_touch(calibration, [press]).area) is not None]
    return float(np.var(areas, ddof=1) / np.mean(areas) ** 2)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", choices=list(PRESETS), action="append")
    parser.add_argument("--tilt", type=int, choices=TILTS_DEG, action="append")
    parser.add_argument("--presses", type=int, default=900, help="with all nuisances drawn")
    parser.add_argument("--single", type=int, default=200, help="with none, and with each alone")
    parser.add_argument("--calibrations", type=int, default=20)
    parser.add_argument("--draws", choices=list(SEEDS), default="test")
    parser.add_argument("--condition", choices=CONDITIONS, action="append")
    asked = parser.parse_args()
    for preset in asked.preset or PRESETS:
        for tilt in asked.tilt or TILTS_DEG:
            wanted = asked.condition or CONDITIONS
            counts = {one: asked.presses if one == "all" else asked.single for one in wanted}
            seed = SEEDS[asked.draws]
            results = read_presses(PRESETS[preset], tilt, counts, asked.calibrations, seed)
            print(f"\n{preset}, {tilt} degrees", *results.told(), sep="\n", flush=True)


if __name__ == "__main__":
    main()
