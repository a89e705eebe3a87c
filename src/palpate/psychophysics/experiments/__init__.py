"""Experiments on softness: design in a file, who is asked what in which order, what is kept of it."""

from palpate.psychophysics.experiments.experiment_file import ExperimentDesign, read_design
from palpate.psychophysics.experiments.experiment_presets import PRESETS, make_experiment
from palpate.psychophysics.experiments.kept_answers import read_kept_answers
from palpate.psychophysics.experiments.participant_record import ParticipantRecord, laterality_quotient
from palpate.psychophysics.experiments.sitting import Enrolment, Sitting, enrol, participant_folder, records
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
from palpate.psychophysics.experiments.staircases import StaircaseRule
from palpate.psychophysics.experiments.trial_export import export_trials
from palpate.psychophysics.experiments.trial_schedule import Schedule, make_schedule

__all__ = [
    "PRESETS", "Answerer", "Enrolment", "ExperimentDesign", "ParticipantRecord", "Schedule", "Sitting",
    "SittingDesk", "SittingDialogue", "SittingOutcome", "StaircaseRule", "StimulusPresenter",
    "UnrenderedStimuli", "ask_enrolment", "enrol", "export_trials", "laterality_quotient", "make_experiment",
    "make_schedule", "noisy_answers", "participant_folder", "read_design", "read_kept_answers", "records",
]  # fmt: skip
