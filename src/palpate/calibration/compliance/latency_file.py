"""Latency of a camera from recorded presses, kept in a file and taken off where presses are read.

Force and position are taken earlier by the latency; its uncertainty is the nuisance `late_ms`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.compliance.compliance_calibration import ComplianceCalibration, finite_or_none
from palpate.core import (
    Float,
    InputError,
    PalpateError,
    Progress,
    RangeError,
    Shaped,
    ndarray,
    new_file,
    refuse_existing,
    silent,
    storage_errors,
)
from palpate.core.parsing import parser
from palpate.estimators.compliance.press_latency import (
    COVERAGE,
    MIN_RATIO,
    PressLatency,
    disagreement,
    joined_latency,
    pin_course,
    press_latency,
)
from palpate.estimators.pins import find_pins, follow
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.image_files import TIFF_SUFFIXES
from palpate.recordings.exchange.press_folder import press_folder
from palpate.recordings.exchange.press_table import read_press_table

KIND = "latency of a camera"
COVERED = 2.0  # times the size of `late_ms`, up to which it stands for a latency that one side alone has
ONE_SPEED = (
    "all presses have about one speed, at which creep of the tip looks the same as a delay; make half of "
    f"them {MIN_RATIO:g} times faster, or more"
)
FEW = "one press: whether presses agree is not known; press three times or more"
NOT_CORRECTED = (
    "the calibration's frames were not corrected for a latency, and these are: what both were late by has "
    "cancelled so far; calibrate with --latency as well"
)
NOT_SO = (
    "the calibration's frames were corrected for {:.3g} ms of latency, and these are not: read with --latency"
)


@dataclass(frozen=True)
class CameraLatency:
    """Latency of one camera in one recording's clock.

    Attributes:
        seconds: by which frames show an earlier moment than their samples state [s].
        sd_s: standard uncertainty of one press's latency [s].
    """

    seconds: float
    sd_s: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.seconds) and 0 <= self.sd_s < math.inf):
            raise RangeError(
                f"a latency of {self.seconds} s with {self.sd_s} s; finite, and the second 0 or more"
            )

    @classmethod
    @parser("latency file", InputError)
    def load(cls, path: Path) -> CameraLatency:
        """Read what `measure_latency` wrote."""
        try:
            with storage_errors(path):
                card = json.loads(path.read_text(encoding="utf-8"))
            found = cls(1e-3 * float(card["latency_ms"]), 1e-3 * float(card["standard_uncertainty_ms"]))
            valid, why = bool(card["valid"]), str(card["why"])
        except (KeyError, TypeError, ValueError) as e:
            raise InputError(
                f"{path} is no latency of a camera; `palpate compliance latency PRESS --out FILE` makes them"
            ) from e
        if not valid:
            raise InputError(f"the latency in {path} is not valid: {why}")
        return found


def latency_of_press(
    frames: Iterable[Shaped[ndarray, ...]], table: Path, count: int, *, force_column: str | None = None
) -> PressLatency:
    """Return the latency that one press shows.

    Args:
        frames: all of the press, from before contact until the tip is free again.
        count: number of frames.
    """
    read = read_press_table(table, count, force_column=force_column)
    frames = iter(frames)
    pins = find_pins(next(frames))
    places = np.stack([pins.xy_px, *(now.xy_px for now in follow(frames, pins))])
    motion: Float[ndarray, " f"] = pin_course(places - places[0])
    return press_latency(read.time_s, read.force_n, read.frame_sample, motion)


def measure_latency(
    presses: Sequence[Path],
    out: Path | None = None,
    *,
    force: Path | None = None,
    force_column: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure the latency of a camera from presses of one recording; return plain numbers.

    Args:
        presses: frames of a press each, with tables of the same name; or folders of presses.
        out: JSON to make, for `--latency`; None for none.
        force: table of the only press, where it has another name.
    """
    if out is not None:
        refuse_existing(out)
    pairs = _pairs(presses, force)
    used: dict[str, PressLatency] = {}
    unused: dict[str, str] = {}
    for i, (frames, table) in enumerate(pairs):
        name = str(frames)
        with open_sequence(frames) as sequence:
            try:
                used[name] = latency_of_press(sequence, table, len(sequence), force_column=force_column)
            except PalpateError as e:
                unused[name] = str(e)
        progress("presses", i + 1, len(pairs))
    if not used:
        told = "; ".join(f"{name}: {why}" for name, why in unused.items())
        raise InputError(f"no press tells a latency: {told}")
    record = latency_record(used, unused)
    if out is not None:
        with new_file(out) as building:
            building.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
        record["out"] = str(out)
    return record


def _pairs(presses: Sequence[Path], force: Path | None) -> list[tuple[Path, Path]]:
    if force is not None:
        if len(presses) != 1:
            raise InputError(f"one table for {len(presses)} presses; lay each table beside its frames")
        return [(presses[0], force)]
    pairs: list[tuple[Path, Path]] = []
    for path in presses:
        if path.with_suffix(".csv").exists():
            pairs.append((path, path.with_suffix(".csv")))
        elif path.is_dir() and (
            own := sorted(f for f in path.iterdir() if f.suffix.lower() in TIFF_SUFFIXES)
        ):
            pairs += _pairs(own, None)
        elif path.is_dir():
            pairs += [pair for one in press_folder(path).specimens for pair in one.presses]
        else:
            raise InputError(f"{path} has no table {path.with_suffix('.csv').name} beside it; give --force")
    return pairs


def latency_record(used: dict[str, PressLatency], unused: dict[str, str]) -> dict[str, Any]:
    """Return the latency of all presses and of each, in the units of files."""
    found = joined_latency(list(used.values()))
    why = disagreement(found)
    flags = [FEW] if len(used) == 1 else []
    flags += [ONE_SPEED] if found.speeds == 1 else []
    record: dict[str, Any] = {
        "kind": KIND,
        "latency_ms": 1e3 * found.seconds,
        "low_ms": 1e3 * found.low_s,
        "high_ms": 1e3 * found.high_s,
        "coverage": COVERAGE,
        "standard_uncertainty_ms": 1e3 * math.hypot(found.sd_s, found.between_s),
        "between_presses_ms": 1e3 * found.between_s,
        "agree_p": finite_or_none(found.agree_p),
        "valid": not why,
        "why": why.why,
        "code": why.code,
        "flags": flags,
        "presses": {name: _press(one) for name, one in used.items()},
        "not_used": unused,
    }
    if found.slow_s is not None and found.fast_s is not None:
        record["speeds"] = {
            "slow_ms": 1e3 * found.slow_s[0],
            "fast_ms": 1e3 * found.fast_s[0],
            "same_p": finite_or_none(found.speeds_p),
        }
    return record


def _press(one: PressLatency) -> dict[str, float]:
    names = {"seconds": "latency_ms", "low_s": "low_ms", "high_s": "high_ms", "sd_s": "sd_ms"}
    record = {name: 1e3 * asdict(one)[field] for field, name in names.items()}
    return record | {"told": one.told, "explained": one.explained, "force_rate_N_per_s": one.rate_n_s}


def with_latency(
    calibration: ComplianceCalibration, latency: CameraLatency | None
) -> tuple[ComplianceCalibration, str]:
    """Return a calibration for presses with or without corrected latency, and what does not fit, in words.

    If both were corrected, both uncertainties count as the nuisance `late_ms`. Otherwise the difference is
    reported unless that nuisance covers it.
    """
    before, sizes = calibration.latency_s, calibration.nuisances
    if before is not None and latency is not None:
        wide = replace(sizes, late_s=math.hypot(sizes.late_s, latency.sd_s))
        return replace(calibration, nuisances=wide), ""
    one_sided = abs(before or 0.0) if latency is None else abs(latency.seconds)
    if one_sided <= COVERED * sizes.late_s:
        return calibration, ""
    return calibration, NOT_SO.format(1e3 * one_sided) if latency is None else NOT_CORRECTED
