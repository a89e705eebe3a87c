"""Perturbation suite: cost of camera changes to a calibration's model, and a guard that knows them.

Held-out frames are changed by each kind and size of `perturbations.KINDS`. A changed frame's estimate is its
held-out one plus the change of the kept model's output.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import onnx
from scipy.stats import fisher_exact

from palpate.calibration.calibration_job import CalibrationJob
from palpate.calibration.coverage.range_scores import (
    calibrated_arc,
    mean_of,
    shortest,
    uninformative_width,
)
from palpate.calibration.fold_fits import passed_errors
from palpate.calibration.robustness.perturbations import KINDS, kinds_for, perturbed
from palpate.core import Bool, Float, Image, Indices, Int, Progress, Shaped, Tensor, UInt8, Values, silent
from palpate.core.plugins import ERROR, plugin_calls
from palpate.estimators.certified import Estimator, checked_file
from palpate.estimators.class_sets import Outputs, TargetLayout
from palpate.estimators.findings import PerturbationCard, RobustnessCard
from palpate.estimators.guard import (
    MAX_HARM,
    ChangeExamples,
    LearnsFromRendered,
    NoveltyDetector,
    Registration,
    RenderedImages,
    cross_fitted,
    fit_known_changes,
    fit_novelty_detector,
    frame_features,
    kept_rows,
    rescaled,
    thumbnail,
)
from palpate.estimators.intervals import Intervals
from palpate.estimators.model_card import NO_BETTER
from palpate.estimators.networks.model_interface import Fitted
from palpate.recordings import Split

MIN_ROWS = 50  # held-out frames needed for the cost of a change and false refusals
FRAMES_A_CELL = 12
MIN_FRAMES_A_CELL = 4
ROWS_A_FRAME = 5  # with fewer held-out frames, each is changed as often
USUAL_PIXELS = 640 * 480  # of a frame; larger ones are changed less often, in proportion
MAX_UNCHANGED = 400
BATCH = 32
CROSS_FITS = 4
OWN_STREAM = 1  # folds are drawn by the seed alone: by the same numbers, rows would be those of one fold
BEYOND = 2.0  # half-widths


@dataclass(frozen=True)
class Suite:
    """Frames and model of a calibration to be tested.

    Attributes:
        held_out: outputs ``[n o]`` by a model that had not seen the row's group; NaN where not scored.
        fitted: model that is kept.
        intervals: of its certificate.
    """

    job: CalibrationJob
    held_out: Outputs
    fitted: Fitted
    intervals: Intervals

    @cached_property
    def read(self) -> Indices:
        """Targets that the model reads: nothing is lost of the others. All where it reads none."""
        scored = np.flatnonzero(~np.isnan(self.held_out).any(axis=1))
        low, high = self.intervals.ends(self.held_out[scored])
        layout, values = self.job.plan.layout, self.job.data.values
        told = told_targets(
            self.held_out[scored], values[scored], values, high - low, layout, self.intervals.coverage
        )
        return np.flatnonzero(told) if told.any() else np.arange(len(told))

    def frame(self, row: int) -> Image:
        return self.job.run.frame(int(self.job.rows[row])).image

    def prepared(self, frame: Image) -> UInt8[np.ndarray, "_ _ _"]:
        return self.job.whole.preparation.apply(frame)

    def outputs(self, rows: Indices, prepared: list[np.ndarray]) -> Outputs:
        """Outputs of the model that is kept, for prepared frames of these rows."""
        parts = [slice(start, start + BATCH) for start in range(0, len(rows), BATCH)]
        found = np.concatenate([self.fitted.predict(self._inputs(rows[p], prepared[p])) for p in parts])
        return found[:, : self.held_out.shape[1]]  # those for classes have no interval to be beyond

    def _inputs(self, rows: Indices, prepared: list[np.ndarray]) -> Tensor:
        inputs = np.stack(prepared).transpose(0, 3, 1, 2).astype(np.float32)
        if self.job.plan.delta:
            untouched = self.job.untouched
            inputs -= untouched.images[untouched.groups[self.job.rows[rows]]]
        return np.ascontiguousarray(inputs)


def told_targets(
    held_out: Outputs,
    true: Values,
    learnt: Float[np.ndarray, "m t"],
    widths: Values,
    layout: TargetLayout,
    coverage: float,
) -> Bool[np.ndarray, " t"]:
    """Return whether each target is predicted better than by the mean, with intervals shorter than its range.

    Args:
        held_out: held-out outputs ``[n o]``.
        true, widths: labels, and widths of their intervals ``[n t]``.
        learnt: labels of all rows ``[m t]``.
    """
    error = np.abs(layout.differences(layout.decoded(held_out), true)).mean(axis=0)
    told = [
        error[j] <= NO_BETTER * np.abs(shortest(true[:, j] - mean_of(learnt[:, j], period), period)).mean()
        and widths[:, j].mean() < _untold(learnt[:, j], widths[:, j], period, coverage)
        for j, period in enumerate(layout.periods)
    ]
    return np.array(told, bool)


def _untold(learnt: np.ndarray, widths: np.ndarray, period: float | None, coverage: float) -> float:
    if period is None:
        return float(np.ptp(learnt))
    least, greatest = calibrated_arc(learnt, period)
    return uninformative_width(widths, greatest - least, coverage)


@dataclass(frozen=True)
class Tried:
    """Changed frames and their effect.

    Attributes:
        row: row of each ``[m]``.
        kind, size: of the change ``[m]``.
        moved: change of the outputs ``[m o]``.
    """

    row: Int[np.ndarray, " m"]
    kind: Shaped[np.ndarray, " m"]
    size: Float[np.ndarray, " m"]
    prepared: list[np.ndarray]
    moved: Outputs


def try_changes(
    suite: Suite, detector: NoveltyDetector, progress: Progress = silent
) -> tuple[NoveltyDetector, RobustnessCard]:
    """Measure the cost of camera changes, and return a guard that refuses the costly ones, with its card.

    Args:
        detector: guard, fitted to all thumbnails of the suite's frames with its seed.
    """
    scored = np.flatnonzero(~np.isnan(suite.held_out).any(axis=1))
    if not suite.job.plan.targets:
        return detector, _no_target()
    if len(scored) < MIN_ROWS:
        return detector, _too_few(len(scored))
    rng = np.random.default_rng([suite.job.plan.seed, OWN_STREAM])
    rows = np.sort(rng.permutation(scored)[:MAX_UNCHANGED])
    tried = _tried(suite, rows, rng, progress)
    learnt = np.setdiff1d(np.arange(len(suite.held_out)), scored)
    learnt = np.sort(rng.permutation(learnt)[:MAX_UNCHANGED])
    unchanged = _errors(suite, rows, np.zeros((len(rows), 1)))
    changed = _errors(suite, tried.row, tried.moved)
    before = _errors(suite, tried.row, np.zeros((len(tried.row), 1)))
    turns = _turns([suite.job.plan.layout.periods[j] for j in suite.read], changed)
    harm = _harm(unchanged.scaled, (changed.error - before.error) / changed.half, turns)
    progress("learning which changes cost", 0, 1)
    every, registration = _examples(suite, detector, rows, tried, harm, learnt)
    for examples in (every.without_local(), every):
        verdicts = cross_fitted(examples, registration, _parts(suite, rows))
        atypicality = np.array([verdict.atypicality for verdict in verdicts])
        known, factor = rescaled(fit_known_changes(examples, registration), atypicality[: len(rows)])
        refused = atypicality / factor > 1
        refused = refused[: len(rows) + len(tried.row)]
        silent_share = np.mean(changed.beyond & ~refused[len(rows) :, None])
        if silent_share <= unchanged.beyond.mean() + MAX_SILENT:
            break  # what sees more also takes a good session for another one more often
    progress("learning which changes cost", 1, 1)
    found = _card(rows, tried, unchanged, changed, refused)
    return replace(detector, changes=known), found


def _parts(suite: Suite, rows: Indices) -> list[Indices]:
    """Rows dealt to a few parts, whole groups together; of one group alone, row by row."""
    groups = suite.job.data.groups[rows]
    _, of = np.unique(groups if len(np.unique(groups)) > 1 else rows, return_inverse=True)
    return [rows[of % CROSS_FITS == k] for k in range(min(CROSS_FITS, int(of.max()) + 1))]


def _too_few(count: int) -> RobustnessCard:
    text = (
        f"{count} held-out frames are too few to tell what changes of the camera cost, {MIN_ROWS} or more "
        "are needed: nothing is promised of another focus, place, light or storage, and the guard compares "
        "thumbnails alone"
    )
    return RobustnessCard(text=text, frames=count, refused=0.0, beyond=0.0, table=())


def _no_target() -> RobustnessCard:
    text = (
        "What changes of the camera cost is measured of targets alone, by errors in half-widths of their "
        "intervals, and there are classes only: nothing is promised of another focus, place, light or "
        "storage, and the guard compares thumbnails alone"
    )
    return RobustnessCard(text=text, frames=0, refused=0.0, beyond=0.0, table=())


def _prepared(suite: Suite, rows: Indices) -> Iterator[np.ndarray]:
    for row in rows:
        yield suite.job.packed.read(np.array([row]))[0]


def _tried(suite: Suite, rows: Indices, rng: np.random.Generator, progress: Progress) -> Tried:
    first = suite.frame(int(rows[0]))
    kinds = kinds_for(first)
    pixels = first.shape[0] * first.shape[1]
    most = min(FRAMES_A_CELL, round(FRAMES_A_CELL * USUAL_PIXELS / pixels), len(rows) // ROWS_A_FRAME)
    count = max(MIN_FRAMES_A_CELL, most)
    base = np.sort(rng.permutation(rows)[: max(MIN_ROWS, 5 * count)])
    frames = {row: suite.frame(row) for row in base.tolist()}
    unchanged = dict(zip(base.tolist(), suite.outputs(base, list(_prepared(suite, base))), strict=True))
    row, kind, size, prepared, moved = [], [], [], [], []
    cells = [(name, value) for name in kinds for value in KINDS[name].sizes]
    for done, (name, value) in enumerate(cells):
        chosen = rng.choice(base, count, replace=False)
        images = [suite.prepared(perturbed(frames[int(r)], name, value, rng)) for r in chosen]
        moved.append(suite.outputs(chosen, images) - np.stack([unchanged[int(r)] for r in chosen]))
        row.append(chosen)
        kind += [name] * count
        size += [value] * count
        prepared += images
        progress("trying changes of the camera", done + 1, len(cells))
    return Tried(np.concatenate(row), np.array(kind), np.array(size, float), prepared, np.concatenate(moved))


@dataclass(frozen=True)
class _Errors:
    """Signed errors and half-widths ``[m t]`` of the targets that the model reads, in their units."""

    error: Values
    half: Values

    @property
    def scaled(self) -> Values:
        return self.error / self.half

    @property
    def beyond(self) -> np.ndarray:
        return np.abs(self.scaled) > BEYOND


def _errors(suite: Suite, rows: Indices, moved: Float[np.ndarray, "_ _"]) -> _Errors:
    """Errors of held-out estimates that a change has moved; one that is no finite number counts as huge."""
    outputs = suite.held_out[rows] + moved
    low, high = suite.intervals.ends(outputs)
    half = np.maximum((high - low) / 2, np.finfo(np.float32).tiny)
    huge = float(np.finfo(np.float32).max)
    error = suite.intervals.errors(outputs, suite.job.data.values[rows])
    return _Errors(np.nan_to_num(error, nan=huge, posinf=huge)[:, suite.read], half[:, suite.read])


def _turns(periods: Sequence[float | None], changed: _Errors) -> Values:
    """Each target's period in half-widths ``[m t]``; infinite for plain targets and estimates not finite."""
    period = np.array([np.inf if one is None else one for one in periods])
    return np.where(np.abs(changed.error) <= period, period / changed.half, np.inf)


def _harm(
    unchanged: Values, moved: Float[np.ndarray, "m t"], turns: Float[np.ndarray, "m t"]
) -> Float[np.ndarray, " m"]:
    usual = np.mean(np.abs(unchanged) > BEYOND, axis=0)
    pairs = zip(np.nan_to_num(moved), turns, strict=True)
    shares = np.stack([np.mean(_shortest(unchanged + far, turn) > BEYOND, axis=0) for far, turn in pairs])
    return np.asarray(np.mean(np.maximum(shares - usual, 0.0), axis=1))


def _shortest(error: Values, turn: Float[np.ndarray, " t"]) -> Values:
    """Size of errors the shortest way round ``[n t]``: 359 degrees off is 1 degree off."""
    whole = np.isfinite(turn)
    size = np.abs(error)
    size[:, whole] = np.abs((error[:, whole] + turn[whole] / 2) % turn[whole] - turn[whole] / 2)
    return size


def _examples(
    suite: Suite,
    detector: NoveltyDetector,
    rows: Indices,
    tried: Tried,
    harm: Float[np.ndarray, " m"],
    learnt: Indices,
) -> tuple[ChangeExamples, Registration]:
    """Features and novelty of unchanged and changed frames, each compared with thumbnails of other folds
    alone; trained frames that were not scored count as unchanged.
    """
    frame = np.concatenate([rows, tried.row, learnt])
    prepared = [*_prepared(suite, rows), *tried.prepared, *_prepared(suite, learnt)]
    thumbs = [thumbnail(image) for image in prepared]
    changed = slice(len(rows), len(rows) + len(tried.row))
    registration = Registration.fit(np.delete(np.stack(thumbs), changed, axis=0))
    novelty, unlike = _novelty(suite, detector, frame, thumbs)
    features = [
        frame_features(image, thumb, registration, other)
        for image, thumb, other in zip(prepared, thumbs, unlike, strict=True)
    ]
    names = tuple(dict.fromkeys(tried.kind.tolist()))
    kind, all_harm = np.zeros(len(frame), np.int64), np.zeros(len(frame))
    kind[changed], all_harm[changed] = [names.index(name) + 1 for name in tried.kind], harm
    examples = ChangeExamples(np.stack(features), frame, kind, all_harm, novelty, names, local=True)
    return examples, registration


def _novelty(
    suite: Suite, detector: NoveltyDetector, frame: Indices, thumbs: list[np.ndarray]
) -> tuple[Float[np.ndarray, " m"], list[np.ndarray]]:
    kept, total = kept_rows(len(suite.job.whole), suite.job.plan.seed), len(detector.neighbours.thumbs)
    novelty, unlike = np.empty(len(frame)), [np.empty(0)] * len(frame)
    for rows, whole in zip(suite.job.parts.folds, suite.job.folds_of_whole(), strict=True):
        own = np.flatnonzero(np.isin(kept, whole))
        others = replace(detector, neighbours=detector.neighbours.among(np.setdiff1d(np.arange(total), own)))
        for i in np.flatnonzero(np.isin(frame, rows)):
            novelty[i], unlike[i] = others.novelty(thumbs[i])
    return novelty, unlike


def _card(
    rows: Indices, tried: Tried, unchanged: _Errors, changed: _Errors, refused: np.ndarray
) -> RobustnessCard:
    own = {int(row): i for i, row in enumerate(rows)}
    before = np.abs(unchanged.error[[own[int(row)] for row in tried.row]])
    refused_changed, table, wrong = refused[len(rows) :], [], []
    for kind, size in dict.fromkeys(zip(tried.kind.tolist(), tried.size.tolist(), strict=True)):
        cell = (tried.kind == kind) & (tried.size == size)
        beyond, error = changed.beyond[cell], np.abs(changed.error[cell])
        usual = np.maximum(before[cell].mean(axis=0), np.finfo(np.float32).tiny)
        row = PerturbationCard(
            kind=kind,
            size=size,
            unit=KINDS[kind].unit,
            frames=int(cell.sum()),
            error_ratio=_rounded(np.mean(error.mean(axis=0) / usual)),
            covered=_rounded(np.mean(np.abs(changed.scaled[cell]) <= 1)),
            beyond=_rounded(beyond.mean()),
            refused=_rounded(refused_changed[cell].mean()),
            silent=_rounded(np.mean(beyond & ~refused_changed[cell][:, None])),
            passes=False,
        )
        table.append(row)
        wrong.append(int((beyond.any(axis=1) & ~refused_changed[cell]).sum()))
    false, beyond_usually = float(refused[: len(rows)].mean()), float(unchanged.beyond.mean())
    wrong_usually = int((unchanged.beyond.any(axis=1) & ~refused[: len(rows)]).sum())
    often = _more_often(wrong, [row.frames for row in table], wrong_usually, len(rows))
    table = [
        row.model_copy(update={"passes": bool(more and row.silent > beyond_usually + MAX_SILENT)})
        for row, more in zip(table, often, strict=True)
    ]
    return RobustnessCard(
        text=_text(table, len(rows), false, beyond_usually),
        frames=len(rows),
        refused=_rounded(false),
        beyond=_rounded(beyond_usually),
        table=tuple(table),
    )


def _more_often(wrong: Sequence[int], frames: Sequence[int], usual: int, unchanged: int) -> list[bool]:
    """Changes in which frames are wrong significantly more often, by Fisher's exact test and Holm's
    procedure.
    """
    tables = [[[k, n - k], [usual, unchanged - usual]] for k, n in zip(wrong, frames, strict=True)]
    p = np.array([fisher_exact(table, alternative="greater").pvalue for table in tables])
    order, often = np.argsort(p), np.zeros(len(p), bool)
    for rank, k in enumerate(order):
        if p[k] > SIGNIFICANCE / (len(p) - rank):
            break
        often[k] = True
    return [bool(one) for one in often]


def _rounded(value: float | np.floating) -> float:
    """Four significant digits: more say nothing, and make a card long."""
    return float(f"{float(value):.4g}")


def _text(table: list[PerturbationCard], frames: int, refused: float, beyond: float) -> str:
    kinds, count = len({cell.kind for cell in table}), table[0].frames
    silent = float(np.mean([cell.silent for cell in table]))
    free = [c.refused for c in table if c.error_ratio < MAX_SLIGHT and c.beyond <= beyond + MAX_HARM]
    accepted = f"{100 * (1 - np.mean(free)):.0f} % of such frames pass" if free else "none was found"
    passing = [f"{c.kind} of {c.size:g} {c.unit}" for c in table if c.passes]
    return (
        f"{kinds} kinds of change at five sizes were tried on {count} held-out frames a size, beside "
        f"{frames} unchanged ones, of which the guard refuses {100 * refused:.1f} %. Readings that pass it "
        f"and err by more than twice their half-width: {100 * silent:.1f} % over all changes, "
        f"{100 * beyond:.1f} % of unchanged frames. Changes that raise the error by less than 10 %, and the "
        f"share of such readings by no more than {100 * MAX_HARM:.0f} %: {accepted}. Changes that pass wrong "
        f"significantly too often: {', '.join(passing) or 'none was found'}; {count} frames tell a single "
        "size's share roughly"
    )


MAX_SLIGHT = 1.1  # error over unchanged frames' below which a change costs less than 10 %
MAX_SILENT = 0.02  # ratio by which undetected wrong readings may exceed unchanged frames'
SIGNIFICANCE = 0.05  # probability of naming a harmless change
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


TOGETHER = 12  # neighboring frames of the former calibration that are held out together


def former_frames(estimator: Estimator) -> RenderedImages:
    """Return the thumbnails that a calibration's guard keeps, neighboring presses together."""
    kept = NoveltyDetector.load(checked_file(estimator.folder, estimator.card.guard)).neighbours.thumbs
    return RenderedImages(kept, np.arange(len(kept)) // TOGETHER)


def guard_of(
    suite: Suite, progress: Progress = silent, former: RenderedImages | None = None
) -> tuple[NoveltyDetector, RobustnessCard]:
    """Return the guard of a calibration, tested on camera changes, with its card.

    Args:
        suite: frames, with held-out outputs of the network.
        former: thumbnails that the guard of an adapted calibration keeps; they are kept if they are similar.
            None for a new calibration, where images that the model rendered take their place.
    """
    job, fitted = suite.job, suite.fitted
    progress("learning what frames look like", 0, 1)
    thumbs = job.thumbnails()
    rendered = fitted.rendered_images if isinstance(fitted, LearnsFromRendered) else None
    also = rendered if former is None else former
    detector = fit_novelty_detector(
        thumbs, job.folds_of_whole(), thumbs[job.untouched.rows], also=also, seed=job.plan.seed
    )
    progress("learning what frames look like", 1, 1)
    if former is not None:
        suite = replace(suite, job=replace(job, parts=_in_few_folds(job.parts)))
    with plugin_calls(
        f"model {job.plan.model}: predict failed on a changed frame ({ERROR})", passed_errors(job.plan)
    ):
        return try_changes(suite, detector, progress)


def _in_few_folds(parts: Split) -> Split:
    count = min(MAX_FOLDS, len(parts.folds))
    return replace(parts, folds=tuple(np.concatenate(parts.folds[k::count]) for k in range(count)))
