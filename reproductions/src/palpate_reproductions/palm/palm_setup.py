"""Size of the study, and its folder, in which every recording, calibration and result is made once.

The size says what is recorded, at which resolution, and how long models learn. An interrupted study continues
by the same command, from the first part that is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.calibration_job import model_regions
from palpate.calibration.calibration_plan import CalibrationPlan, ReferenceRule
from palpate.calibration.certificate import read_predictions
from palpate.calibration.evaluation import predictions
from palpate.core import DeviceError, Indices, InputError, Progress, silent
from palpate.estimators.certified import Estimator, read_card
from palpate.estimators.networks import model_kind
from palpate.recordings import Run
from palpate.reports.certificate_page import write_report
from palpate.rig import State, record
from palpate.rig.plans import Scattered, StepHold
from palpate.rig.virtual.disturbances import Variation
from palpate.rig.virtual.virtual_bench import virtual_rig
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec
from palpate.sensors.palm.palm_sensor import Palm
from palpate.workflows.certification import REPORT_FILE, certify
from palpate_reproductions.palm.palm_published import scores_of
from palpate_reproductions.study_results import kept_result, kept_seconds

PUBLISHED = ("palm-joint-raw", "palm-force-conditioned", "palm-mlp-delta", "palm-two-stage")
"""The source's four networks, in its order."""
NETWORKS = (*PUBLISHED, "palm-compact")
BASELINES = ("palm-moments", "kernel-ridge", "mean")
"""What a network has to beat: moments and trees, a kernel on pixels, and always the mean."""
MODELS = (*NETWORKS, *BASELINES)
SENSING = MODELS[:-1]
"""Those that look at the picture."""
ACCURATE = ("palm-compact", "palm-moments", "kernel-ridge")
"""Those that no network of the source is ahead of, from scratch and on some 700 frames."""
POSE_AND_FORCE = ("depth_mm", "x_mm", "y_mm", "force_N")

WITHIN_MM, PROBE_MM = 20.5, 10.0
"""How far from the middle the places off the grid lie. The grid ends at 21 mm: farther out a reading
is beyond the calibrated range, and marked so."""

STOPPED: Mapping[str, Any] = {"epochs": 100, "patience": 8, "falls": 2, "watched": 0.15}
"""Schedule of a residual network that learns until watched places gain no more."""


@dataclass(frozen=True, slots=True)
class Scale:
    """One size of the study.

    Attributes:
        side_px: of each view, as models see it [px].
        frame_px: of each view, as the camera takes it [px].
        cycles, step_mm, depth_mm, frames: of the protocol at the grid's 37 places; see `StepHold`.
        places: off the grid, pressed once each in a campaign of their own, every `new_step_mm`; for the many
            conditions that are only tested under, every `coarse_step_mm`.
        options: model -> settings with which it learns until watched places gain no more.
        common: settings of every network where all are given the same number of steps.
        control_steps: of `palm-compact`, where it is trained many times over.
        loads: pictures of each kind of contact that is not one upright ball.
        folds: parts that the grid's places are dealt into.
        scored_folds: how many of them are held out in turn.
        studied: models that conditions, contacts and foreign frames are tried on. What a model does that is
            far behind the others tells of that model, not of the frames.
    """

    name: str
    side_px: int
    frame_px: int
    cycles: int
    step_mm: float
    depth_mm: float
    frames: int
    places: int
    new_step_mm: float
    coarse_step_mm: float
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    common: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    steps: int = 600
    control_steps: int = 1500
    loads: int = 60
    folds: int = 5
    scored_folds: int = 1
    studied: tuple[str, ...] = ACCURATE

    def protocol(self) -> StepHold:
        """The palm's, at its 37 places."""
        return StepHold(
            name="palm-protocol",
            cycles=self.cycles,
            step_mm=self.step_mm,
            depth_mm=self.depth_mm,
            frames=self.frames,
            reference_frames=1,
        )

    def new_places(self, seed: int, *, coarse: bool = False) -> StepHold:
        """Places off the grid, in one cycle."""
        return StepHold(
            name="palm-new-places",
            places=Scattered(
                kind="scattered",
                count=self.places,
                apart_mm=2.0,
                seed=seed,
                layer_mm=2 * WITHIN_MM + PROBE_MM,
            ),
            cycles=1,
            step_mm=self.coarse_step_mm if coarse else self.new_step_mm,
            # Taps set the clocks by what the camera sees of them: without a membrane it sees nothing.
            **({"taps": 0} if coarse else {}),
            depth_mm=self.depth_mm,
            frames=1,
            reference_frames=1,
        )


def _stopped(epochs: int, compact: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Settings with which every network learns until watched places gain no more."""
    residual = {**STOPPED, "epochs": epochs}
    return {
        "palm-joint-raw": residual,
        "palm-force-conditioned": residual,
        "palm-two-stage": residual,
        "palm-mlp-delta": {"epochs": 3000, "patience": 150},
        "palm-compact": {"patience": 3, "falls": 2, "watched": 0.15, "cosine": False, **compact},
    }


def _common(compact: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Settings of every network but the number of steps, where that is the same for all."""
    falling = {"patience": 0, "cosine": True}
    return {
        "palm-joint-raw": falling,
        "palm-force-conditioned": falling,
        "palm-two-stage": falling,
        "palm-mlp-delta": {},
        "palm-compact": {**falling, **compact},
    }


SMALL = Scale(
    name="small",
    side_px=96,
    frame_px=96,
    cycles=2,
    step_mm=0.4,
    depth_mm=4.8,
    frames=1,
    places=24,
    new_step_mm=0.4,
    coarse_step_mm=1.2,
    options=_stopped(100, {"epochs": 30, "processes": 2}),
    common=_common({"processes": 2}),
    loads=240,
)
FIVE_FOLDS = replace(SMALL, name="small-five-folds", scored_folds=5)
FULL = Scale(
    name="full",
    side_px=128,
    frame_px=128,
    cycles=5,
    step_mm=0.1,
    depth_mm=5.0,
    frames=5,
    places=60,
    new_step_mm=0.2,
    coarse_step_mm=0.5,
    options=_stopped(100, {"rendered": 60_000, "epochs": 40, "processes": 8}),
    common=_common({"rendered": 60_000, "processes": 8}),
    steps=20_000,
    control_steps=20_000,
    loads=1000,
    scored_folds=5,
    studied=SENSING,
)
SCALES: Mapping[str, Scale] = {scale.name: scale for scale in (SMALL, FIVE_FOLDS, FULL)}
"""`small` is for two cores, `small-five-folds` for a night on them, `full` for a GPU. The source records 25
frames at each depth; they differ by the camera's noise alone, and `full` takes five."""


def scale_of(name: str) -> Scale:
    """A scale by name."""
    if name not in SCALES:
        raise InputError(f"there is no scale {name!r}; there are {', '.join(SCALES)}", code="unknown-name")
    return SCALES[name]


LOCATIONS = "group:location"


@dataclass(frozen=True)
class CalibrationSetup:
    """One setup to calibrate.

    Attributes:
        name: of its calibration in the folder.
        run: which recording it learns from.
        channels, delta: what it sees; None for what the model was made for.
        targets: what it shall estimate; empty for what the model was made for, or depth, place and force.
    """

    name: str
    model: str
    run: str = "protocol"
    split: str = LOCATIONS
    channels: int | None = None
    delta: bool | None = None
    options: dict[str, Any] = field(default_factory=dict)
    targets: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Targets that it estimates."""
        return self.targets or model_kind(self.model).targets or POSE_AND_FORCE


@dataclass(frozen=True)
class StudyFolder:
    """Folder of the study.

    Attributes:
        progress: called with what is being done.
    """

    folder: Path
    scale: Scale
    seed: int
    progress: Progress = silent
    processes: int = 2

    @property
    def spec(self) -> PalmSpec:
        """The palm that is calibrated."""
        return palm.cropped(palm.palm(), self.scale.frame_px, "palm-rig")

    @property
    def setups(self) -> dict[str, CalibrationSetup]:
        """A setup for each model; networks learn until watched places gain no more."""
        options = self.scale.options
        return {name: baseline_setup(name, options=dict(options.get(name, {}))) for name in MODELS}

    @property
    def sensing_setups(self) -> dict[str, CalibrationSetup]:
        """`setups` of those that look at the picture."""
        return {name: self.setups[name] for name in SENSING}

    @property
    def studied_setups(self) -> dict[str, CalibrationSetup]:
        """`setups` of those that conditions and contacts are tried on."""
        return {name: self.setups[name] for name in self.scale.studied}

    @property
    def common_setups(self) -> dict[str, CalibrationSetup]:
        """A setup for each network, all with the same number of steps."""
        return {
            name: CalibrationSetup(
                f"{name}-common", name, options={**self.scale.common.get(name, {}), "steps": self.scale.steps}
            )
            for name in NETWORKS
        }

    def run(self, name: str) -> Run:
        """A recording of the study."""
        return Run.open(self.folder / "runs" / name)

    def recorded(
        self,
        name: str,
        plan: StepHold,
        spec: PalmSpec | None = None,
        variation: Variation | None = None,
        seed: int | None = None,
    ) -> Run:
        """A run of the virtual rig; another seed is another campaign."""
        path = self.folder / "runs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        seed = self.seed if seed is None else seed
        rig = virtual_rig(Palm(spec or self.spec), variation=variation, seed=seed)
        try:
            outcome = record(
                rig, plan, path, watch=lambda s: self.progress(f"recording {name}", s.shots, s.planned)
            )
        finally:
            rig.close()
        if outcome.state is not State.DONE:
            raise DeviceError(f"recording {name} ended {outcome.state.value}: {outcome.message}")
        return Run.open(path)

    def calibrated(self, setup: CalibrationSetup) -> Path:
        """A calibration's folder."""
        out = self.folder / "calibrations" / setup.name
        if out.exists():
            if not (out / REPORT_FILE).exists():  # stopped between the two
                write_report(out, out / REPORT_FILE)
            return out
        out.parent.mkdir(parents=True, exist_ok=True)
        run, kind = self.run(setup.run), model_kind(setup.model)
        first, beside = model_regions(run.manifest, ("fringes", "mirror"))
        plan = CalibrationPlan(
            targets=setup.columns,
            model=setup.model,
            split=setup.split,
            folds=self.scale.folds,
            scored_folds=self.scale.scored_folds,
            fold_by=POSE_AND_FORCE if set(POSE_AND_FORCE) <= set(run.labels.columns) else (),
            seed=self.seed,
            size_px=(self.scale.side_px, 2 * self.scale.side_px),
            channels=setup.channels or kind.channels or 1,  # type: ignore[arg-type]
            crop_px=first,
            beside_px=beside,
            delta=bool(kind.delta) if setup.delta is None else setup.delta,
            reference=ReferenceRule("reference", "true", ("press",)),
            options=dict(setup.options),
        )
        certify(run, plan, out, lambda what, *at: self.progress(f"{setup.name}: {what}", *at))
        return out

    def held_out(self, setup: CalibrationSetup) -> pd.DataFrame:
        """Predictions of a calibration on the rows that it had not learnt from."""
        folder = self.calibrated(setup)
        return read_predictions(folder, read_card(folder))

    def estimated(self, calibration: Path, run: Run, what: str) -> pd.DataFrame:
        """Predictions of the calibration in a folder on a run."""
        estimator, name = Estimator.open(calibration), calibration.name
        return predictions(estimator, run, progress=lambda _, *at: self.progress(f"{name} on {what}", *at))

    def scored(self, calibration: Path, run: Run, what: str) -> dict[str, Any]:
        """Scores of the calibration in a folder on a run, and the share of frames that it stands by."""
        table = self.estimated(calibration, run, what)
        columns = read_card(calibration).columns
        return {"targets": scores_of(table, columns), "valid": float(table["valid"].mean())}

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        """A result as plain values, made once; beside it the time that took."""
        return kept_result(self.folder, name, make)

    def kept_part(self, stage: str, names: Sequence[str], make: Callable[[], Any]) -> Any:
        """A part of a stage's result, kept as it ends, so that a stage that was stopped goes on after it."""
        tag = "-".join(name.replace(" ", "-") for name in names)
        return kept_result(self.folder, f"parts/{stage}-{tag}", make)

    def seconds(self) -> dict[str, float]:
        """Time that each result took [s]; of a stage that was stopped, since it went on."""
        return kept_seconds(self.folder)


def baseline_setup(model: str, name: str = "", **changes: Any) -> CalibrationSetup:
    """A model as the study asks for it: what was made for any sensor sees grey differences."""
    general = {} if model_kind(model).regions else {"channels": 1, "delta": True}
    return CalibrationSetup(**{"name": name or model, "model": model, **general, **changes})


def pressed_rows(run: Run) -> Indices:
    """Rows of a run that show a press, not the untouched skin."""
    return np.flatnonzero(~run.labels["reference"].astype(bool).to_numpy())


def noisier(spec: PalmSpec, times: float) -> tuple[PalmSpec, Variation]:
    """The rig with its noise so many times as large: camera, seating, place, leaning, lamp, backlash.

    Not the load cell's: by it the rig chooses the force at which it says contact, and depth is counted from
    there; and beside the models' errors it is nothing.
    """
    v = Variation()
    camera = replace(
        spec.camera,
        full_well_e=spec.camera.full_well_e / times**2,
        read_noise_e=spec.camera.read_noise_e / times,
    )
    varied = replace(
        v,
        seating_m=v.seating_m * times,
        place_m=v.place_m * times,
        lean_spread=(v.lean_spread[0] * times, v.lean_spread[1] * times),
        lamp=v.lamp * times,
        backlash_m=v.backlash_m * times,
    )
    return replace(spec, camera=camera), varied
