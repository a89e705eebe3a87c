"""Guard of a calibration: what frames look like, what changes of the camera cost, whose copy is seen."""

from palpate.estimators.guard.guard_features import Registration, frame_features, image_features
from palpate.estimators.guard.known_changes import (
    EXCHANGED,
    MAX_HARM,
    MIRRORED,
    SIGNATURES,
    ChangeExamples,
    KnownChanges,
    Verdict,
    cross_fitted,
    fit_known_changes,
    rescaled,
)
from palpate.estimators.guard.novelty import (
    CopyDiscriminator,
    LearnsFromRendered,
    NeighbourModel,
    NoveltyDetector,
    RenderedImages,
    fit_novelty_detector,
    kept_rows,
    thumbnail,
    thumbnails,
)

__all__ = [
    "EXCHANGED", "MAX_HARM", "MIRRORED", "SIGNATURES", "ChangeExamples", "CopyDiscriminator", "KnownChanges",
    "LearnsFromRendered", "NeighbourModel", "NoveltyDetector", "Registration", "RenderedImages", "Verdict",
    "cross_fitted", "fit_known_changes", "fit_novelty_detector", "frame_features", "image_features",
    "kept_rows", "rescaled", "thumbnail", "thumbnails",
]  # fmt: skip
