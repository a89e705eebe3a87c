"""A child that runs a participant's sitting, slowly, until it is killed. Argument: the experiment."""

import sys
import time
from pathlib import Path

from tests.psychophysics.sitting_desks import NOW, Desk

from palpate.core import MonotonicClock
from palpate.psychophysics.experiments import Sitting, SittingDialogue, noisy_answers, read_design


def run(folder: Path) -> None:
    """Answer a trial each 20 ms, saying so after it is kept."""
    design = read_design(folder)
    answer = noisy_answers(design, "P01", 20.0)

    def slowly(trial):
        with_answer = answer(trial)
        print(len(sitting.judgements), flush=True)
        time.sleep(0.02)
        return with_answer

    with Sitting(design, "P01", lambda: NOW) as sitting:
        SittingDialogue(sitting, Desk(), None, MonotonicClock(), slowly).run()


if __name__ == "__main__":
    run(Path(sys.argv[1]))
