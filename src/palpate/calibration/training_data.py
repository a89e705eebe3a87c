"""Training data from a packed recording: rows to learn from, their values, groups, references and inputs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from palpate.calibration.calibration_plan import SESSION, CalibrationPlan, ReferenceRule
from palpate.calibration.classes import target_values
from palpate.core import Bool, Float32, Indices, InputError, Int, LabelError, Shaped, Tensor
from palpate.estimators.guard import thumbnails
from palpate.estimators.networks.model_interface import TrainingData
from palpate.recordings import Manifest, PackedSet, Split

Box = tuple[int, int, int, int]


def model_regions(manifest: Manifest, names: tuple[str, ...]) -> tuple[Box, ...]:
    """Regions of a frame that a model was made for, in its order.

    Args:
        manifest: of the run, which names its regions.
        names: of a model's regions, see `estimators.networks.Kind`.

    Raises:
        InputError: the run does not name all of them.
    """
    regions = manifest.regions
    if not set(names) <= set(regions):
        named = ", ".join(regions) or "none"
        raise InputError(
            f"this model sees two parts of a frame, {' and '.join(names)}, and the run names {named}; "
            f"give --crop X,Y,WIDTH,HEIGHT twice, the {names[0]} first"
        )
    return tuple(regions[name] for name in names)


FLAG_COLUMNS = ("reference", "no_contact", "untouched")
"""Label columns of yes and no that mark frames of the untouched sensor without being asked for."""

BATCH = 256


@dataclass(frozen=True)
class Untouched:
    """The frames of the untouched sensor.

    Attributes:
        rows: which rows they are.
        groups: ``[n]`` number of the reference that each row of the recording belongs to.
        images: ``[g c h w]`` mean image of each reference, grey levels.
        rule: how they were found; None where there are none.
    """

    rows: Int[np.ndarray, " r"]
    groups: Int[np.ndarray, " n"]
    images: Float32[np.ndarray, "g c h w"]
    rule: ReferenceRule | None


def rows_matching(table: pd.DataFrame, rule: ReferenceRule) -> Bool[np.ndarray, " n"]:
    """Rows that a reference rule names, as a mask.

    Raises:
        LabelError: the rule's columns are not there, or no row matches.
    """
    for name in (rule.column, *rule.by):
        if name not in table:
            raise LabelError(f"reference column {name!r} is not among the labels: {', '.join(table.columns)}")
    column = table[rule.column]
    try:
        mask = (pd.to_numeric(column) == float(rule.value)).to_numpy()
    except (TypeError, ValueError):
        mask = (column.astype(str).str.lower() == rule.value.lower()).to_numpy()
    if not mask.any():
        raise LabelError(f"no row has {rule.column}={rule.value}; the untouched sensor was not recorded")
    return mask


def default_rule(table: pd.DataFrame) -> ReferenceRule | None:
    """The rule of a conventional flag column, where one is there and marks any row."""
    for column in FLAG_COLUMNS:
        if column in table and table[column].astype(str).str.lower().eq("true").any():
            return ReferenceRule(column, "true")
    return None


def _rule(table: pd.DataFrame, plan: CalibrationPlan) -> ReferenceRule | None:
    """The plan's rule, or the conventional one.

    Raises:
        LabelError: there is none, and the plan is differential.
    """
    rule = plan.reference or default_rule(table)
    if rule is None and plan.delta:
        raise LabelError(
            "a differential calibration needs frames of the untouched sensor; say which rows they are "
            f"with --reference COLUMN=VALUE, or label them in a column {' or '.join(FLAG_COLUMNS)}"
        )
    return None if rule is None else _rule_by_session(table, rule, plan)


def _rule_by_session(table: pd.DataFrame, rule: ReferenceRule, plan: CalibrationPlan) -> ReferenceRule:
    """The rule, each session with a reference of its own: a sensor that was mounted again rests otherwise.

    Raises:
        LabelError: the plan is differential, and a session has no frame of the untouched sensor.
    """
    if SESSION not in table or SESSION in rule.by:
        return rule
    sessions = table[SESSION].astype(str)
    without = sorted(set(sessions) - set(sessions[rows_matching(table, rule)]))
    if without and plan.delta:
        raise LabelError(
            f"session {without[0]} has no row with {rule.column}={rule.value}; a differential calibration "
            "needs frames of the untouched sensor from each session: leave the session out, or learn from "
            "the frames themselves (--raw)"
        )
    return rule if without else replace(rule, by=(SESSION, *rule.by))


def rows_to_learn(table: pd.DataFrame, plan: CalibrationPlan) -> Indices:
    """Rows to learn from: all but those of the untouched sensor, where a press has no place or shape.

    Raises:
        LabelError: the plan's reference names columns or rows that are not there.
    """
    rule = _rule(table, plan)
    if rule is None or plan.learn_untouched:
        return np.arange(len(table))
    return np.flatnonzero(~rows_matching(table, rule))


def table_to_learn(table: pd.DataFrame, plan: CalibrationPlan) -> pd.DataFrame:
    """Labels of these rows, numbered anew."""
    return table.iloc[rows_to_learn(table, plan)].reset_index(drop=True)


def find_untouched(packed: PackedSet, plan: CalibrationPlan) -> Untouched:
    """Find and average the no-contact frames.

    Raises:
        LabelError: the plan is differential and there are none, or a group has none of its own.
    """
    table = packed.table
    rule = _rule(table, plan)
    nothing = np.zeros(len(table), dtype=np.int64)
    if rule is None:
        return Untouched(nothing[:0], nothing, np.empty((0, *packed.preparation.shape), np.float32), None)
    rows = np.flatnonzero(rows_matching(table, rule))
    groups = table.groupby(list(rule.by), sort=False).ngroup().to_numpy() if rule.by else nothing
    return Untouched(rows, groups, _mean_images(packed, rows, groups, rule), rule)


def _mean_images(
    packed: PackedSet, rows: np.ndarray, groups: np.ndarray, rule: ReferenceRule
) -> Float32[np.ndarray, "g c h w"]:
    images = np.zeros((groups.max() + 1, *packed.preparation.shape), np.float32)
    counts = np.bincount(groups[rows], minlength=len(images))
    if not counts.all():
        lost = packed.table[list(rule.by)].iloc[int(np.flatnonzero(counts[groups] == 0)[0])].to_dict()
        raise LabelError(
            f"group {lost} has no row with {rule.column}={rule.value}; drop it or reference by less"
        )
    for row in rows:
        images[groups[row]] += packed.read(np.array([row]))[0].transpose(2, 0, 1) / counts[groups[row]]
    return images


@dataclass(frozen=True)
class LearningSet:
    """Packed rows to learn from, beside all that were packed.

    Attributes:
        whole: every frame, those of the untouched sensor too.
        rows: rows of `whole` to learn from.
        packed: these rows, numbered anew.
        untouched: references, for every row of `whole`.
        data: inputs, values and groups of `packed`.
    """

    whole: PackedSet
    rows: Indices
    packed: PackedSet
    untouched: Untouched
    data: TrainingData

    def thumbnails(self) -> np.ndarray:
        """Thumbnails of every frame ``[n h w c]``, few images in memory at a time."""
        return thumbnails(
            frame for batch in self.whole.batches(np.arange(len(self.whole)), BATCH) for frame in batch
        )

    def folds_of_whole(self, parts: Split) -> list[Indices]:
        """Folds in rows of `whole`; rows that are not learnt from are dealt out to them."""
        others = np.setdiff1d(np.arange(len(self.whole)), self.rows)
        return [
            np.append(self.rows[fold], others[k :: len(parts.folds)]) for k, fold in enumerate(parts.folds)
        ]


def learning_set(
    whole: PackedSet, plan: CalibrationPlan, groups: Shaped[np.ndarray, " n"] | None, source: str
) -> LearningSet:
    """Select the rows to learn from.

    Args:
        whole: all frames, packed.
        plan: targets, reference, and whether inputs are differences from it.
        groups: label of each row's group, of the rows to learn from; None where each row is its own.
        source: name of the recording, for messages.

    Raises:
        LabelError, UnitError: a target column is missing, not a number, constant, or has no unit; or there
            is no untouched frame and the plan needs one.
    """
    rows, untouched = rows_to_learn(whole.table, plan), find_untouched(whole, plan)
    packed, references = whole.only(rows), untouched.groups[rows]

    def fetch(chosen: Indices) -> Tensor:
        inputs = packed.read(chosen).transpose(0, 3, 1, 2).astype(np.float32)
        if plan.delta:
            inputs -= untouched.images[references[chosen]]
        return np.ascontiguousarray(inputs)

    values = target_values(packed.table, plan.targets, source)
    groups = np.arange(len(rows)) if groups is None else groups
    data = TrainingData(packed.preparation.shape, values, groups, fetch, tuple(plan.targets))
    return LearningSet(whole, rows, packed, untouched, data)
