"""A calibration as a folder that proves itself: model, guard, card, held-out predictions, pictures."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import onnx
import pandas as pd

from palpate.calibration.certificate_parts import (
    agreement,
    file_card,
    pictures,
    reference_card,
    run_card,
    software,
    target_cards,
)
from palpate.calibration.made import Calibrated
from palpate.calibration.uncertainty import fit_intervals
from palpate.core.files import new_folder
from palpate.core.shapes import Values
from palpate.estimators.certified import CARD_FILE, Intervals
from palpate.estimators.model_card import FORMAT, Card, InputCard, SplitCard, sealed
from palpate.estimators.networks import settings_of
from palpate.recordings.exchange import image_files
from palpate.recordings.labels import with_own

PREDICTIONS_FILE = "predictions.parquet"


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
        predictions_table(made, halves).to_parquet(folder / PREDICTIONS_FILE, index=False)
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
