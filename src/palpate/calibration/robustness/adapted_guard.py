"""Guard of a calibration that is taken over to another copy of its sensor, or to another session.

It knows the frames that the former calibration knew besides the new ones. The new frames set its limits,
and what changes of the camera cost is tried on them anew: by errors of the network on frames that it has not
learnt from, and by the new intervals. What the former calibration knew of changes is of other frames and
other intervals, and is left behind.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import onnx

from palpate.calibration.robustness.perturbation_suite import Suite, try_changes
from palpate.core import Progress, Tensor, Values, silent
from palpate.estimators.certified import Estimator
from palpate.estimators.finding_cards import RobustnessCard
from palpate.estimators.guard import NoveltyDetector, RenderedImages, fit_novelty_detector
from palpate.recordings import Split

MAX_FOLDS = 10  # in which frames are set beside those of the others: each costs a look at all of them


@dataclass(frozen=True, slots=True)
class CertifiedModel:
    """Network of a certificate, as a model that has learnt."""

    estimator: Estimator

    def predict(self, inputs: Tensor) -> Values:
        """Outputs ``[n o]``, see `Estimator.values`."""
        return self.estimator.values(inputs)

    def to_onnx(self) -> onnx.ModelProto:
        """The network as it stands in the certificate's folder."""
        file = self.estimator.folder / self.estimator.card.model.file
        return onnx.load(str(file), load_external_data=False)


def adapted_guard(
    suite: Suite, former: RenderedImages, progress: Progress = silent
) -> tuple[NoveltyDetector, RobustnessCard]:
    """Learn what frames look like and what changes cost.

    Its limits let the new frames pass, each compared with the former ones and those of other groups. Where
    the former frames are too unlike these to help, they are left out.

    Args:
        suite: the new frames, with outputs of the network for them.
        former: thumbnails that the former calibration's guard keeps.
        progress: called with how far it is.

    Returns:
        The guard, and what was found. Where frames are too few it compares thumbnails alone, and the card
        says so.
    """
    learning = suite.learning
    progress("learning what frames look like", 0, 1)
    thumbs = learning.thumbnails()
    detector = fit_novelty_detector(
        thumbs,
        learning.folds_of_whole(suite.parts),
        thumbs[learning.untouched.rows],
        also=former,
        seed=suite.plan.seed,
    )
    progress("learning what frames look like", 1, 1)
    return try_changes(replace(suite, parts=_in_few_folds(suite.parts)), detector, progress)


def _in_few_folds(parts: Split) -> Split:
    """The same rows, several folds held out together where there are many."""
    count = min(MAX_FOLDS, len(parts.folds))
    return replace(parts, folds=tuple(np.concatenate(parts.folds[k::count]) for k in range(count)))
