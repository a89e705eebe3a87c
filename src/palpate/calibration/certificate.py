"""What a calibration has made, before it is written down.

What every certificate is made of: pictures, scores, references, files and the software's versions.

A calibration as a folder that proves itself: model, guard, card, held-out predictions, pictures.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pandas as pd

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.conformal import fit_intervals
from palpate.calibration.evaluation import score
from palpate.calibration.leakage import LeakageAudit
from palpate.calibration.training_data import Untouched
from palpate.core import CertificateError, Indices, Values, new_folder, sha256_of, split_column
from palpate.estimators.certified import CARD_FILE, Intervals, checked_file
from palpate.estimators.model_card import (
    FORMAT,
    Card,
    FileCard,
    InputCard,
    ReferenceCard,
    RunCard,
    SplitCard,
    TargetCard,
    sealed,
)
from palpate.estimators.networks import settings_of
from palpate.estimators.networks.model_interface import Fitted, TrainingData
from palpate.estimators.novelty import NoveltyDetector
from palpate.recordings import PackedSet, Run, Split
from palpate.recordings.exchange import image_files
from palpate.recordings.labels import with_own
from palpate.recordings.table_files import read_table, write_table
from palpate.version import __version__


@dataclass(frozen=True)
class Calibrated:
    """Everything a certificate is written from.

    Attributes:
        run, plan: what was asked.
        packed, data: the rows learnt from; of the untouched sensor's only where that was asked for.
        untouched: those frames.
        split, audit: how rows were held out.
        held_out: predictions of rows by a model that had not seen their group; NaN for rows not scored.
        fitted, guard: what was learnt from all of them.
        seconds: time it took [s].
    """

    run: Run
    plan: CalibrationPlan
    packed: PackedSet
    data: TrainingData
    split: Split
    audit: LeakageAudit
    untouched: Untouched
    held_out: Values
    fitted: Fitted
    guard: NoveltyDetector
    seconds: float = 0.0

    @property
    def scored(self) -> Indices:
        """Rows that were held out once, and predicted."""
        return np.flatnonzero(~np.isnan(self.held_out).any(axis=1))

    @property
    def one_fold(self) -> bool:
        """Whether only one fold was held out, and the kept model has not seen it."""
        return any(np.array_equal(self.scored, np.sort(rows)) for rows in self.split.folds)


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


PREDICTIONS_FILE, FORMER_PREDICTIONS_FILE = "predictions.csv.gz", "predictions.parquet"


def write_certificate(made: Calibrated, out: Path) -> Card:
    """Write the folder; `out` appears whole or not at all.

    Raises:
        CertificateError: the exported model does not repeat the trained one.
        ExistsError: `out` exists.
    """
    with new_folder(out) as folder:
        onnx.save(made.fitted.to_onnx(), str(folder / "model.onnx"))
        agrees = agreement(made, folder / "model.onnx")
        made.guard.save(folder / "guard.npz")
        scored = made.scored
        intervals = fit_intervals(
            made.held_out[scored], made.data.values[scored], made.data.groups[scored], made.plan.coverage
        )
        halves = intervals.half_widths(made.held_out[scored])
        write_predictions(predictions_table(made, halves), folder)
        for name, image in pictures(made):
            (folder / name).write_bytes(image_files.encode(image).tobytes())
        card = _card(made, folder, intervals, halves, agrees)
        (folder / CARD_FILE).write_text(card.model_dump_json(indent=1))
    return card


def predictions_table(made: Calibrated, halves: Values) -> pd.DataFrame:
    """One row a scored frame: its labels, and for each target what was said of it when it was held out."""
    fold = np.empty(len(made.packed), np.int64)
    for k, rows in enumerate(made.split.folds):
        fold[rows] = k
    rows = made.scored
    names = [made.packed.names[row] for row in rows]
    own = {"row": rows, "frame": names, "held_out_in_fold": fold[rows]}
    table = with_own(made.packed.table.iloc[rows].reset_index(drop=True), own)
    for j, column in enumerate(made.plan.targets):
        table[f"estimate:{column}"] = made.held_out[made.scored, j]
        table[f"half_width:{column}"] = halves[:, j]
    return table


def write_predictions(table: pd.DataFrame, folder: Path) -> None:
    """Write held-out predictions into a calibration's folder; `read_predictions` gives the same numbers."""
    write_table(table, folder / PREDICTIONS_FILE)


def read_predictions(folder: Path, card: Card) -> pd.DataFrame:
    """The held-out predictions of a calibration, as `write_predictions` had them.

    Raises:
        CertificateError: they are missing, or not those that the card names.
        MissingExtraError: they were written as Parquet, and pyarrow is not installed.
    """
    for part in card.files:
        if part.file in (PREDICTIONS_FILE, FORMER_PREDICTIONS_FILE):
            return read_table(checked_file(folder, part))
    raise CertificateError(f"the card of {folder} names no {PREDICTIONS_FILE}; restore it or calibrate again")


def _card(made: Calibrated, folder: Path, intervals: Intervals, halves: Values, agreement: float) -> Card:
    plan, run = made.plan, made.run
    preparation = made.packed.preparation
    others = sorted(p for p in folder.iterdir() if p.name not in ("model.onnx", "guard.npz"))
    return sealed(
        {
            "format": FORMAT,
            "created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
            "software": software(),
            "seed": plan.seed,
            "sensor": run.manifest.sensor,
            "model_name": plan.model,
            "options": settings_of(plan.model, plan.options),
            "coverage": plan.coverage,
            "input": InputCard(
                frame_px=run.frame(0).image.shape[:2],
                size_px=preparation.size_px,
                channels=preparation.channels,
                crop_px=preparation.crop_px,
                beside_px=preparation.beside_px,
                delta=plan.delta,
            ),
            "targets": tuple(target_cards(made, intervals, halves)),
            "model": file_card(folder / "model.onnx"),
            "guard": file_card(folder / "guard.npz"),
            "files": tuple(file_card(path) for path in others),
            "reference": reference_card(made),
            "split": _split(made),
            "run": run_card(made),
            "agreement": agreement,
            "seconds": round(made.seconds, 1),
        }
    )


def _split(made: Calibrated) -> SplitCard:
    return SplitCard(
        kind=made.split.kind,
        reason=made.split.reason,
        columns=made.split.group_columns,
        groups=len(np.unique(made.data.groups)),
        folds=len(made.split.folds),
        rows_learnt=len(made.packed) - (len(made.scored) if made.one_fold else 0),
        rows_scored=len(made.scored),
        clean=made.audit.clean,
        audit=made.audit.text,
        details=made.audit.to_dict(),
    )
