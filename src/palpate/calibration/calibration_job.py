"""The one object that a calibration's fitting, scoring, audits, and report read from: rows, groups, folds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from palpate.calibration.calibration_plan import (
    SESSION,
    CalibrationPlan,
    ReferenceRule,
    check_vector_names,
)
from palpate.calibration.classes import (
    ClassLabels,
    check_learnable,
    class_labels,
    target_values,
    with_classes,
)
from palpate.calibration.coverage.range_scores import refuse_no_angles
from palpate.core import (
    Bool,
    Float32,
    ImageError,
    Indices,
    InputError,
    Int,
    LabelError,
    Progress,
    SplitError,
    Tensor,
    Values,
    split_column,
)
from palpate.estimators.guard import thumbnails
from palpate.estimators.model_card import Card
from palpate.estimators.networks import make_model, model_kind
from palpate.estimators.networks.model_interface import TrainingData
from palpate.recordings import Manifest, PackedSet, Run, Split, pack, split
from palpate.recordings.joined_runs import check_instruments
from palpate.recordings.label_tables import refuse_reserved
from palpate.recordings.preparation import Preparation
from palpate.recordings.splits import conventional_groups, group_names, within_session

Box = tuple[int, int, int, int]


def model_regions(manifest: Manifest, names: tuple[str, ...]) -> tuple[Box, ...]:
    """Return the frame regions that a model was made for, in its order."""
    regions = manifest.regions
    if not set(names) <= set(regions):
        named = ", ".join(regions) or "none"
        raise InputError(
            f"this model sees two parts of a frame, {' and '.join(names)}, and the run names {named}; "
            f"give --crop X,Y,WIDTH,HEIGHT twice, the {names[0]} first"
        )
    return tuple(regions[name] for name in names)


FLAG_COLUMNS = ("reference", "no_contact", "untouched")  # flags that mark no-contact frames by default
BATCH = 256


@dataclass(frozen=True)
class Untouched:
    """No-contact frames.

    Attributes:
        rows: their row numbers.
        groups: reference that each row of the recording belongs to ``[n]``.
        images: mean image of each reference ``[g c h w]`` [grey levels].
        rule: how they were found; None where there are none.
    """

    rows: Int[np.ndarray, " r"]
    groups: Int[np.ndarray, " n"]
    images: Float32[np.ndarray, "g c h w"]
    rule: ReferenceRule | None


def rows_matching(table: pd.DataFrame, rule: ReferenceRule) -> Bool[np.ndarray, " n"]:
    """Return the mask of rows that a reference rule names."""
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
    """Return the rule of a conventional flag column that marks any row."""
    for column in FLAG_COLUMNS:
        if column in table and table[column].astype(str).str.lower().eq("true").any():
            return ReferenceRule(column, "true")
    return None


def _rule(table: pd.DataFrame, plan: CalibrationPlan) -> ReferenceRule | None:
    rule = plan.reference or default_rule(table)
    if rule is None and plan.delta:
        raise LabelError(
            "a differential calibration needs frames of the untouched sensor; say which rows they are "
            f"with --reference COLUMN=VALUE, or label them in a column {' or '.join(FLAG_COLUMNS)}"
        )
    return None if rule is None else _rule_by_session(table, rule, plan)


def _rule_by_session(table: pd.DataFrame, rule: ReferenceRule, plan: CalibrationPlan) -> ReferenceRule:
    """Give each session a reference of its own: a sensor that was mounted again rests otherwise."""
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
    """Return the rows to train on: all but no-contact rows, unless the plan includes them."""
    rule = _rule(table, plan)
    if rule is None or plan.learn_untouched:
        return np.arange(len(table))
    return np.flatnonzero(~rows_matching(table, rule))


def table_to_learn(table: pd.DataFrame, plan: CalibrationPlan) -> pd.DataFrame:
    """Return the labels of the training rows, renumbered."""
    return table.iloc[rows_to_learn(table, plan)].reset_index(drop=True)


def find_untouched(packed: PackedSet, plan: CalibrationPlan) -> Untouched:
    """Find and average the no-contact frames."""
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
class CalibrationJob:
    """Rows, labels, groups, sessions, and folds of a calibration.

    Attributes:
        whole: every frame, packed, including no-contact frames.
        rows: rows of `whole` to train on.
        packed: these rows, renumbered.
        untouched: references, for every row of `whole`.
        data: inputs, values ``[n t]``, and groups of `packed`.
    """

    run: Run
    plan: CalibrationPlan
    parts: Split
    whole: PackedSet
    rows: Indices
    packed: PackedSet
    untouched: Untouched
    data: TrainingData
    classes: tuple[ClassLabels, ...] = ()

    @classmethod
    def of(
        cls,
        run: Run,
        plan: CalibrationPlan,
        parts: Split,
        whole: PackedSet,
        classes: tuple[ClassLabels, ...] = (),
    ) -> CalibrationJob:
        rows, untouched = rows_to_learn(whole.table, plan), find_untouched(whole, plan)
        packed = whole.only(rows)
        references = untouched.groups[rows]

        def fetch(chosen: Indices) -> Tensor:
            inputs = packed.read(chosen).transpose(0, 3, 1, 2).astype(np.float32)
            if plan.delta:
                inputs -= untouched.images[references[chosen]]
            return np.ascontiguousarray(inputs)

        values = target_values(packed.table, plan.targets, str(run.path))
        groups = np.arange(len(rows)) if parts.groups is None else parts.groups
        data = TrainingData(packed.preparation.shape, values, groups, fetch, tuple(plan.targets))
        return cls(run, plan, parts, whole, rows, packed, untouched, data, classes)

    @classmethod
    def packed_in(
        cls, folder: Path, run: Run, plan: CalibrationPlan, parts: Split, progress: Progress
    ) -> CalibrationJob:
        """Pack the frames into a folder, unless an interrupted run has done so."""
        if not folder.exists():
            pack(run, folder, preparation_of(run, plan), lambda done, of: progress("packing", done, of))
        packed = PackedSet.open(folder)
        return cls.of(run, plan, parts, packed, _classes_of(run, plan, table_to_learn(packed.table, plan)))

    @property
    def table(self) -> pd.DataFrame:
        """Labels of `packed`."""
        return self.packed.table

    @cached_property
    def outputs(self) -> TrainingData:
        """The rows with the labels as the model's outputs ``[n o]``, those of classes last."""
        layout = self.plan.layout
        values = with_classes(layout.encoded(self.data.values), self.classes)
        names = layout.names(self.data.names) + tuple(n for one in self.classes for n in one.output_names)
        return replace(self.data, values=values, names=names)

    @cached_property
    def fold_of(self) -> Indices:
        """Number of the fold that each row is held out in ``[n]``."""
        fold = np.empty(len(self.packed), np.int64)
        for k, rows in enumerate(self.parts.folds):
            fold[rows] = k
        return fold

    @property
    def in_recorded_order(self) -> bool:
        """Whether rows lie in the order in which they were recorded."""
        return self.run.manifest.order == "recorded"

    @cached_property
    def sessions(self) -> np.ndarray | None:
        """Name of each row's session ``[n]`` where sessions are to be held out; None otherwise."""
        asked = SESSION in self.parts.group_columns and SESSION in self.table
        return group_names(self.table, (SESSION,)) if asked else None

    def thumbnails(self) -> np.ndarray:
        """Thumbnails of every frame ``[n h w c]``, few images in memory at a time."""
        return thumbnails(
            frame for batch in self.whole.batches(np.arange(len(self.whole)), BATCH) for frame in batch
        )

    def folds_of_whole(self) -> list[Indices]:
        """Folds in rows of `whole`; rows that are not trained on are dealt out to them."""
        others, folds = np.setdiff1d(np.arange(len(self.whole)), self.rows), self.parts.folds
        return [np.append(self.rows[fold], others[k :: len(folds)]) for k, fold in enumerate(folds)]


MIN_LEARNT = 5  # least rows to train on in each fold


def split_rows(run: Run, plan: CalibrationPlan) -> Split:
    """Check a run against a plan, and split its training rows into folds."""
    if len(run) < 10:
        raise InputError(
            f"{run.path} holds {len(run)} frames; a calibration needs 10 or more", code="few-frames"
        )
    refuse_reserved(list(run.manifest.labels), str(run.path))
    check_instruments(run, plan.targets, plan.instruments)
    check_vector_names(plan.vectors, run.manifest.labels, str(run.path))
    make_model(plan.model, plan.options)
    preparation_of(run, plan).apply(run.frame(0).image)
    table = table_to_learn(run.labels, plan)
    values = target_values(table, plan.targets, str(run.path))
    for column, period, column_values in zip(plan.targets, plan.layout.periods, values.T, strict=True):
        if period is not None:
            refuse_no_angles(column, column_values, split_column(column)[1].symbol, period)
    classes = _classes_of(run, plan, table)
    others = table.drop(columns=list(plan.classes)) if plan.split == "auto" else table
    parts = split(others, plan.split, folds=fold_count(plan), seed=plan.seed)
    _refuse_fewer_folds(plan, parts)
    check_learnable(classes, parts)
    names = tuple(name for one in classes for name in one.output_names)
    check_sessions(table, with_classes(values, classes), (*plan.targets, *names), parts)
    _refuse_few_to_learn(parts, len(table))
    return parts


def fold_count(plan: CalibrationPlan) -> int:
    """Return the number of folds: five, or eight for a costly model."""
    return plan.folds or (8 if model_kind(plan.model).costly else 5)


def _classes_of(run: Run, plan: CalibrationPlan, table: pd.DataFrame) -> tuple[ClassLabels, ...]:
    hint = (
        ""
        if len(table) == len(run)
        else " (rows of the untouched sensor are learnt from by --learn-untouched)"
    )
    return class_labels(table, plan.classes, str(run.path), hint=hint)


def _refuse_fewer_folds(plan: CalibrationPlan, parts: Split) -> None:
    """Raise where a split makes fewer folds than were asked for; the default takes what there is."""
    made = len(parts.folds)
    if plan.folds is not None and plan.folds > made:
        column = f" of {' and '.join(parts.group_columns)}" if parts.group_columns else ""
        raise SplitError(
            f"{plan.folds} folds were asked for, and split {plan.split!r} makes {made} here, by {made} "
            f"groups{column}: ask for at most {made}, for none in particular, or for another split",
            code="few-groups",
        )


def _refuse_few_to_learn(parts: Split, rows: int) -> None:
    """Raise where a fold leaves next to nothing to learn from, as where all but one row is one session."""
    largest = max(len(fold) for fold in parts.folds)
    if rows - largest < MIN_LEARNT:
        raise SplitError(
            f"split {parts.kind}: one fold holds out {largest} of {rows} rows, and {rows - largest} are left "
            f"to train on; {MIN_LEARNT} or more are needed: record more of the other groups, or split "
            "otherwise",
            code="split-trains-few",
        )


def check_sessions(table: pd.DataFrame, values: Values, columns: Sequence[str], split: Split) -> None:
    """Refuse to hold out sessions whose labels cannot name sessions.

    Args:
        values: targets ``[n t]``, named `columns`.
    """
    if SESSION not in table or SESSION not in split.group_columns:
        return
    sessions = group_names(table, (SESSION,))
    names = np.unique(sessions)
    if len(names) < 2:
        return
    remedy = "name what was recorded without re-mounting the sensor, such as the day, or use --split random"
    for column in columns:
        if column in table and np.array_equal(sessions, group_names(table, (column,))):
            raise SplitError(f"label 'session' repeats target {column!r}; {remedy}", code="session-is-target")
    if 2 * len(names) > len(sessions):
        raise SplitError(
            f"label 'session' has {len(names)} values in {len(sessions)} rows: it numbers rows; {remedy}",
            code="session-numbers-rows",
        )
    spelt: dict[str, str] = {}
    for name in map(str, names):
        first = spelt.setdefault("".join(name.split()).casefold(), name)
        if first != name:
            raise SplitError(
                f"sessions {first!r} and {name!r} are one name in two spellings; use one",
                code="session-spelling",
            )
    for column, target in zip(columns, values.T, strict=True):
        if share_between(target, sessions) > 1 - 1e-9:
            raise SplitError(
                f"target {column!r} has one value in each session, which no other session contains. Record "
                "each session over the whole range, or split within sessions (--split blocks)",
                code="session-is-target",
            )


def share_between(target: np.ndarray, sessions: np.ndarray) -> float:
    """Return the ratio of a target's variance ``[n]`` between the sessions' means (eta squared)."""
    _, of = np.unique(sessions, return_inverse=True)
    means = np.bincount(of, weights=target) / np.bincount(of)
    variance = float(np.var(target))
    return float(np.var(means[of])) / variance if variance > 0 else 0.0


def preparation_of(run: Run, plan: CalibrationPlan) -> Preparation:
    """Return the preparation a plan asks for.

    Without a size, the input has as many pixels as the model's own square one, in the proportions of frame or
    crop.
    """
    if plan.size_px is not None:
        return Preparation(plan.crop_px, plan.size_px, plan.channels, plan.beside_px, plan.lens)
    side = model_kind(plan.model).side_px
    if plan.beside_px is not None:
        return Preparation(plan.crop_px, (side, 2 * side), plan.channels, plan.beside_px, plan.lens)
    height, width = plan.crop_px[:1:-1] if plan.crop_px else run.frame(0).image.shape[:2]
    tall = math.sqrt(height / width)
    size = round(side * tall), round(side / tall)
    return Preparation(plan.crop_px, size, plan.channels, lens=plan.lens)


HELD_OUT_WHOLE = (SESSION, "sensor", "copy")  # columns of which a new group is predicted, the coarsest first


def has_gaps(table: pd.DataFrame, columns: tuple[str, ...]) -> bool:
    """Return whether a cell of these columns is empty."""
    cells = table[list(columns)]
    return bool(cells.isna().to_numpy().any() or (cells.astype(str) == "").to_numpy().any())


def is_grouped(table: pd.DataFrame) -> bool:
    """Return whether a conventional column without gaps groups the rows."""
    return any(
        not has_gaps(table, columns) and 1 < len(np.unique(group_names(table, columns))) < len(table)
        for columns in conventional_groups(table)
    )


def finest_columns(table: pd.DataFrame) -> tuple[str, ...]:
    """Return the finest conventional columns without gaps that group rows, such as the press."""
    finer = [columns for columns in conventional_groups(table) if columns[0] not in HELD_OUT_WHOLE]
    whole = [columns for columns in finer if not has_gaps(table, columns)]
    return within_session(table, whole[-1]) if whole else ()


def groups_within(table: pd.DataFrame) -> Indices:
    """Return each row's finest conventional group ``[n]``; each row its own where there is none."""
    columns = finest_columns(table)
    if not columns:
        return np.arange(len(table))
    return np.unique(group_names(table, columns), return_inverse=True)[1]


def presses_of(table: pd.DataFrame, parts: Split) -> Indices | None:
    """Return the press number of each row ``[n]``; None where no column states it.

    A split's own groups are presses too, unless they are whole sessions or blocks of temporal order.
    """
    named = [groups_within(table)] if finest_columns(table) else []
    fine = parts.groups is not None and parts.block_rows is None
    if fine and (not parts.group_columns or set(parts.group_columns) - set(HELD_OUT_WHOLE)):
        named.append(np.unique(np.asarray(parts.groups), return_inverse=True)[1])
    if not named:
        return None
    return np.unique(np.column_stack(named), axis=0, return_inverse=True)[1].ravel()


def recordings_of(table: pd.DataFrame) -> np.ndarray | None:
    """Return the session, sensor, and unit of each row ``[n]``; None where no column states them."""
    columns = tuple(c for c in HELD_OUT_WHOLE if c in table and not has_gaps(table, (c,)))
    return group_names(table, columns) if columns else None


def refuse_other_size(run: Run, card: Card, rows: Sequence[int]) -> None:
    """Raise `ImageError` for a frame whose size differs from the calibration's."""
    height, width = card.input.frame_px
    for row in rows:
        shape = run.frame(int(row)).image.shape
        if shape[:2] != (height, width):
            raise ImageError(
                f"{run.path}: frame {row} is {shape[1]}x{shape[0]} px, the calibration is for "
                f"{width}x{height} px; record with the same camera settings, or calibrate anew",
                code="frame-size",
            )


def rule_in_run(card: Card, run: Run) -> ReferenceRule | None:
    """Return a calibration's no-contact rule; None where it has none, or the run has no such rows."""
    rule = ReferenceRule.of_card(card)
    if rule is None:
        return None
    rule = rule.for_columns(run.labels.columns)
    try:
        rows_matching(run.labels, rule)
    except LabelError as e:
        if card.input.delta:
            raise LabelError(
                f"{run.path}: {e}; this calibration subtracts the untouched sensor, so that each unit and "
                f"session needs frames of its own, labeled {rule.column}={rule.value}"
            ) from e
        return None
    return rule
