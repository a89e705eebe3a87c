"""Calibrate a model on a run: pack, split, audit, fit, hold out, certify.

Work is kept in a folder next to the result (`.NAME.work`), from which the same command resumes unless the
model's code, the folds, or the version have changed.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
import time
from collections.abc import Sequence
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.calibration_job import CalibrationJob, preparation_of, split_rows
from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.certificate import CalibrationResult, write_certificate
from palpate.calibration.classes import held_out_parts
from palpate.calibration.confounds.confound_audit import audit_confounds
from palpate.calibration.fold_fits import FoldFits
from palpate.calibration.leakage import audit
from palpate.calibration.model_check import check_plugged_in
from palpate.calibration.robustness.perturbation_suite import Suite, guard_of
from palpate.calibration.sessions.session_findings import held_out_intervals, session_fields
from palpate.core import (
    ExistsError,
    PathText,
    Progress,
    new_file,
    refuse_existing,
    sha256_of,
    silent,
    storage_errors,
)
from palpate.estimators.networks import make_model
from palpate.recordings import Run, Split
from palpate.recordings.joined_runs import joined
from palpate.version import __version__


def calibrate(
    run: Run | Sequence[Run], plan: CalibrationPlan, out: PathText, progress: Progress = silent
) -> Path:
    """Calibrate an estimator, write its certificate, and return `out`.

    Scores and intervals come from models that had not seen the row's group. The kept model is trained on
    every row or, where it is costly and one fold gives enough scores, on all but that fold.

    Args:
        run: frames and their labels; several runs are joined.
        out: calibration folder to make; must not exist.

    Raises:
        ExistsError: `out` exists, or its work folder holds another plan or other files.
        LabelError, UnitError, SplitError, InputError: the plan does not fit the run, runs do not fit each
            other, or predictions are not finite.
    """
    run, out = joined(run), Path(out)
    refuse_existing(out)
    started = time.monotonic()
    parts = split_rows(run, plan)
    shape = preparation_of(run, plan).shape
    check_plugged_in(plan, shape)
    work = _work_folder(run, plan, parts, out)
    with storage_errors(work):
        job = CalibrationJob.packed_in(work / "packed", run, plan, parts, progress)
        leakage = audit(job.packed, parts, classes=plan.classes)
        scored = FoldFits(job, make_model(plan.model, plan.options), work, progress).scored()
        held_out, classes = held_out_parts(job.classes, scored.held_out, job.data.groups, plan)
        sessions, intervals = held_out_intervals(job, scored.held_out, held_out)
        suite = Suite(job, held_out, scored.fitted, intervals)
        detector, robustness = guard_of(suite, progress)
        confounds = audit_confounds(job, scored.held_out, pixels=scored.pixels, progress=progress)
        result = CalibrationResult(
            job, leakage, held_out, intervals, scored.fitted, detector, time.monotonic() - started,
            robustness, confounds, classes, scored.pixels,
        )  # fmt: skip
        write_certificate(result, out, more=partial(session_fields, result, sessions))
        shutil.rmtree(work)
    return out


WORK_FILE = re.compile(r"plan\.json|packed|(kept|fold-\d+)[.-].+|tmp\w+\.npz|\..+\.partial")


def _work_folder(run: Run, plan: CalibrationPlan, parts: Split, out: Path) -> Path:
    work, request = out.with_name(f".{out.name}.work"), _request(run, plan, parts)
    note = work / "plan.json"
    try:
        earlier = json.loads(note.read_bytes())
    except (OSError, ValueError, RecursionError):
        earlier = None
    if earlier == request:
        return work
    if isinstance(earlier, dict) and any(earlier.get(key) != request[key] for key in ("run", "plan")):
        raise ExistsError(
            f"{work} holds unfinished work towards another calibration named {out.name}; "
            "run that one again to finish it, remove the folder, or choose another --out",
            code="other-work",
        )
    with storage_errors(work):
        if work.exists():
            others = sorted(path.name for path in work.iterdir() if not WORK_FILE.fullmatch(path.name))
            if others:
                raise ExistsError(
                    f"{work} holds {others[0]}, which is not palpate's; move it, or choose another --out",
                    code="foreign-file",
                )
            shutil.rmtree(work)
        work.mkdir(parents=True)
    with new_file(note) as path:
        path.write_text(json.dumps(request, sort_keys=True))
    return work


def _request(run: Run, plan: CalibrationPlan, parts: Split) -> Any:
    """All that kept work depends on, as JSON gives it back; the folds stand for a split of the user's own."""
    file_path = getattr(sys.modules[type(make_model(plan.model, plan.options)).__module__], "__file__", None)
    code = sha256_of(Path(file_path)) if file_path else str(time.time())  # a notebook has no file to compare
    folds = repr([[rows.tolist() for rows in parts.folds], np.asarray(parts.groups).tolist()])
    computed_by = {"palpate": __version__, "code": code, "folds": sha256(folds.encode()).hexdigest()}
    return json.loads(json.dumps({"run": run.hash, "plan": plan.to_dict()} | computed_by))
