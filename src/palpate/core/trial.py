"""A Trial: one stimulus, one answer of one person."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Trial:
    """One answer in an experiment on perception.

    Attributes:
        stimuli: coded names of what was presented, in order; never what they are.
        response: the coded answer, one of the design's.
        time_s: when the answer came, on the run's clock [s].
        subject: coded participant; never a name.
    """

    stimuli: tuple[str, ...]
    response: str
    time_s: float
    subject: str
