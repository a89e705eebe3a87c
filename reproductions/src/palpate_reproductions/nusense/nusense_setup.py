"""What the thesis prints of its experiments, the recordings that repeat them, and the study's folder.

Every recording is made by its plan of `palpate.sensors.nusense.nusense_sensor` through the recording engine,
as `palpate record` makes it; the small scale moves faster and waits nearer to the skin. An interrupted study
goes on by the same command at the first shot, reading or result that is missing.

Source: the thesis "NUSense: Shear Based Robust Optical Tactile Sensor", chapter 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from palpate.calibration.shear import LabelledCues, TouchCues, cues_of_run
from palpate.calibration.shear.calibrate_runs import view_of_sensor
from palpate.core import DeviceError, InputError, Progress, Sensor, silent
from palpate.core.sensor import sensor
from palpate.estimators.lattice import ControlPoints
from palpate.recordings import Run
from palpate.rig import State, record
from palpate.rig.plans.plan_files import plan_from
from palpate.rig.virtual.virtual_bench import virtual_rig
from palpate.sensors.nusense.nusense_sensor import PLANS
from palpate_reproductions.study_results import Published, kept_result

SLOPE_N = Published(3.09, "section 4.2, Fig. 4-2g")
OFFSET_N = Published(-1.14, "section 4.2, Fig. 4-2g")
PLACE_MM = Published(0.50, "section 4.3")
PLACE_SPREAD_MM = Published(0.09, "section 4.3")
CYCLES = Published(70, "section 4.5")
TURNED_N = {"lighter": 6.0, "softer": 6.0, "pad-1": 4.5, "pad-2": 4.5, "torn": 4.5}
"""Forces at which a recording turns round in place of its plan's: a pad with half the gel's modulus does not
bear 8 N within its known depth, and 4 N are only read between frames on both sides of it."""


class Recording(NamedTuple):
    """One recording of the study.

    Attributes:
        pad: preset of the virtual NUSense; empty for the pad as designed.
        session: added to the study's seed: another day on the same rig.
    """

    pad: str
    plan: str
    session: int = 0


RECORDINGS: Mapping[str, Recording] = {
    "force": Recording("", "nusense-force"),
    "session": Recording("", "nusense-force", 1),
    "copy-1": Recording("1", "nusense-force", 2),
    "copy-2": Recording("2", "nusense-force", 3),
    "places": Recording("", "nusense-places", 4),
    "hysteresis": Recording("", "nusense-hysteresis", 5),
    "lighter": Recording("", "nusense-hysteresis", 11),
    "softer": Recording("soft", "nusense-hysteresis", 12),
    "cycles": Recording("", "nusense-cycles", 6),
    "edges": Recording("", "nusense-edges", 7),
    "pad-1": Recording("1", "nusense-damage", 8),
    "pad-2": Recording("2", "nusense-damage", 9),
    "torn": Recording("torn", "nusense-damage", 10),
}


@dataclass(frozen=True, slots=True)
class StudyScale:
    """One size of the study.

    Attributes:
        changes: for each recording, fields that take the place of its plan's.
    """

    name: str
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    common: Mapping[str, Any] = field(default_factory=dict)

    def plan_fields(self, name: str) -> dict[str, Any]:
        """Fields of a recording's plan."""
        turned = {"until_N": TURNED_N[name]} if name in TURNED_N else {}
        return {**PLANS[RECORDINGS[name].plan], **turned, **self.common, **self.changes.get(name, {})}


CALIBRATION_MM_S = (
    1.0  # one speed for all pads and days: a skin that remembers is stiffer when pressed faster
)
SMALL = StudyScale(
    "small",
    {
        # force keeps its speed on every pad and day: a skin that remembers is stiffer when pressed faster
        "session": {"cycles": 3},
        "copy-1": {"cycles": 2},
        "copy-2": {"cycles": 2},
        "places": {"speed_mm_s": 2.0},
        "hysteresis": {"cycles": 2},
        "lighter": {"cycles": 2},
        "softer": {"cycles": 2},
        "cycles": {"speed_mm_s": 4.0},
        "edges": {"speed_mm_s": 1.0, "cycles": 2},
        "pad-1": {"speed_mm_s": 1.0, "cycles": 3},
        "pad-2": {"speed_mm_s": 1.0, "cycles": 3},
        "torn": {"speed_mm_s": 1.0, "cycles": 3},
    },
    {"reference_frames": 2, "clearance_mm": 0.4},
)
FULL = StudyScale("full", {"edges": {"cycles": 3}})
SCALES: Mapping[str, StudyScale] = {scale.name: scale for scale in (SMALL, FULL)}
"""`small` is for two cores and minutes, `full` has the plans as they are."""


def scale_named(name: str) -> StudyScale:
    """A scale by name."""
    if name not in SCALES:
        raise InputError(f"there is no scale {name!r}; there are {', '.join(SCALES)}", code="unknown-name")
    return SCALES[name]


@dataclass(frozen=True)
class NuSenseStudy:
    """Folder of the study, in which every recording, reading and result is made once.

    Attributes:
        progress: called with what is being done.
    """

    folder: Path
    scale: StudyScale
    seed: int
    progress: Progress = silent

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        """A result as plain values, made once."""
        return kept_result(self.folder, name, make)

    def pad(self, name: str) -> Sensor:
        """The virtual pad of a recording."""
        preset = RECORDINGS[name].pad
        return sensor(f"nusense-{preset}" if preset else "nusense")

    def run(self, name: str) -> Run:
        """A recording of the study, made where it is missing."""
        path = self.folder / "runs" / name
        self.kept(f"recorded-{name}", lambda: self._recorded(name, path))
        return Run.open(path)

    def _recorded(self, name: str, path: Path) -> dict[str, int]:
        path.parent.mkdir(parents=True, exist_ok=True)
        pad = self.pad(name)
        rig = virtual_rig(pad, seed=100 * self.seed + RECORDINGS[name].session)
        plan = plan_from({**self.scale.plan_fields(name)}, pad)
        try:
            outcome = record(
                rig, plan, path, watch=lambda s: self.progress(f"recording {name}", s.shots, s.planned)
            )
        finally:
            rig.close()
        if outcome.state is not State.DONE:
            raise DeviceError(f"recording {name} ended {outcome.state.value}: {outcome.message}")
        return {"frames": len(Run.open(path))}

    def cues(self, name: str) -> LabelledCues:
        """Cues of all frames of a recording beside their force."""
        self.run(name)
        return labelled_cues(self.kept(f"cues-{name}", lambda: self._cues(name)))

    def marks(self, name: str) -> ControlPoints:
        """Marks of the untouched pad of a recording [px]."""
        found = self.kept(f"cues-{name}", lambda: self._cues(name))["marks"]
        return ControlPoints(np.array(found["cells"]), np.array(found["places"]), np.array(found["sigma"]))

    def _cues(self, name: str) -> dict[str, Any]:
        run, view = self.run(name), view_of_sensor("nusense")
        samples, marks = cues_of_run(
            run.path,
            view.lens,
            view.camera_m,
            view.pitch_px,
            lambda _, *at: self.progress(f"reading {name}", *at),
        )
        return plain_cues(samples, marks)


def plain_cues(samples: LabelledCues, marks: ControlPoints) -> dict[str, Any]:
    """Labelled cues and untouched marks as plain values; what is not a number is None."""
    assert samples.image is not None
    rows = [[None if not math.isfinite(value) else value for value in cue] for cue in samples.cues]
    return {
        "cues": rows,
        "force_N": samples.force_n.tolist(),
        "time_s": samples.time_s.tolist(),
        "press": samples.press.tolist(),
        "indenter": samples.tip.tolist(),
        "image": samples.image.tolist(),
        "marks": {
            "cells": marks.cells.tolist(),
            "places": marks.places.tolist(),
            "sigma": marks.sigma.tolist(),
        },
    }


def labelled_cues(found: Mapping[str, Any]) -> LabelledCues:
    """Labelled cues from plain values."""
    rows: list[list[Any]] = [[math.nan if value is None else value for value in row] for row in found["cues"]]
    return LabelledCues(
        tuple(TouchCues(*row) for row in rows),
        np.array(found["force_N"], float),
        np.array(found["time_s"], float),
        np.array(found["press"]),
        np.array(found["indenter"]),
        np.array(found["image"], float),
    )
