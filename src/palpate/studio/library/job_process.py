"""Process of one long job of the pages: ``python -m palpate.studio.library.job_process DO WHAT...``.

It prints a line of JSON for each step that is done, and last what came of it, so that nothing long or large
is ever worked out by the server of the pages.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from palpate.core import PalpateError
from palpate.core.failure_log import Failure, contained

SAID_S = 0.2  # between two lines about the same step


class JobVoice:
    """Voice of a job: says how far it is, seldom enough to be read."""

    def __init__(self) -> None:
        self._what, self._said_s = "", 0.0

    def progress(self, what: str, done: int, total: int) -> None:
        """Say a step, where it is another one, ends, or the last was said a while ago."""
        now_s = time.monotonic()
        if what != self._what or done == total or now_s - self._said_s >= SAID_S:
            self._what, self._said_s = what, now_s
            self.say({"progress": [what, done, total]})

    def say(self, line: dict[str, Any]) -> None:
        """Print a line."""
        print(json.dumps(line), flush=True)

    def report(self, failure: Failure) -> None:
        """Report an exception that nothing handled, for the page."""
        self.say({"error": failure.text, "code": failure.code})


def calibrate_job(voice: JobVoice, run: str, targets: str, out: str) -> dict[str, Any]:
    """Calibrate on a run and certify, as `palpate calibrate` does by itself."""
    import palpate
    from palpate.workflows.certification import certify

    plan = palpate.CalibrationPlan(tuple(targets.split(",")), model="kernel-ridge")
    card = certify(palpate.Run.open(run), plan, out, voice.progress)
    return {"targets": {one.column: one.score.model_dump(mode="json") for one in card.targets}}


def evaluate_job(voice: JobVoice, calibration: str, run: str, out: str) -> dict[str, Any]:
    """Score a calibration on a run, into a file; what was found of each target."""
    import palpate

    scores = palpate.evaluate(
        palpate.Estimator.open(calibration), palpate.Run.open(run), progress=voice.progress
    )
    Path(out).write_text(json.dumps(scores, allow_nan=False) + "\n")
    return {"targets": scores["targets"], "findings": scores["findings"]}


def report_job(voice: JobVoice, calibration: str, out: str) -> dict[str, Any]:
    """Write a calibration's report."""
    from palpate.reports import write_report

    voice.progress("writing the report", 0, 1)
    write_report(calibration, out)
    return {}


def compare_job(voice: JobVoice, first: str, second: str, out: str) -> dict[str, Any]:
    """Set two calibrations side by side, as a page and in words."""
    from palpate.reports.comparison_page import compare_calibrations, comparison_text, write_comparison

    voice.progress("comparing", 0, 1)
    comparison = compare_calibrations(first, second)
    write_comparison(comparison, out)
    return {"text": comparison_text(comparison)}


def analyse_job(voice: JobVoice, folder: str, out: str) -> dict[str, Any]:
    """Analyse an experiment's answers, as `palpate experiment analyze` does with its own settings."""
    from palpate.psychophysics.analysis import analyse_experiment
    from palpate.psychophysics.experiments import read_kept_answers
    from palpate.reports.trial_page import analysis_answers, write_trial_page

    voice.progress("analysing", 0, 1)
    kept = read_kept_answers(Path(folder))
    found = analyse_experiment(
        kept.judgements, kept.stimuli, unanswered=kept.unanswered, simulated=kept.simulated
    )
    write_trial_page(found, Path(out), Path(folder).name)
    told = ["Simulated: nothing here is a measurement of people."] if kept.simulated else []
    if kept.withdrawn:
        told.append(f"{len(kept.withdrawn)} with answers whose consent does not stand are left out.")
    return {"text": "\n".join([*told, *analysis_answers(found)])}


JOBS = {
    "analyse": analyse_job,
    "calibrate": calibrate_job,
    "compare": compare_job,
    "evaluate": evaluate_job,
    "report": report_job,
}


def main(words: list[str]) -> int:
    """Do one job; 0 where it was done, 2 where it was refused and said why."""
    voice = JobVoice()
    with contained(f"the job {words[0]}", voice.report):
        try:
            found = JOBS[words[0]](voice, *words[1:])  # type: ignore[operator]
        except PalpateError as e:
            voice.say({"error": " ".join(str(e).split()), "code": e.code})
            return 2
    voice.say({"done": found})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
