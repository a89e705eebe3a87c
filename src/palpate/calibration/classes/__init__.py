"""Labels of classes: their one-hot outputs, prediction sets, and scores."""

from palpate.calibration.classes.class_labels import (
    SEPARATOR,
    ClassLabels,
    HeldOutClasses,
    class_labels,
    known_codes,
    set_text,
    target_values,
    with_classes,
)
from palpate.calibration.classes.prediction_sets import (
    ClassAnswers,
    class_findings,
    class_score,
    score_of_run,
)

__all__ = [
    "SEPARATOR", "ClassAnswers", "ClassLabels", "HeldOutClasses", "class_findings", "class_labels",
    "class_score", "known_codes", "score_of_run", "set_text", "target_values", "with_classes",
]  # fmt: skip
