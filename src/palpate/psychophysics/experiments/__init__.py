"""Experiments on softness: design in a file, who is asked what in which order, what is kept of it."""

from palpate.psychophysics.experiments.adaptive_placement import StaircaseRule
from palpate.psychophysics.experiments.experiment_file import (
    PRESETS,
    ExperimentDesign,
    make_experiment,
    read_design,
)
from palpate.psychophysics.experiments.participant_record import ParticipantRecord, laterality_quotient
from palpate.psychophysics.experiments.sitting import (
    Enrolment,
    Sitting,
    enrol,
    participant_folder,
    read_kept_answers,
    records,
)
from palpate.psychophysics.experiments.sitting_dialogue import (
    Answerer,
    SittingDesk,
    SittingDialogue,
    SittingOutcome,
    StimulusPresenter,
    UnrenderedStimuli,
    ask_enrolment,
    noisy_answers,
)
from palpate.psychophysics.experiments.trial_export import export_trials
from palpate.psychophysics.experiments.trial_schedule import Schedule, make_schedule

__all__ = [
    "PRESETS", "Answerer", "Enrolment", "ExperimentDesign", "ParticipantRecord", "Schedule", "Sitting",
    "SittingDesk", "SittingDialogue", "SittingOutcome", "StaircaseRule", "StimulusPresenter",
    "UnrenderedStimuli", "ask_enrolment", "enrol", "export_trials", "laterality_quotient", "make_experiment",
    "make_schedule", "noisy_answers", "participant_folder", "read_design", "read_kept_answers", "records",
]  # fmt: skip
