"""The loop from touch to finger on virtual devices, many times over.

Every seed is a rig: a virtual TacTip is calibrated on a rigid plate and four references, presses four other
specimens through rendered frames, and each reading is rendered to a finger. Nuisances are drawn from their
standard sizes, once per session or for each specimen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    ReferenceSpecimen,
    ReferenceTrial,
    calibrate_compliance,
)
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_nuisances import ALTER, Nuisances
from palpate.core import InputError, Progress, Reading, silent
from palpate.estimators.compliance.pin_press import PinPress, follow_press
from palpate.mechanics.fingertip_laws import Fingertip
from palpate.sensors.tactip import TacTipSpec
from palpate.softness.touched_flat import Cylinder, TouchedFlat
from palpate.softness.transmission import (
    CUES,
    CueTransmission,
    Transmission,
    modulus_of_chord,
    shared_peak_n,
    transmit,
)
from palpate.workflows.tactip_trials import VirtualPress, record_press, specimens_at

SPECIMENS_N_M = {"S1": 7.6e3, "Snew": 5.3e3, "S2": 3.1e3, "S3": 1.1e3}  # specimens of the compliance report
# none of them is a specimen
REFERENCES_N_M = {"rigid": math.inf, "R1": 9.5e3, "R2": 4.2e3, "R3": 2.0e3, "R4": 0.95e3}
TRIALS = 3  # of a reference
MAX_DAYS = 8  # days


@dataclass(frozen=True, slots=True)
class StudySeed:
    """One rig's four specimens, along the stages.

    Attributes:
        readings: stiffness by both cues, by specimen.
        transmissions: by specimen, the stiffest first.
        refused: number of days with an invalid reading, which were not used.
    """

    seed: int
    readings: Mapping[str, Reading]
    transmissions: Mapping[str, Transmission]
    refused: int

    def in_order(self, stage: str, cue: str) -> bool:
        """Whether the four are in the right order at a stage: `true`, `touched` or `felt`."""
        chords = [getattr(one.cues[cue], stage) for one in self.transmissions.values()]
        return all(stiffer > softer for stiffer, softer in pairwise(chords))

    @property
    def read_in_order(self) -> bool:
        """Whether the readings are in the right order."""
        values = [one.value for one in self.readings.values()]
        return all(stiffer > softer for stiffer, softer in pairwise(values))


def cylinder_of(spec: TacTipSpec) -> Cylinder:
    """Return the virtual specimens' cylinder, whose ends slide between the plates of a slow test."""
    table = spec.table
    return Cylinder(table.specimen_radius_m, table.specimen_height_m, table.poisson_ratio, "free")


def transmission_study(
    finger: Fingertip, seeds: Sequence[int] = range(20), *, one_session: bool = True,
    spec: TacTipSpec | None = None, peak_n: float | None = None, frequency_hz: float = 1.0,
    nuisances: Nuisances | None = None, progress: Progress = silent,
) -> list[StudySeed]:  # fmt: skip
    """Touch and render the four specimens once per seed.

    Args:
        finger: on a rigid flat.
        one_session: draw nuisances once for the four specimens of a seed.
        spec: TacTip; the base tip by default.
        peak_n: force at the end of a finger's press; by default the greatest possible for all [N].
        frequency_hz: see `transmit`.
        nuisances: standard sizes drawn and contained in intervals.
    """
    spec, sizes = spec or TacTipSpec(), nuisances or Nuisances()
    words = specimens_at(spec, REFERENCES_N_M | SPECIMENS_N_M)
    found, total = [], len(seeds) * len(SPECIMENS_N_M)
    for i, seed in enumerate(seeds):
        calibration = _calibrated(spec, words, seed, sizes)
        read: dict[str, Reading] = {}
        refused = 0
        for j, names in enumerate([SPECIMENS_N_M] if one_session else [[one] for one in SPECIMENS_N_M]):
            pressed = {name: words[name] for name in names}
            part = _number(seed, 100 + 100 * j)
            more, again = _read(spec, calibration, pressed, sizes, part, part)
            read, refused = read | more, refused + again
        flats = {name: _flat(spec, one) for name, one in read.items()}
        force = shared_peak_n(finger, list(flats.values())) if peak_n is None else peak_n
        transmissions = {}
        for j, (name, flat) in enumerate(flats.items()):
            progress("specimens felt", i * len(SPECIMENS_N_M) + j, total)
            true_pa = cylinder_of(spec).flat_pa(SPECIMENS_N_M[name])
            transmissions[name] = transmit(
                name,
                flat,
                finger,
                peak_n=force,
                true_flat_pa=true_pa,
                frequency_hz=frequency_hz,
                seed=_number(seed, 600 + 20 * j),
            )
        found.append(StudySeed(seed, read, transmissions, refused))
    return found


def study_record(found: Sequence[StudySeed], finger: Fingertip) -> dict[str, Any]:
    """Summarize all rigs: medians of signed errors by specimen, also as the object's own modulus."""
    names = list(found[0].transmissions)

    def each(name: str) -> list[Transmission]:
        return [one.transmissions[name] for one in found]

    def as_modulus(one: Transmission, cue: str) -> float:
        assert one.true_flat_pa is not None
        return modulus_of_chord(finger, one.cues[cue].felt, one.peak_n, cue) / one.true_flat_pa - 1

    def medians(cue: str, of: Callable[[Transmission], float]) -> dict[str, float]:
        return {name: float(np.median([of(one) for one in each(name)])) for name in names}

    def counted(of: Callable[[CueTransmission], bool | None]) -> dict[str, dict[str, int]]:
        return {
            cue: {name: sum(bool(of(one.cues[cue])) for one in each(name)) for name in names} for cue in CUES
        }

    all_ = [one for name in names for one in each(name)]
    return {
        "rigs": len(found), "days_not_used": sum(seed.refused for seed in found),
        "readings_in_order": sum(seed.read_in_order for seed in found),
        "felt_in_order": {cue: sum(seed.in_order("felt", cue) for seed in found) for cue in CUES},
        "readings_hold": {
            name: sum(
                seed.readings[name].low <= SPECIMENS_N_M[name] <= seed.readings[name].high for seed in found
            )
            for name in names
        },
        "intervals_hold_what_would_be_felt": counted(lambda one: one.held),
        "intervals_hold_the_object_itself": counted(lambda one: one.true_held),
        "median_error": {
            cue: {
                mark: medians(cue, lambda one, cue=cue, mark=mark: one.cues[cue].lost[mark])  # type: ignore[misc]
                for mark in ("touch", "display", "together")
            }
            for cue in CUES
        },
        "median_size_of_error": {
            cue: float(np.median([abs(one.cues[cue].lost["together"]) for one in all_])) for cue in CUES
        },
        "median_size_of_error_as_modulus": {
            cue: float(np.median([abs(as_modulus(one, cue)) for one in all_])) for cue in CUES
        },
        "median_factor": {
            cue: {
                way: medians(cue, lambda one, cue=cue, way=way: getattr(one.cues[cue], way))  # type: ignore[misc]
                for way in ("way_in", "way_out")
            }
            for cue in CUES
        },
        "inside": [min(one.inside for one in all_), max(one.inside for one in all_)],
    }  # fmt: skip


def _number(seed: int, part: int) -> int:
    return 1000 * (seed + 1) + part


def _calibrated(
    spec: TacTipSpec, words: Mapping[str, str], seed: int, sizes: Nuisances
) -> ComplianceCalibration:
    references = []
    for i, (name, kappa) in enumerate(REFERENCES_N_M.items()):
        trials = []
        for k in range(TRIALS):
            made = record_press(spec, words[name], _number(seed, TRIALS * i + k))
            press = _followed(made)
            trials.append(ReferenceTrial(press, made.true_area_m2[made.frame_sample[press.frame]]))
        references.append(ReferenceSpecimen(name, kappa, tuple(trials)))
    return calibrate_compliance(references, nuisances=sizes)


def _followed(made: VirtualPress) -> PinPress:
    return follow_press(list(made.frames()), made.raw_n, made.frame_sample, made.position_m, made.time_s)


def _read(
    spec: TacTipSpec, calibration: ComplianceCalibration, words: Mapping[str, str], sizes: Nuisances,
    day: int, number: int,
) -> tuple[dict[str, Reading], int]:  # fmt: skip
    """Valid readings by both cues under one day's nuisances, and the number of failed days, for which
    nuisances are drawn anew for all.
    """
    for again in range(MAX_DAYS):
        amounts = np.random.default_rng([day, again]).standard_normal(len(fields(sizes)))
        found: dict[str, Reading] = {}
        with suppress(InputError):  # too much force before contact
            for j, (name, one) in enumerate(words.items()):
                press = _followed(record_press(spec, one, number + 10 * again + j))
                for field, amount in zip(fields(sizes), amounts, strict=True):
                    press = ALTER[field.name](press, getattr(sizes, field.name) * float(amount))
                reading = read_touch(calibration, [press]).stiffness_both
                if reading is None or not reading.valid:
                    break
                found[name] = reading
        if len(found) == len(words):
            return found, again
    raise InputError(f"no valid readings of {', '.join(words)} on {MAX_DAYS} days; are nuisances too large?")


def _flat(spec: TacTipSpec, reading: Reading) -> TouchedFlat:
    cylinder = cylinder_of(spec)
    low, middle, high = (cylinder.flat_pa(end) for end in (reading.low, reading.value, reading.high))
    words = f"{reading.quantity} {reading.value / 1e3:.3g} N/mm, calibration {reading.calibration}"
    return TouchedFlat(middle, low, high, reading.coverage, reading.calibration, words)
