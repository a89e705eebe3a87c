"""A table of responses for tests, as a session writes it."""

from collections.abc import Iterable
from pathlib import Path

from palpate.psychophysics import Judgement
from palpate.psychophysics.experiments.participant_record import HEADER, response_lines


def write_responses(path: Path, judgements: Iterable[Judgement]) -> None:
    path.write_text(HEADER + response_lines(judgements, simulated=False))
