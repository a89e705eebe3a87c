"""Find what a valid reading of softness does not show: altered presses, coverage and other levers.

    python tools/softness_limits.py                     # all, some ten minutes of one core
    python tools/softness_limits.py --only faults       # one part
    python tools/softness_limits.py --seeds 5           # fewer calibrations

Every seed is one calibration, by the presses that `palpate render tactip --seed N` writes; it reads other
presses of the virtual TacTip. Numbers are medians over seeds; they stand in docs/how-to/measure-softness.md,
docs/explanations/tactip.md, docs/decisions/0012 and README.md.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    calibrate_compliance,
    load_references,
    rate_by_areas,
)
from palpate.calibration.compliance.compliance_reading import PressReading, read_touch
from palpate.calibration.compliance.press_nuisances import NONE, Nuisances
from palpate.core import InputError, Reading
from palpate.estimators.compliance.pin_press import PinPress, follow_press
from palpate.sensors.tactip import TacTipSpec, fitted_tactip
from palpate.sensors.tactip.tactip_press import modulus_pa
from palpate.workflows.tactip_trials import (
    REPORT_N_M,
    UNKNOWN,
    VirtualPress,
    record_press,
    record_trials,
    specimens_at,
    stiffness_of,
)

SEEDS = 20
TRIALS = 3  # of every specimen and calibration under drawn nuisances
REFERENCES = {name: kappa for name, kappa in REPORT_N_M.items() if name not in UNKNOWN}
BETWEEN = ("A=2", "new=5.3", "B=6.5")  # N/mm
AT_REFERENCES = ("S1=7.6", "S2=3.1", "S3=1.1")
LONGER_M = 0.66e-3  # lever that the same real taps ask for where tilted ones weigh more
FRAME_YIELD_N_M = 50e3
ASIDE_M = 0.5e-3  # at most 0.7 mm is modelled: there the face leans by 2 degrees
BIAS_N, GAIN = 0.05, 1.2
BUMP_N, BUMP_S = 1.0, 0.1  # height, standard deviation
FIRST_SEED = 10_000_000  # of presses that no calibration has seen


@dataclass(frozen=True)
class ReadPress:
    """A press and what a calibration reads of it."""

    made: VirtualPress
    press: PinPress
    reading: PressReading

    @property
    def true_area_m2(self) -> np.ndarray:
        """Area of the contact at every frame of the press [m^2]."""
        return self.made.true_area_m2[self.made.frame_sample[self.press.frame]]

    @property
    def true_rate_m2_n(self) -> float:
        """dA/dF of that area, by the line through it at 1, 1.5 to 4.5 N [m^2/N]."""
        return rate_by_areas(self.press.force_n, self.true_area_m2)

    @property
    def true_area_at_4_n_m2(self) -> float:
        """Area of the contact at 4 N [m^2]."""
        return float(self.made.sensor.on(self.made.words).area_m2(np.array([4.0]))[0])


@cache
def calibration(spec: TacTipSpec, seed: int) -> ComplianceCalibration:
    """The calibration of a virtual experiment, by its files."""
    with tempfile.TemporaryDirectory() as folder:
        words = specimens_at(spec, REFERENCES)
        experiment = record_trials(Path(folder) / "experiment", spec, words, seed=seed)
        return calibrate_compliance(load_references(experiment))


def followed(made: VirtualPress, **altered: Any) -> PinPress:
    """Pins of a press, with frames, force or position altered."""
    given = {"frames": list(made.frames()), "raw_n": made.raw_n, "position_m": made.position_m} | altered
    return follow_press(given["frames"], given["raw_n"], made.frame_sample, given["position_m"], made.time_s)


def aside(made: VirtualPress) -> PinPress:
    """The press with its first touch beside the apex."""
    touches = tuple(replace(touch, x_m=ASIDE_M) for touch in made.touches)
    return followed(replace(made, touches=touches))


def frozen(made: VirtualPress) -> PinPress:
    """The press by a camera that repeats its frame from halfway between first touch and the end."""
    frames = list(made.frames())
    touch = int(np.argmax(made.true_approach_m[made.frame_sample] > 0))
    half = (touch + len(frames)) // 2
    return followed(made, frames=frames[:half] + [frames[half]] * (len(frames) - half))


def late(made: VirtualPress) -> PinPress:
    """The press by a camera whose frames are one frame late."""
    frames = list(made.frames())
    return followed(made, frames=[frames[0], *frames[:-1]])


def bumped(made: VirtualPress) -> PinPress:
    """The press with a bump in its force at half its greatest."""
    middle_s = made.time_s[int(np.argmax(made.true_force_n > made.true_force_n[-1] / 2))]
    bump = BUMP_N * np.exp(-0.5 * ((made.time_s - middle_s) / BUMP_S) ** 2)
    return followed(made, raw_n=made.raw_n + bump)


FAULTS: Mapping[str, Callable[[VirtualPress], PinPress]] = {
    "none": followed,
    "0.5 mm off centre": aside,
    "force bias of 0.05 N": lambda made: followed(made, raw_n=made.raw_n + BIAS_N),
    "frame that yields by 50 N/mm": lambda made: followed(
        made, position_m=made.position_m + made.true_force_n / FRAME_YIELD_N_M
    ),
    "force 2 % too large": lambda made: followed(made, raw_n=1.02 * made.raw_n),
    "force 1.2 times too large": lambda made: followed(made, raw_n=GAIN * made.raw_n),
    "bump in the force": bumped,
    "camera frozen halfway": frozen,
    "frames 50 ms late": late,
}


def other_sensors() -> dict[str, TacTipSpec]:
    """Sensors and speeds other than the calibrated one."""
    spec = TacTipSpec()
    longer = replace(spec.pins, length_m=1.02 * spec.pins.length_m)
    return {
        "levers 2 % longer": replace(spec, pins=longer),
        "2.5 mm/s": replace(spec, speed_m_s=2.5e-3),
        "10 mm/s": replace(spec, speed_m_s=10e-3),
        "tip of a softer skin": replace(spec, tip="soft-skin"),
        "tip of a stiffer skin": replace(spec, tip="stiff-skin"),
    }


def read_all(
    spec: TacTipSpec, words: Sequence[str], seeds: int, alter: Callable[[VirtualPress], PinPress] = followed
) -> dict[str, list[ReadPress]]:
    """Presses of every specimen, one a seed, read on the very bench of the calibration: without nuisances."""
    results: dict[str, list[ReadPress]] = {one: [] for one in words}
    for seed in range(seeds):
        calibrated = replace(calibration(spec, seed), nuisances=NONE)
        for i, one in enumerate(words):
            made = record_press(spec, one, FIRST_SEED + 100 * seed + i)
            press = alter(made)
            results[one].append(ReadPress(made, press, read_touch(calibrated, [press])))
    return results


def faults(seeds: int) -> Iterator[str]:
    """Readings of altered presses on the specimen of 5.3 N/mm, by calibrations of unaltered ones.

    Intervals contain nuisances of their standard sizes.
    """
    spec, words = TacTipSpec(), "new=5.3"
    results: dict[str, list[ReadPress]] = {name: [] for name in (*FAULTS, *other_sensors())}
    for seed in range(seeds):
        calibrated, start = calibration(spec, seed), FIRST_SEED + 100 * seed
        presses = {name: (record_press(spec, words, start), fault) for name, fault in FAULTS.items()}
        others = other_sensors().items()
        presses |= {name: (record_press(other, words, start), followed) for name, other in others}
        for name, (made, alter) in presses.items():
            with suppress(InputError):  # refused: too much force before contact
                press = alter(made)
                results[name].append(ReadPress(made, press, read_touch(calibrated, [press])))
    yield f"of {seeds} presses, in how many valid, and of these with the truth outside the interval"
    for name, some in results.items():
        readings = [one.reading for one in some]
        area = np.median(
            [r.area.value / one.true_area_at_4_n_m2 for r, one in zip(readings, some, strict=True)]
        )
        rate = np.median(
            [r.spread_rate.value / one.true_rate_m2_n for r, one in zip(readings, some, strict=True)]
        )
        yield (
            f"{name}: touch {summary([r.stiffness for r in readings], 1e-3)}; "
            f"both cues {summary([r.stiffness_both for r in readings], 1e-3)}; "
            f"area {area:.3f}, valid {valid(r.area for r in readings)}; "
            f"spread rate {rate:.3f}, valid {valid(r.spread_rate for r in readings)}; "
            f"E* {summary([r.modulus for r in readings], 1e-6)}; "
            f"valid with the truth outside: {missed(some, spec)}"
        )


def summary(readings: Sequence[Reading], scale: float) -> str:
    """Medians of values and intervals, and how many are valid."""
    value, low, high = (
        scale * np.median([getattr(r, end) for r in readings]) for end in ("value", "low", "high")
    )
    return f"{value:.3g} ({low:.3g} to {high:.3g}), valid {valid(readings)}"


def valid(readings: Any) -> str:
    """How many are valid, of how many."""
    some = [one.valid for one in readings]
    return f"{sum(some)} of {len(some)}"


def coverage(seeds: int) -> Iterator[str]:
    """How often intervals of single presses contain the truth, and errors."""
    spec = TacTipSpec()
    for name, words in (("between references", BETWEEN), ("at references", AT_REFERENCES)):
        results = read_all(spec, words, seeds)
        for one, some in results.items():
            yield f"{name}, {one}: {covered(some, spec)}"
        yield f"{name}, all: {covered([read for some in results.values() for read in some], spec)}"


def truths_of(spec: TacTipSpec) -> Mapping[str, Callable[[ReadPress], float]]:
    """True value of every quantity of a press."""
    return {
        "stiffness": lambda one: stiffness_of(one.made.words),
        "stiffness_both": lambda one: stiffness_of(one.made.words),
        "area": lambda one: one.true_area_at_4_n_m2,
        "spread_rate": lambda one: one.true_rate_m2_n,
        "modulus": lambda one: (
            modulus_pa(spec.table, stiffness_of(one.made.words)) / (1 - spec.table.poisson_ratio**2)
        ),
    }


def missed(some: Sequence[ReadPress], spec: TacTipSpec) -> str:
    """How many readings of each quantity are valid although the truth is outside their interval."""
    told = []
    for name, truth_of in truths_of(spec).items():
        read = [(getattr(one.reading, name), truth_of(one)) for one in some]
        told.append(f"{name} {sum(r.valid and not r.low <= truth <= r.high for r, truth in read)}")
    return ", ".join(told)


def covered(some: Sequence[ReadPress], spec: TacTipSpec) -> str:
    """Coverage and median errors of the readings."""
    parts = []
    for name, truth_of in truths_of(spec).items():
        readings = [getattr(one.reading, name) for one in some]
        truths = [truth_of(one) for one in some]
        held = np.mean([r.low <= t <= r.high for r, t in zip(readings, truths, strict=True)])
        errors = np.array([r.value / t - 1 for r, t in zip(readings, truths, strict=True)])
        parts.append(
            f"{name} covered {100 * held:.0f} %, error {100 * np.median(errors):+.1f} % (absolute median "
            f"{100 * np.median(np.abs(errors)):.1f} %)"
        )
    return "; ".join(parts)


def budget(seeds: int) -> Iterator[str]:
    """How often intervals that contain nuisances hold the truth, of presses that have drawn ones."""
    spec = TacTipSpec()
    words, sizes = (*BETWEEN, "S2=3.1", "C=1.5"), Nuisances()
    results: dict[str, list[ReadPress]] = {one: [] for one in words}
    refused = 0
    for seed in range(seeds):
        for i, one in enumerate(words):
            for k in range(TRIALS):
                number = FIRST_SEED + 100 * seed + 10 * i + k
                try:
                    made, press = drawn(spec, one, sizes, number)
                    results[one].append(ReadPress(made, press, read_touch(calibration(spec, seed), [press])))
                except InputError:  # too much force before contact
                    refused += 1
    together = [read for some in results.values() for read in some]
    yield f"{refused} of {refused + len(together)} presses refused"
    for name, some in {**results, "all": together}.items():
        sound = [one for one in some if one.reading.stiffness.valid]
        yield f"{name}, {len(sound)} of {len(some)} valid: {covered(sound, spec)}"
        yield f"{name}, valid with the truth outside: {missed(some, spec)}"


def drawn(spec: TacTipSpec, words: str, sizes: Nuisances, number: int) -> tuple[VirtualPress, PinPress]:
    """A press with every nuisance drawn from the normal law of its standard size."""
    lever, gain, bias, frame, late = np.random.default_rng([number, 9]).standard_normal(5)
    length_m = spec.pins.length_m * (1 + sizes.lever * lever)
    made = record_press(replace(spec, pins=replace(spec.pins, length_m=length_m)), words, number)
    ago = round(sizes.late_s * late / float(np.median(np.diff(made.time_s))))
    shown = np.clip(made.frame_sample - ago, 0, len(made.time_s) - 1)
    return made, followed(
        made,
        frames=list(replace(made, frame_sample=shown).frames()),
        raw_n=made.raw_n * (1 + sizes.force_gain * gain) + sizes.force_bias_n * bias,
        position_m=made.position_m + sizes.frame_yield_m_n * frame * made.true_force_n,
    )


def levers(seeds: int) -> Iterator[str]:
    """A lever and a camera as fitted to a real tip, and longer levers, in calibration and presses alike."""
    fitted = fitted_tactip()
    for length_m in (fitted.pins.length_m, LONGER_M):
        spec = replace(fitted, pins=replace(fitted.pins, length_m=length_m))
        name = f"331 levers of {1e3 * length_m:g} mm, camera at {1e3 * spec.camera.height_m:g} mm"
        for one, some in read_all(spec, (*BETWEEN, *AT_REFERENCES), seeds).items():
            yield f"{name}, {one}: {covered(some, spec)}"


PARTS = {"faults": faults, "coverage": coverage, "budget": budget, "levers": levers}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=list(PARTS), action="append")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    asked = parser.parse_args()
    for name in asked.only or PARTS:
        print(f"\n{name}", *PARTS[name](asked.seeds), sep="\n", flush=True)


if __name__ == "__main__":
    main()
