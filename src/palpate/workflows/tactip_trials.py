"""Presses of the virtual TacTip, written as a rig writes its own: an experiment's folder, and runs if wanted.

A specimen is the tables' cylinder, of a stiffness kappa = E pi r^2 / h: slow loading over its whole top.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, RangeError, new_file, new_folder
from palpate.core.units import UNITS
from palpate.estimators.networks.model_interface import Progress, silent
from palpate.mechanics.axisymmetric.tip_table import TipTable
from palpate.recordings.exchange.press_folder import PressFolder, press_folder, write_press, write_specimens
from palpate.recordings.exchange.press_import import import_press
from palpate.recordings.exchange.press_table import press_rows
from palpate.sensors.tactip import HeadOn, TacTipSpec, TipOnSpecimen, Trial, trial
from palpate.sensors.tactip.inclined_press import Inclined, inclined
from palpate.sensors.tactip.tactip_press import modulus_pa
from palpate.version import __version__

REPORT_N_M = {"rigid": math.inf, "S1": 7.6e3, "S2": 3.1e3, "S3": 1.1e3, "new": 5.3e3}
"""The compliance report's specimens (source "R" of `sensors.tactip.spec`) [N/m]."""

UNKNOWN = ("new",)
"""Of these, the one that a calibration shall not be told."""

TRUTH = "virtual.json"
LICENCE = "CC0-1.0"
ORIGIN = "rendered by palpate; virtual, not measured"
MODELS = {HeadOn: "finite strain, without friction", Inclined: "linear bodies, with friction"}

Specimens = Mapping[str, tuple[float, TipOnSpecimen]]


def least_stiffness_n_m(table: TipTable) -> float:
    """Of the softest cylinder in the tables [N/m]."""
    return float(table.specimen_pa[0]) / modulus_pa(table, 1.0)


def specimens_at(
    spec: TacTipSpec,
    stiffness_n_m: Mapping[str, float],
    tilt_rad: float = 0.0,
    *,
    progress: Progress = silent,
) -> dict[str, tuple[float, TipOnSpecimen]]:
    """The tip on specimens: head-on from tables at finite strain, inclined by linear bodies with friction.

    The two models are not the same. At 0 degrees and 5.2 N, on specimens from 1.1 N/mm to rigid, the area by
    linear bodies is 20 to 25 % smaller than by the tables of the tip "base", the approach 5 % smaller to 2 %
    larger. To compare tilts by one model, take a tiny tilt such as 0.001 degrees for the upright one.

    Args:
        spec: the sensor.
        stiffness_n_m: name -> stiffness, inf for a rigid plate [N/m].
        tilt_rad: of the specimens' tops, 0 to 50 degrees [rad].
        progress: told how many are solved; inclined ones take some ten seconds each, the first more.

    Raises:
        RangeError: a stiffness or tilt outside of what is modelled.
    """
    least = least_stiffness_n_m(spec.table)
    for name, stiffness in stiffness_n_m.items():
        if not stiffness >= least * (1 - 1e-9):
            raise RangeError(
                f"specimen {name} of {1e-3 * stiffness:g} N/mm; tip {spec.tip!r} has tables down to "
                f"{1e-3 * least:.3g} N/mm, up to inf for a rigid plate"
            )
    made: dict[str, tuple[float, TipOnSpecimen]] = {}
    for name, stiffness in stiffness_n_m.items():
        made[name] = stiffness, _specimen(spec, modulus_pa(spec.table, stiffness), tilt_rad)
        progress("solving contacts", len(made), len(stiffness_n_m))
    return made


def record_trials(
    out: Path,
    spec: TacTipSpec,
    specimens: Specimens,
    trials: int = 5,
    *,
    seed: int = 0,
    unknown: Collection[str] = (),
    runs: bool = False,
    progress: Progress = silent,
) -> PressFolder:
    """Press every specimen several times and write what a rig would, see `press_folder`; whole or not at all.

    `virtual.json` beside it says that it is virtual, and the truth that the files of a rig do not hold. A
    specimen's trials depend on the seed, its name and their numbers alone: who else is pressed, and at what
    tilt, changes nothing in their seating and noise.

    Args:
        out: folder to make; must not exist.
        spec: the sensor and its rig.
        specimens: name -> stiffness, inf for a rigid plate [N/m], and what is pressed.
        trials: of each.
        seed: of everything random, 0 or more.
        unknown: names whose stiffness `specimens.csv` leaves empty; `virtual.json` has it.
        runs: also write each press as a run, in a folder of the press's name.
        progress: told how many trials are done.

    Raises:
        InputError: no specimens or trials, or a name that cannot be a folder's.
        ExistsError: `out` exists.
        RangeError: a specimen's table ends before the greatest force of a trial.
        StorageError: the disk is full, or refused.
    """
    if not (specimens and trials >= 1 and seed >= 0):
        raise InputError(
            f"{len(specimens)} specimens, {trials} trials, seed {seed}; at least 1, 1 and 0 are needed"
        )
    truths: dict[str, dict[str, Any]] = {name: {} for name in specimens}
    with new_folder(out) as building:
        told = {name: math.nan if name in unknown else k for name, (k, _) in specimens.items()}
        write_specimens(building, told)
        for i, (name, (_, specimen)) in enumerate(specimens.items()):
            for k in range(1, trials + 1):
                made = trial(spec, specimen, _seed(seed, name, k))
                press = f"{k:0{max(2, len(str(trials)))}d}"
                _record(building / name, press, made, runs)
                truths[name][press] = _truth(made)
                progress("pressing", i * trials + k, len(specimens) * trials)
        with new_file(building / TRUTH) as path:
            about = _about(spec, specimens, seed, truths)
            path.write_text(json.dumps(about, indent=1, allow_nan=False) + "\n")
    return press_folder(out)


def tilt_and_model(specimen: TipOnSpecimen) -> tuple[float, str]:
    """Tilt of a specimen's top [rad], and what its contact is solved by."""
    tilt_rad = specimen.contact.tilt_rad if isinstance(specimen, Inclined) else 0.0
    return tilt_rad, MODELS.get(type(specimen), type(specimen).__name__)


def _specimen(spec: TacTipSpec, specimen_pa: float, tilt_rad: float) -> TipOnSpecimen:
    if tilt_rad == 0:
        return HeadOn(spec.table.press(specimen_pa), spec.table.radius_m)
    return inclined(spec, specimen_pa, tilt_rad)


def _seed(seed: int, name: str, number: int) -> int:
    return int(np.random.SeedSequence((seed, zlib.crc32(name.encode()), number)).generate_state(1)[0])


def _record(folder: Path, press: str, made: Trial, runs: bool) -> None:
    rows = press_rows(
        made.time_s, made.raw_n, made.desired_m, made.actual_m, made.frame_sample, made.true_area_m2
    )
    tiff, table = write_press(folder, press, made.frames(), rows)
    if runs:
        import_press(tiff, folder / press, force=table, sensor=made.spec.name, licence=LICENCE, origin=ORIGIN)


def _truth(made: Trial) -> dict[str, Any]:
    """What this trial drew."""
    return {
        "seed": made.seed,
        "touch_s": float(made.time_s[0] - made.true_approach_m[0] / made.spec.speed_m_s),
        "shift_px": list(made.shift_px),
        "lean_deg": np.rad2deg(made.lean_rad).tolist(),
        "light_ratio": made.light,
    }


def _about(
    spec: TacTipSpec, specimens: Specimens, seed: int, truths: Mapping[str, dict[str, Any]]
) -> dict[str, Any]:
    about = {}
    for name, (stiffness, specimen) in specimens.items():
        tilt, model = tilt_and_model(specimen)
        about[name] = {
            "stiffness_N_per_mm": stiffness_shown(stiffness),
            "tilt_deg": math.degrees(tilt),
            "model": model,
            "presses": truths[name],
        }
    return {
        "virtual": True,
        "origin": ORIGIN,
        "licence": LICENCE,
        "software": f"palpate {__version__}",
        "seed": seed,
        "spec": asdict(spec),
        "specimens": about,
    }


def stiffness_shown(stiffness_n_m: float) -> float | str:
    """In N/mm for JSON, which has no infinity."""
    return "inf" if math.isinf(stiffness_n_m) else UNITS["N_per_mm"].from_si(stiffness_n_m)
