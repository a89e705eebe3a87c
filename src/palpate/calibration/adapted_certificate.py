"""The certificate of an adapted calibration: as any other's, and from which calibration it comes."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from palpate.calibration.certificate import PREDICTIONS_FILE, predictions_table
from palpate.calibration.certificate_parts import (
    agreement,
    file_card,
    pictures,
    reference_card,
    run_card,
    software,
    target_cards,
)
from palpate.calibration.correction import AS_IT_WAS, Adapted
from palpate.calibration.made import Calibrated
from palpate.calibration.uncertainty import GROUPS_FOR_SPREAD, conformal_quantile, fit_intervals
from palpate.core.files import new_folder
from palpate.core.shapes import Values
from palpate.estimators.certified import CARD_FILE, Intervals
from palpate.estimators.model_card import Card, SplitCard, sealed
from palpate.recordings.exchange import image_files

MOST_COVERAGE = 1 - 1e-9


def write_adapted(made: Calibrated, adapted: Adapted, former: Card, out: Path) -> Card:
    """Write the folder; `out` appears whole or not at all.

    Args:
        made: the copy's rows, the network with its correction, and the guard.
        adapted: what the correction is, and what it said of presses it had not learnt from.
        former: card of the calibration that was adapted.
        out: the folder to make.

    Raises:
        CertificateError: the exported model does not repeat the network and its correction.
        ExistsError: `out` exists.
    """
    with new_folder(out) as folder:
        onnx.save(made.fitted.to_onnx(), str(folder / "model.onnx"))
        agrees = agreement(made, folder / "model.onnx")
        made.guard.save(folder / "guard.npz")
        intervals = intervals_of_presses(made.held_out, made.data.values, made.data.groups, former.coverage)
        halves = intervals.half_widths(made.held_out)
        predictions_table(made, halves).to_parquet(folder / PREDICTIONS_FILE, index=False)
        for name, image in pictures(made):
            (folder / name).write_bytes(image_files.encode(image).tobytes())
        card = _card(made, adapted, former, folder, intervals, halves, agrees)
        (folder / CARD_FILE).write_text(card.model_dump_json(indent=1))
    return card


def intervals_of_presses(predicted: Values, true: Values, groups: np.ndarray, coverage: float) -> Intervals:
    """Intervals that hold the truth at the rate `coverage` in presses not seen, where few were.

    Rows of one press err alike, so that the rank of the quantile is raised by one press and not by one row:
    of P presses, the rows' rate is coverage (P + 1) / P. With ten presses and 90 % that is 99 % of the rows.
    So the presses' distributions are pooled (R. Dunn, L. Wasserman and A. Ramdas, J. Am. Stat. Assoc. 118,
    2491 (2023), doi:10.1080/01621459.2022.2060112), which holds on average over presses.

    Where presses are too few for a width that follows the estimate, the one width is the errors' own
    quantile: scaling each by what the others' typical error is would only add their scatter.
    """
    presses = len(np.unique(groups))
    raised = min(coverage * (presses + 1) / presses, MOST_COVERAGE)
    found = replace(fit_intervals(predicted, true, groups, raised), coverage=coverage)
    if presses >= GROUPS_FOR_SPREAD:
        return found
    scores = np.abs(predicted - true) / found.spread.at(predicted)
    return replace(found, quantile=np.array([conformal_quantile(column, raised) for column in scores.T]))


def _card(
    made: Calibrated,
    adapted: Adapted,
    former: Card,
    folder: Path,
    intervals: Intervals,
    halves: Values,
    agreement: float,
) -> Card:
    others = sorted(p for p in folder.iterdir() if p.name not in ("model.onnx", "guard.npz"))
    return sealed(
        former.model_dump(exclude={"id"})
        | {
            "created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
            "software": software(),
            "sensor": made.run.manifest.sensor,
            "targets": tuple(target_cards(made, intervals, halves)),
            "model": file_card(folder / "model.onnx"),
            "guard": file_card(folder / "guard.npz"),
            "files": tuple(file_card(path) for path in others),
            "reference": reference_card(made),
            "split": _split(made, adapted, former),
            "run": run_card(made),
            "agreement": agreement,
            "seconds": round(made.seconds, 1),
            "adapted_from": former.id,
        }
    )


def _split(made: Calibrated, adapted: Adapted, former: Card) -> SplitCard:
    changed = [c for c, d in zip(former.columns, adapted.choices, strict=True) if d.terms != AS_IT_WAS]
    return SplitCard(
        kind=made.split.kind,
        reason=(
            f"adapted from calibration {former.id}, whose network has seen none of this run; scored by "
            "corrections that had not learnt from the press they read; corrected: "
            f"{', '.join(changed) or 'nothing, since no correction was better than none'}"
        ),
        columns=made.split.group_columns,
        groups=len(np.unique(made.data.groups)),
        folds=len(made.split.folds),
        rows_learnt=len(made.packed),
        rows_scored=len(made.packed),
        clean=made.audit.clean,
        audit=made.audit.text,
        details=made.audit.to_dict() | {"correction": _said(made, adapted, former)},
    )


def _said(made: Calibrated, adapted: Adapted, former: Card) -> dict[str, Any]:
    """Of each target: the mean absolute error before and after, in its unit, and what was done."""
    before, after = (
        np.abs(values - made.data.values).mean(axis=0) for values in (adapted.estimates, adapted.held_out)
    )
    return {
        column: {
            "mae_before": float(before[j]),
            "mae_after": float(after[j]),
            "terms": choice.terms,
            "strength": choice.strength,
        }
        for j, (column, choice) in enumerate(zip(former.columns, adapted.choices, strict=True))
    }
