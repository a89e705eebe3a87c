"""Which parts of a frame a model sees, where nobody says so: the regions that it was made for.

From a packed recording to what a model learns from: values, groups, references, inputs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from palpate.calibration.calibration_plan import CalibrationPlan, ReferenceRule
from palpate.core import Bool, Float32, Indices, InputError, Int, LabelError, Shaped, Tensor
from palpate.estimators.networks.model_interface import TrainingData
from palpate.recordings.labels import targets_from
from palpate.recordings.manifest import Manifest
from palpate.recordings.packed_set import PackedSet

Box = tuple[int, int, int, int]


def regions_seen(manifest: Manifest, names: tuple[str, ...]) -> tuple[Box, ...]:
    """The regions of these names, in their order.

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

    def of(self, rows: Indices) -> Untouched:
        """The same references for some of the rows, numbered anew."""
        return replace(self, groups=self.groups[rows])


def marked(table: pd.DataFrame, rule: ReferenceRule) -> Bool[np.ndarray, " n"]:
    """Rows that a reference rule names.

    Raises:
        LabelError: the rule's columns are not there, or no row matches.
    """
    for column in (rule.column, *rule.by):
        if column not in table:
            raise LabelError(
                f"reference column {column!r} is not among the labels: {', '.join(table.columns)}"
            )
    held = table[rule.column]
    try:
        found = (pd.to_numeric(held) == float(rule.value)).to_numpy()
    except (TypeError, ValueError):
        found = (held.astype(str).str.lower() == rule.value.lower()).to_numpy()
    if not found.any():
        raise LabelError(f"no row has {rule.column}={rule.value}; the untouched sensor was not recorded")
    return found


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
    return rule


def rows_to_learn(table: pd.DataFrame, plan: CalibrationPlan) -> Indices:
    """Rows to learn from: all but those of the untouched sensor, where a press has no place or shape.

    Raises:
        LabelError: the plan's reference names columns or rows that are not there.
    """
    rule = _rule(table, plan)
    if rule is None or plan.learn_untouched:
        return np.arange(len(table))
    return np.flatnonzero(~marked(table, rule))


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
    rows = np.flatnonzero(marked(table, rule))
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


def training_data(
    packed: PackedSet,
    plan: CalibrationPlan,
    groups: Shaped[np.ndarray, " n"],
    untouched: Untouched,
    source: str,
) -> TrainingData:
    """What a model learns from.

    Raises:
        LabelError, UnitError: a target column is missing, not a number, constant, or has no unit.
    """

    def fetch(rows: Indices) -> Tensor:
        inputs = packed.read(rows).transpose(0, 3, 1, 2).astype(np.float32)
        if plan.delta:
            inputs -= untouched.images[untouched.groups[rows]]
        return np.ascontiguousarray(inputs)

    values = targets_from(packed.table, plan.targets, source)
    return TrainingData(packed.preparation.shape, values, groups, fetch, tuple(plan.targets))


def prepared_images(packed: PackedSet, rows: Indices) -> Iterator[np.ndarray]:
    """Prepared images ``[h w c]`` of the rows, one at a time, few in memory."""
    for start in range(0, len(rows), BATCH):
        yield from packed.read(rows[start : start + BATCH])
