"""Force calibration from runs to a file, that of another pad from one known weight, and baselines of normal
force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.shear.force_law import held_out
from palpate.calibration.shear.shear_calibration import (
    COVERAGE,
    ShearCalibration,
    calibrate_shear,
    calibration_record,
    usable,
)
from palpate.calibration.shear.touch_cues import LabelledCues, cues_of_run, joined, mean_marks
from palpate.core import (
    Bool,
    Float,
    ImageError,
    InputError,
    Lens,
    Progress,
    Shaped,
    ndarray,
    refuse_existing,
    silent,
)
from palpate.core.sensor import sensor as design_of
from palpate.estimators.lattice import MarkTracker
from palpate.recordings import Run

Rows = Float[ndarray, "n k"]
Series = Float[ndarray, " n"]
Fit = Callable[[Rows, Series], Callable[[Rows], Series]]

STRENGTHS = np.logspace(-4, 2, 13)
KERNEL_STRENGTH, KERNEL_WIDTH = 1e-2, 0.5  # of standardised inputs


def baseline_errors(samples: LabelledCues, used: Bool[ndarray, " n"]) -> dict[str, float]:
    """Return the mean absolute error of each baseline on presses it was not fitted to [N].

    Baselines: mean force; line in the mean shift (the published law); kernel ridge on gamma and the ring's
    area; with frames also regressions on pixel change and its moments.
    """
    return {name: _error(*one, samples, used) for name, one in _inputs(samples).items()}


def transferred_errors(
    learnt: LabelledCues, used: Bool[ndarray, " n"], read: LabelledCues, scored: Bool[ndarray, " m"]
) -> dict[str, float]:
    """Return the mean absolute error of each baseline of one run on another [N].

    Args:
        learnt, used: frames, and those to fit to.
        read, scored: frames of the other run, and those to score on.
    """
    fits, inputs = _inputs(learnt), _inputs(read)
    truth, errors = read.force_n[scored], {}
    for name in [one for one in fits if one in inputs]:
        rows, fit = fits[name]
        model = fit(_finite(rows)[used], learnt.force_n[used])
        errors[name] = float(np.abs(model(_finite(inputs[name][0])[scored]) - truth).mean())
    return errors


def _inputs(samples: LabelledCues) -> dict[str, tuple[Rows, Fit]]:
    gamma = np.array([c.gamma for c in samples.cues])
    area = np.array([c.radius_m**2 for c in samples.cues])
    inputs: dict[str, tuple[Rows, Fit]] = {
        "mean": (np.zeros((len(gamma), 1)), _line),
        "mean shift": (gamma[:, None], _line),
        "kernel ridge on gamma and area": (np.column_stack([gamma, 1e6 * area]), _kernel_ridge),
    }
    if samples.image is not None:
        inputs["sum of pixel change"] = (samples.image[:, :1], _line)
        inputs["ridge on image moments"] = (samples.image, _ridge)
        inputs["kernel ridge on image moments"] = (samples.image, _kernel_ridge)
    return inputs


def _finite(rows: Rows) -> Rows:
    return np.where(np.isfinite(rows), rows, 0.0)


def _error(rows: Rows, fit: Fit, samples: LabelledCues, used: Bool[ndarray, " n"]) -> float:
    rows = _finite(rows)

    def fitted(kept: Bool[ndarray, " n"]) -> Series:
        learnt = used & kept
        return fit(rows[learnt], samples.force_n[learnt])(rows)

    estimate = held_out(fitted, samples.press)
    return float(np.abs(estimate - samples.force_n)[used].mean())


def _line(rows: Rows, force_n: Series) -> Callable[[Rows], Series]:
    terms = np.column_stack([rows, np.ones(len(rows))])
    weights = np.linalg.lstsq(terms, force_n, rcond=None)[0]
    return lambda now: np.asarray(now @ weights[:-1] + weights[-1])


def _ridge(rows: Rows, force_n: Series) -> Callable[[Rows], Series]:
    from sklearn.linear_model import RidgeCV
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    model = make_pipeline(StandardScaler(), PolynomialFeatures(2, include_bias=False), RidgeCV(STRENGTHS))
    model.fit(rows, force_n)
    return lambda now: np.asarray(model.predict(now))


def _kernel_ridge(rows: Rows, force_n: Series) -> Callable[[Rows], Series]:
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    kernel = KernelRidge(alpha=KERNEL_STRENGTH, kernel="rbf", gamma=KERNEL_WIDTH)
    model, mean = make_pipeline(StandardScaler(), kernel), float(force_n.mean())
    model.fit(rows, force_n - mean)
    return lambda now: np.asarray(mean + model.predict(now))


VIRTUAL = "virtual "  # before the sensor's name in a run of the virtual rig


@dataclass(frozen=True)
class PatternView:
    """Camera view of a pattern.

    Attributes:
        camera_m: distance of the camera from the pattern [m].
        pitch_px: side of a tile in the image's middle [px].
    """

    lens: Lens
    camera_m: float
    pitch_px: float


def view_of_sensor(name: str) -> PatternView:
    """Return the view of a sensor's pattern by its spec."""
    spec = getattr(design_of(name), "spec", None)
    lens, pattern = getattr(spec, "lens", None), getattr(spec, "pattern", None)
    camera_m = getattr(spec, "camera_m", None)
    pitch_m = getattr(pattern, "cast_pitch_m", None)
    if not isinstance(lens, Lens) or camera_m is None or pitch_m is None:
        raise InputError(f"sensor {name!r} has no lens and no pattern; force is read from a patterned skin")
    return PatternView(lens, camera_m, lens.focal_px[0] * pitch_m / camera_m)


def calibrate_runs(
    runs: Sequence[Path],
    out: Path,
    *,
    sensor: str = "",
    law: str = "any-tip",
    hysteresis: bool = False,
    coverage: float = COVERAGE,
    note: str = "",
    progress: Progress = silent,
) -> dict[str, Any]:
    """Calibrate on runs of one pad; return the fit and baselines in plain numbers.

    Args:
        runs: one or more; the reference is that of the first.
        out: ``.npz`` to make.
        sensor: name; empty takes that of the first run.
    """
    _refuse_name(out)
    if not runs:
        raise InputError("no run; give one or more")
    view = view_of_sensor(sensor or Run.open(runs[0]).manifest.sensor.removeprefix(VIRTUAL))
    read = [cues_of_run(run, view.lens, view.camera_m, view.pitch_px, progress) for run in runs]
    samples = joined([cues for cues, _ in read])
    calibration = calibrate_shear(
        samples, read[0][1], view.lens, view.camera_m,
        law=law, hysteresis=hysteresis, coverage=coverage, note=note,
    )  # fmt: skip
    baselines = baseline_errors(samples, usable(samples))
    calibration.save(out)
    return calibration_record(calibration) | {"baselines_mae_N": baselines, "out": str(out)}


def weigh_copy(
    calibration: Path,
    out: Path,
    *,
    untouched: Sequence[Shaped[ndarray, ...]],
    loaded: Sequence[Shaped[ndarray, ...]],
    weight_n: float,
    weight_error_n: float = 0.0,
    lays: int = 1,
    pitch_px: float | None = None,
) -> dict[str, Any]:
    """Calibrate another pad of the same make, on which a known weight was laid.

    Args:
        calibration: of the first pad.
        out: ``.npz`` to make.
        untouched, loaded: 8-bit frames at rest, and with the weight.
        pitch_px: approximate side of a tile [px]; None takes that of the first pad.

    Raises:
        PalpateError: frames without pattern or weight, a weight outside the range; `out` exists.
    """
    _refuse_name(out)
    if not untouched or not loaded:
        raise InputError("give one frame or more of the pad at rest, and with the weight on it")
    pad = ShearCalibration.load(calibration)
    tracker = MarkTracker(untouched[0], pitch_px or pad.pitch_px)
    reference = mean_marks([tracker.follow(frame).points for frame in untouched])
    meter = pad.meter(reference)
    count = len(reference)
    marks = [tracker.settled(tracker.follow(frame), frame, count).points for frame in loaded]
    if not all(map(len, marks)):
        raise ImageError("a frame with the weight shows no pattern; look at light, focus and the crop")
    copy = pad.weighed([meter.cues(points) for points in marks], weight_n, weight_error_n, lays)
    copy = copy.referred_to(reference)
    copy.save(out)
    return calibration_record(copy) | {"of": pad.id, "out": str(out), "frames": len(loaded)}


def _refuse_name(out: Path) -> None:
    if out.suffix != ".npz":
        raise InputError(f"{out} is not an .npz file; name the calibration e.g. pad.npz")
    refuse_existing(out)
