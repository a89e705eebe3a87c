"""Analysis of judgements: proportions, confusions, psychometric functions, and models of conditions."""

from palpate.psychophysics.analysis.condition_models import (
    ConditionCounts,
    LogOddsDifference,
    MixedLogistic,
    ShareDifference,
    counts_of,
    fit_mixed_logistic,
    marginal_log_odds,
    mixed_log_likelihood,
    share_differences,
    sign_flip_p,
)
from palpate.psychophysics.analysis.experiment_analysis import (
    ExperimentAnalysis,
    SettingAccuracy,
    SettingRankings,
    SettingThreshold,
    TaskComparison,
    analyse_experiment,
)
from palpate.psychophysics.analysis.proportions import (
    clopper_pearson_interval,
    cluster_interval,
    newcombe_interval,
    wald_full_width,
    wald_half_width,
    wald_interval,
    wilson_interval,
)
from palpate.psychophysics.analysis.psychometric_fit import (
    LikelyLine,
    PosteriorRange,
    PsychometricFit,
    fit_psychometric,
    most_likely,
)
from palpate.psychophysics.analysis.psychometric_function import PsychometricFunction, SigmoidShape
from palpate.psychophysics.analysis.rank_confusion import (
    RankConfusion,
    RankCorrelation,
    confusion_of_places,
    places_given,
    rank_confusion,
    rank_correlation,
)
from palpate.psychophysics.analysis.sample_size import (
    PlannedStudy,
    StudyPower,
    participants_needed,
    simulated_power,
)

__all__ = [
    "ConditionCounts", "ExperimentAnalysis", "LikelyLine", "LogOddsDifference", "MixedLogistic",
    "PlannedStudy", "PosteriorRange", "PsychometricFit", "PsychometricFunction", "RankConfusion",
    "RankCorrelation", "SettingAccuracy", "SettingRankings", "SettingThreshold", "ShareDifference",
    "SigmoidShape", "StudyPower", "TaskComparison", "analyse_experiment", "clopper_pearson_interval",
    "cluster_interval", "confusion_of_places", "counts_of", "fit_mixed_logistic", "fit_psychometric",
    "marginal_log_odds", "mixed_log_likelihood", "most_likely", "newcombe_interval", "participants_needed",
    "places_given", "rank_confusion", "rank_correlation", "share_differences", "sign_flip_p",
    "simulated_power", "wald_full_width", "wald_half_width", "wald_interval", "wilson_interval",
]  # fmt: skip
