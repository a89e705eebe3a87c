"""The whole loop on the virtual photoelastic palm: record, calibrate, certify, evaluate, sense.

A ball is pressed at many positions and depths into a clear disc between crossed polarizers, seen edge-on and,
through a mirror, from below. The edge-on view alone does not show the position along the line of sight, and
its certificate must state that.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.evaluation import evaluate
from palpate.core import Frame, ManualClock, PathText, Pose, Progress, new_file, new_folder, silent
from palpate.core.provenance import Provenance
from palpate.estimators.certified import Estimator
from palpate.estimators.model_card import ScoreCard
from palpate.recordings import Manifest, Run, RunWriter
from palpate.recordings.manifest import LabelKind
from palpate.reports.terminal_text import scores_table
from palpate.sensing.frame_sources import run_frames
from palpate.sensing.sensing_loop import sense
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec
from palpate.workflows.certification import certify

TARGETS = ("x_mm", "y_mm", "depth_mm", "force_N")


@dataclass(frozen=True, slots=True)
class DemoRun:
    """Model with its input: its size (height, width) [px], and whether it sees the fringe region alone."""

    model: str
    size_px: tuple[int, int]
    edge_on: bool = False


# a linear and a nonlinear model of both views, and one of the edge-on view alone. Inputs are as small as
# the model can bear: a third of the frame's side and less. More pixels made both worse
WAYS = {
    "pca-ridge": DemoRun("pca-ridge", (60, 107)),
    "pixel-mlp": DemoRun("pixel-mlp", (20, 36)),
    "edge-on": DemoRun("pca-ridge", (35, 118), edge_on=True),
}

STEP_MM = 0.04  # contact-seeking step, so that depths repeat and are rendered once

LABELS: dict[str, LabelKind] = {"location": "text", **dict.fromkeys(TARGETS, "number"), "reference": "flag"}


@dataclass(frozen=True, slots=True)
class DemoProtocol:
    """Positions and depths of the ball's presses, and their variation.

    Attributes:
        reach_mm: greatest distance from the membrane's axis [mm].
        depths_mm: least and greatest depth [mm].
        presses: number of depths at each location.
        seating_mm: standard deviation of a press's depth around the stage's [mm].
        lamp: relative standard deviation of the lamp between locations.
        force_noise_n: standard deviation of the force sensor [N].
    """

    reach_mm: float = 12.0
    depths_mm: tuple[float, float] = (0.4, 5.0)
    presses: int = 7
    seating_mm: float = 0.02
    lamp: float = 0.01
    force_noise_n: float = 0.02
    rate_hz: float = 30.0


@dataclass(frozen=True, slots=True)
class DemoResult:
    """Results of the demo.

    Attributes:
        scores, reports: by model; scores by target on locations that no model has seen.
        sensed: a few readings, as text.
    """

    folder: Path
    scores: dict[str, dict[str, ScoreCard]]
    reports: dict[str, Path]
    sensed: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        return {
            "folder": str(self.folder),
            "scores": {m: {t: s.model_dump() for t, s in by.items()} for m, by in self.scores.items()},
            "reports": {m: str(path) for m, path in self.reports.items()},
        }

    def text(self) -> str:
        """The tables, some readings, and where the pages lie."""
        lines = ["Virtual recording: what follows shows that the loop works, not how good a real sensor is."]
        for name, scores in self.scores.items():
            lines += ["", f"{_said(name)}, on locations it has never seen:", scores_table(scores)]
        lines += ["", "Readings of frames never seen:", *(f"  {line}" for line in self.sensed), ""]
        lines += [f"report ({name}): {path}" for name, path in self.reports.items()]
        return "\n".join(lines)


def run_demo(
    out: PathText, *, locations: tuple[int, int] = (80, 20), seed: int = 0, progress: Progress = silent
) -> DemoResult:
    """Run the whole loop into a new folder, which appears when everything is done.

    Args:
        locations: number of positions to calibrate on, and of new ones to test on.
    """
    out = Path(out)
    with new_folder(out) as folder:
        record_demo(folder / "run", DemoProtocol(), locations[0], seed=seed, progress=progress)
        record_demo(folder / "run-new-places", DemoProtocol(), locations[1], seed=seed + 1, progress=progress)
        scores = {name: _calibrated(folder, name, seed, progress) for name in WAYS}
        sensed = _some_readings(folder)
        result = DemoResult(out, scores, {name: out / f"cal-{name}" / "report.html" for name in WAYS}, sensed)
        with new_file(folder / "summary.json") as path:
            path.write_text(json.dumps(result.to_dict()["scores"], indent=1) + "\n")
    return result


def record_demo(
    path: PathText, protocol: DemoProtocol, locations: int, *, seed: int, progress: Progress = silent
) -> Run:
    """Record presses at random locations as a run."""
    spec = palm.demo()
    manifest = Manifest.new(
        sensor=f"virtual {spec.name}",
        rig="virtual: a ball on an ideal stage",
        licence="CC0-1.0",
        origin="rendered by palpate's demo",
        provenance=Provenance.SIMULATED,
        labels=LABELS,
        seed=seed,
    )
    total = locations * (protocol.presses + 1)
    clock = ManualClock()
    with RunWriter.create(path, manifest, clock=clock, overflow="wait") as writer:
        writer.event("protocol", **asdict(protocol))
        for i, (frame, labels) in enumerate(_presses(spec, protocol, locations, seed)):
            clock.sleep(1 / protocol.rate_hz)
            writer.frame(frame.image, exposure_s=frame.exposure_s, labels=labels)
            writer.force((0.0, 0.0, float(labels["force_N"]), 0.0, 0.0, 0.0))
            writer.stage([1e-3 * float(labels[c]) for c in ("x_mm", "y_mm", "depth_mm")])
            progress("recording", i + 1, total)
    return Run.open(path)


def _presses(
    spec: PalmSpec, protocol: DemoProtocol, locations: int, seed: int
) -> Iterator[tuple[Frame, dict[str, float | str | bool]]]:
    """Frames and their labels: at each location the untouched skin, then presses from shallow to deep."""
    rng = np.random.default_rng(seed)
    for place in range(locations):
        away, angle = protocol.reach_mm * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        x_mm, y_mm = away * np.cos(angle), away * np.sin(angle)
        lit = replace(spec, lamp_gain=1 + protocol.lamp * rng.standard_normal())
        depths = [0.0, *np.sort(rng.uniform(*protocol.depths_mm, protocol.presses))]
        for depth_mm in depths:
            seated_mm = depth_mm + protocol.seating_mm * rng.standard_normal() if depth_mm else 0.0
            reached_m = 1e-3 * STEP_MM * round(seated_mm / STEP_MM)
            contact = palm.press(lit, Pose(1e-3 * x_mm, 1e-3 * y_mm, reached_m))
            force_n = contact.force_n + protocol.force_noise_n * rng.standard_normal()
            numbers = zip(TARGETS, (x_mm, y_mm, depth_mm, force_n), strict=True)
            labels: dict[str, float | str | bool] = {"location": f"place-{place:02d}"}
            labels |= {name: round(value, 4) for name, value in numbers} | {"reference": depth_mm == 0}
            yield palm.render(contact, lit, rng), labels


def _calibrated(folder: Path, name: str, seed: int, progress: Progress) -> dict[str, ScoreCard]:
    way = WAYS[name]
    plan = CalibrationPlan(
        targets=TARGETS,
        model=way.model,
        split="group:location",
        seed=seed,
        size_px=way.size_px,
        channels=3,
        crop_px=palm.demo().fringes.box_px if way.edge_on else None,
    )
    calibration = folder / f"cal-{name}"
    certify(Run.open(folder / "run"), plan, calibration, lambda *a: progress(f"{name}: {a[0]}", *a[1:]))
    results = evaluate(Estimator.open(calibration), Run.open(folder / "run-new-places"), progress=progress)
    with new_file(folder / f"scores-{name}.json") as path:
        path.write_text(json.dumps(results, indent=1) + "\n")
    return {target: ScoreCard(**score) for target, score in results["targets"].items()}


def _said(name: str) -> str:
    return f"{WAYS[name].model} of {'the edge-on view alone' if WAYS[name].edge_on else 'both views'}"


def _some_readings(folder: Path) -> tuple[str, ...]:
    estimator = Estimator.open(folder / f"cal-{next(iter(WAYS))}")
    run = Run.open(folder / "run-new-places")
    lines = []
    for i, sensed in enumerate(sense(estimator, run_frames(run))):
        if i in (4, 14):
            lines += [f"frame {sensed.frame}: {sensed.readings[c]}" for c in ("depth_mm", "force_N")]
    dark = Frame(run.frame(4).image // 8, name="4, made dark")
    reading = estimator.read(dark)["depth_mm"]
    cv2.imwrite(str(folder / "frame-14.png"), run.frame(14).image[..., ::-1])
    return (*lines, f"frame {dark.name}: {reading}")
