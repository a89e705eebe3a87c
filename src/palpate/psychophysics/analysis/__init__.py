"""Analysis of judgements: proportions, confusions, psychometric functions, and models of conditions."""

from palpate.psychophysics.analysis.condition_models import (
    ConditionCounts,
    fit_mixed_logistic,
    marginal_log_odds,
    mixed_log_likelihood,
    share_differences,
    sign_flip_p,
)
from palpate.psychophysics.analysis.experiment_analysis import (
    ExperimentAnalysis,
    SettingAccuracy,
    SettingThreshold,
    TaskComparison,
    analyse_experiment,
)
from palpate.psychophysics.analysis.proportions import (
    PlannedStudy,
    clopper_pearson_interval,
    cluster_interval,
    newcombe_interval,
    participants_needed,
    simulated_power,
    wald_full_width,
    wald_half_width,
    wald_interval,
    wilson_interval,
)
from palpate.psychophysics.analysis.psychometric_fit import (
    PsychometricFit,
    PsychometricFunction,
    SigmoidShape,
    fit_psychometric,
)
from palpate.psychophysics.analysis.rank_confusion import (
    RankConfusion,
    confusion_of_places,
    rank_confusion,
    rank_correlation,
)

__all__ = [
    "ConditionCounts", "ExperimentAnalysis", "PlannedStudy", "PsychometricFit", "PsychometricFunction",
    "RankConfusion", "SettingAccuracy", "SettingThreshold", "SigmoidShape", "TaskComparison",
    "analyse_experiment", "clopper_pearson_interval", "cluster_interval", "confusion_of_places",
    "fit_mixed_logistic", "fit_psychometric", "marginal_log_odds", "mixed_log_likelihood",
    "newcombe_interval", "participants_needed", "rank_confusion", "rank_correlation", "share_differences",
    "sign_flip_p", "simulated_power", "wald_full_width", "wald_half_width", "wald_interval",
    "wilson_interval",
]  # fmt: skip
