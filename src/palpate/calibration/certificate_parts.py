"""What every certificate is made of: pictures, scores, references, files and the software's versions."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np
import onnxruntime

from palpate.calibration.evaluate import score
from palpate.calibration.made import Calibrated
from palpate.core.errors import CertificateError
from palpate.core.files import sha256_of
from palpate.core.shapes import Indices, Values
from palpate.core.units import split_column
from palpate.estimators.certified import Intervals
from palpate.estimators.model_card import FileCard, ReferenceCard, RunCard, TargetCard
from palpate.version import __version__

AGREEMENT = 1e-4
"""Largest allowed difference between the exported and the trained model, as a share of a target's range."""

WORST = 6


def worst_rows(made: Calibrated) -> Indices:
    """Rows whose error, in units of each target's range, is the largest."""
    span, scored = np.ptp(made.data.values, axis=0), made.scored
    error = np.max(np.abs(made.held_out[scored] - made.data.values[scored]) / span, axis=1)
    return scored[np.argsort(error)[::-1][:WORST]]


def pictures(made: Calibrated) -> Iterator[tuple[str, np.ndarray]]:
    """File names and pictures, RGB or grey, that the report shows."""
    chosen = [(f"worst-{row}.png", int(row)) for row in worst_rows(made)]
    chosen += [("example.png", len(made.packed) // 2)]
    for name, row in chosen:
        yield name, _picture(made.packed.read(np.array([row]))[0])
    if len(made.untouched.rows):
        mean = made.untouched.images[0].transpose(1, 2, 0)
        yield "reference.png", _picture(mean.round().astype(np.uint8))


def _picture(prepared: np.ndarray) -> np.ndarray:
    return prepared if prepared.shape[2] == 3 else prepared[..., 0]


def agreement(made: Calibrated, model: Path) -> float:
    """Largest difference between exported and trained model, as a share of each target's range."""
    rows = np.linspace(0, len(made.packed) - 1, min(64, len(made.packed))).astype(np.int64)
    inputs = made.data.fetch(rows)
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    (exported,) = session.run(["value"], {"image": inputs})
    difference = np.abs(exported - made.fitted.predict(inputs)) / np.ptp(made.data.values, axis=0)
    worst = float(difference.max())
    if not worst <= AGREEMENT:
        raise CertificateError(
            f"the exported model differs from the trained one by {worst:.1e} of the range, more than "
            f"{AGREEMENT:.0e}; nothing was written"
        )
    return worst


def target_cards(made: Calibrated, intervals: Intervals, halves: Values) -> Iterator[TargetCard]:
    """Ranges, intervals and scores."""
    mean_of_others = np.empty_like(made.data.values)
    for k, rows in enumerate(made.split.folds):
        mean_of_others[rows] = made.data.values[made.split.training_rows(k)].mean(axis=0)
    scored = made.scored
    for j, column in enumerate(made.plan.targets):
        quantity, unit = split_column(column)
        true = made.data.values[:, j]
        yield TargetCard(
            column=column,
            quantity=quantity,
            unit=unit.symbol,
            least=float(true.min()),
            greatest=float(true.max()),
            training_mean=float(true.mean()),
            centre=float(intervals.spread.centre[j]),
            scale=float(intervals.spread.scale[j]),
            typical=float(intervals.spread.typical[j]),
            coefficients=tuple(float(c) for c in intervals.spread.coefficients[j]),
            quantile=float(intervals.quantile[j]),
            score=score(
                unit.symbol,
                true[scored],
                made.held_out[scored, j],
                halves[:, j],
                mean_of_others[scored, j],
                made.data.groups[scored],
            ),
        )


def reference_card(made: Calibrated) -> ReferenceCard:
    """How the untouched sensor was found."""
    rule = made.untouched.rule
    return ReferenceCard(
        column=rule.column if rule else None,
        value=rule.value if rule else None,
        by=rule.by if rule else (),
        frames=len(made.untouched.rows),
        learnt=made.plan.learn_untouched,
    )


def run_card(made: Calibrated) -> RunCard:
    """What was learnt from."""
    manifest = made.run.manifest
    return RunCard(
        run_id=manifest.run_id,
        hash=made.run.hash,
        frames=len(made.run),
        origin=manifest.origin,
        licence=manifest.licence,
    )


def file_card(path: Path) -> FileCard:
    """A part of the folder, by its bytes."""
    return FileCard(file=path.name, sha256=sha256_of(path))


def software() -> dict[str, str]:
    """Versions of what a calibration is made and read with."""
    names = ("numpy", "scikit-learn", "onnx", "onnxruntime", "opencv-python-headless")
    return {"palpate": __version__, "python": platform.python_version()} | {n: version(n) for n in names}
