"""Calibrate and report in one go: the folder holds its own page.

One sentence on what a certificate of hand presses promises: its errors on unseen presses.

The rate is that of intervals by the errors of other presses. Estimates that are not significantly better than
the mean are called useless.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.fitting import calibrate
from palpate.core import PathText, Progress, silent
from palpate.estimators.certified import read_card
from palpate.estimators.model_card import Card
from palpate.recordings import Run
from palpate.reports.certificate_page import write_report
from palpate.sensing.collection.press_collector import FEW_PRESSES, REST

if TYPE_CHECKING:
    import pandas as pd

    from palpate.estimators.model_card import Card

REPORT_FILE = "report.html"


def certify(
    run: Run | Sequence[Run], plan: CalibrationPlan, out: PathText, progress: Progress = silent
) -> Card:
    """Calibrate, see `calibration.calibrate`, and write the report into the calibration's folder."""
    out = Path(out)
    calibrate(run, plan, out, progress)
    progress("writing the report", 0, 1)
    write_report(out, out / REPORT_FILE)
    progress("writing the report", 1, 1)
    return read_card(out)


TARGET = "force_N"
FOLDS = 20  # greatest number; models of fewer presses err much more than the kept one
RATE = 0.9  # of intervals


def left_out_text(frames: int) -> str:
    """Return the sentence on frames whose labels a kill has lost; empty for none."""
    if not frames:
        return ""
    lost = "1 frame has" if frames == 1 else f"{frames} frames have"
    return f"{lost} no label, as a writer that was killed leaves them, and nothing was learnt from that."


def honest_sentence(card: Card, predictions: pd.DataFrame, presses: int) -> str:
    """Return what a certificate of hand presses promises, and what it does not.

    Args:
        predictions: its held-out ones.
        presses: number of training presses.
    """
    score = card.targets[0].score
    if is_useless(card, predictions):
        return (
            f"Useless: on presses that it had not seen it errs by {score.mae:.3g} N on average, not surely "
            f"less than always saying the mean does ({score.mean_mae:.3g} N). {_what_to_do(presses)}"
        )
    held, low, high = (100 * rate for rate in rate_beyond(predictions))
    sittings = predictions["session"].nunique() if "session" in predictions else 1
    when = "on one day" if sittings < 2 else f"in {sittings} sittings that were all learnt from"
    return (
        f"On presses that it had not seen it errs by {score.mae:.2g} N on average, and 90 % intervals by the "
        f"errors of other presses held {held:.0f} % of frames ({low:.0f} to {high:.0f} %, from {presses} "
        f"presses): by one hand, {when}, with one probe; what another day brings is not tested."
    )


def _what_to_do(presses: int) -> str:
    look = (
        "whether each label belongs to its press, and whether the image changes where the sensor is pressed."
    )
    if presses >= FEW_PRESSES:
        return f"Look {look}"
    return (
        f"{presses} presses are few: press more first, to {FEW_PRESSES} or more. If it stays so, look {look}"
    )


def is_useless(card: Card, predictions: pd.DataFrame) -> bool:
    """Return whether held-out estimates are not significantly better than the mean."""
    return card.targets[0].score.says_nothing or not beats_the_mean(predictions)


def rate_beyond(predictions: pd.DataFrame) -> tuple[float, float, float]:
    """Return the coverage of 90 % intervals in whose fit the row's own press had no part, and its 95 %
    interval.
    """
    from palpate.calibration.coverage.conformal import fit_intervals
    from palpate.calibration.coverage.grouped_rates import grouped_coverage_interval

    predictions = predictions[predictions["press"] != REST]
    true, told = (predictions[[name]].to_numpy(float) for name in (TARGET, f"estimate:{TARGET}"))
    _, press = np.unique(predictions["press"].astype(str).to_numpy(), return_inverse=True)
    inside = np.zeros(len(true), bool)
    for k in range(min(FOLDS, int(press.max()) + 1)):
        held = press % FOLDS == k
        others = fit_intervals(told[~held], true[~held], press[~held], RATE)
        inside[held] = others.hold(told[held], true[held])[:, 0]
    return float(inside.mean()), *grouped_coverage_interval(inside, press)


def beats_the_mean(predictions: pd.DataFrame) -> bool:
    """Return whether held-out estimates err less than the other presses' mean, at 95 % over presses."""
    from palpate.calibration.coverage.grouped_rates import grouped_mean_interval

    predictions = predictions[predictions["press"] != REST]
    true, told = predictions[TARGET].to_numpy(float), predictions[f"estimate:{TARGET}"].to_numpy(float)
    press = predictions["press"].astype(str).to_numpy()
    of_press = predictions.groupby("press")[TARGET].mean()
    others = (of_press.sum() - of_press) / (len(of_press) - 1)
    mean = others.to_dict()
    by_mean = predictions["press"].map(mean).to_numpy(float)
    found = grouped_mean_interval(np.abs(by_mean - true) - np.abs(told - true), press)
    return found is not None and found[0] > 0
