"""The table of one press: force, perhaps position and area, and which sample each frame is of.

Two layouts are read. Where the force sensor is faster than the camera, a row is a sample and the column
``frame`` says which frame was the latest; a frame belongs to the first row that names it. Where a row is a
frame, ``frame`` may be left out. The first is also written.

The contact's area is read where there is one: ``true_area_mm2`` is a simulator's own truth, ``area_mm2`` what
a rig measured beside the sensor, by ink or by light. Cells without one are left empty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from palpate.core import Float, Int, LabelError, RangeError, has_unit, ndarray, split_column
from palpate.recordings.label_tables import label_kinds, read_labels, rows_text

FORCES = ("force_raw_N", "force_N", "Fz_N", "fz_N")
POSITIONS = ("actual_mm", "position_mm", "depth_mm", "gripper_width_m")
AREAS = ("true_area_mm2", "area_mm2")
TIMES = ("time_s", "t_s")
FRAME = "frame"
START = 5  # samples that tell which way the force goes
TAPS = 5  # of the moving average that the report's rig writes beside the raw force

Samples = Float[ndarray, " s"]


@dataclass(frozen=True)
class PressTable:
    """Press as a table in SI units.

    Attributes:
        time_s: Time since the first sample [s].
        force_n: Force, positive in compression [N].
        position_m: Position; None without a column [m].
        area_m2: Contact area, NaN for missing samples; None without a column [m^2].
        frame_sample: Sample index of every frame.
        turned: Whether compression is negative in the file.
    """

    time_s: Samples
    force_n: Samples
    position_m: Samples | None
    area_m2: Samples | None
    frame_sample: Int[ndarray, " f"]
    force_column: str
    position_column: str | None
    area_column: str | None
    turned: bool

    def earlier(self, latency_s: float) -> PressTable:
        """Return the table for frames delayed by a latency: force and position of that time before.

        Values are interpolated linearly and constant before the first sample. Frames beyond the last
        sample (negative latency) are dropped. Areas are shifted only if every sample has one.

        Args:
            latency_s: Delay of the frames after their samples [s].
        """
        if not abs(latency_s) < self.time_s[-1] - self.time_s[0]:
            raise RangeError(
                f"frames late by {latency_s} s in a press of {self.time_s[-1]:.3g} s", code="latency"
            )
        if latency_s == 0:
            return self
        at = self.time_s - latency_s
        at = at[at <= self.time_s[-1] + 1e-9]

        def shifted(values: Samples) -> Float[ndarray, " k"]:
            return np.interp(at, self.time_s, values)

        area = self.area_m2
        if area is not None:
            area = shifted(area) if np.isfinite(area).all() else area[: len(at)]
        return replace(
            self,
            time_s=self.time_s[: len(at)],
            force_n=shifted(self.force_n),
            position_m=None if self.position_m is None else shifted(self.position_m),
            area_m2=area,
            frame_sample=self.frame_sample[self.frame_sample < len(at)],
        )


def read_press_table(
    path: Path,
    frames: int | None,
    *,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
) -> PressTable:
    """Read the table of a press and assign its samples to frames.

    Args:
        path: CSV or Parquet file with a header.
        frames: Number of images; None for a press without a camera.
        force_column: Force column; None for the first of `FORCES` present.
        position_column: Length column; None for the first of `POSITIONS` present.
        rate_hz: Row rate of a table without a time column [Hz].
    """
    table = read_labels(path, kinds={})
    force_name = _named(table, path, force_column, FORCES, "N", "force")
    place_name = _named(
        table, path, position_column, POSITIONS, "m", "position", must=position_column is not None
    )
    area_name = next((name for name in AREAS if name in table.columns), None)
    assert force_name is not None
    force = _si(table, path, force_name)
    start = np.median(force[:START])
    turned = bool(force[np.argmax(np.abs(force - start))] < start)
    return PressTable(
        _times(table, path, rate_hz),
        -force if turned else force,
        None if place_name is None else _si(table, path, place_name),
        None if area_name is None else _areas(table, path, area_name),
        np.arange(0) if frames is None else _frame_samples(table, path, frames),
        force_name,
        place_name,
        area_name,
        turned,
    )


def press_rows(
    time_s: Samples,
    raw_n: Samples,
    desired_m: Samples,
    actual_m: Samples,
    frame_sample: Int[ndarray, " f"],
    true_area_m2: Samples | None = None,
) -> pd.DataFrame:
    """Return a press as a table, one row a sample.

    Args:
        raw_n: Raw force; a trailing moving average is added [N].
        desired_m, actual_m: Requested and measured position [m].
        frame_sample: Sample index of every frame; starts at 0.
        true_area_m2: Contact area from a simulator [m^2].
    """
    rising = len(frame_sample) and frame_sample[0] == 0 and (np.diff(frame_sample) > 0).all()
    if not (rising and frame_sample[-1] < len(time_s)):
        raise LabelError(
            "each frame belongs to a later sample than the one before, the first to sample 0",
            code="frame-order",
        )
    raw = raw_n + 0.0  # no minus before a zero
    rows = {
        "time_s": time_s,
        "force_raw_N": raw,
        "force_filtered_N": pd.Series(raw).rolling(TAPS, min_periods=1).mean(),
        "desired_mm": 1e3 * desired_m,
        "actual_mm": 1e3 * actual_m,
        FRAME: np.searchsorted(frame_sample, np.arange(len(time_s)), side="right") - 1,
    }
    if true_area_m2 is not None:
        rows["true_area_mm2"] = 1e6 * true_area_m2
    return pd.DataFrame(rows)


def _named(
    table: pd.DataFrame,
    path: Path,
    wanted: str | None,
    usual: tuple[str, ...],
    si: str,
    what: str,
    must: bool = True,
) -> str | None:
    column = wanted if wanted is not None else next((name for name in usual if name in table.columns), None)
    if column is None and not must:
        return None
    if column is None or column not in table.columns:
        raise LabelError(
            f"{path} has no column {' or '.join([wanted] if wanted else usual)}; name the column of {what}: "
            f"{', '.join(map(str, table.columns))}",
            code="force-missing",
        )
    if not has_unit(column) or split_column(column)[1].si != si:
        raise LabelError(
            f"column {column!r} of {path} carries no unit of {what}; rename it, e.g. {usual[-1]!r}",
            code="force-unit",
        )
    return column


def _si(table: pd.DataFrame, path: Path, name: str) -> Samples:
    return _numbers(table, path, name) * split_column(name)[1].factor


def _areas(table: pd.DataFrame, path: Path, name: str) -> Samples:
    bad = np.arange(len(table))
    if label_kinds(table)[name] == "number":
        values = table[name].to_numpy(np.float64)
        bad = np.flatnonzero((values < 0) | np.isinf(values))
    if bad.size:
        raise LabelError(
            f"{path}, {rows_text(bad)}: {name!r} is no area, 0 or more, or an empty cell; repair them",
            code="area",
        )
    return values * split_column(name)[1].factor


def _numbers(table: pd.DataFrame, path: Path, name: str) -> Samples:
    bad = np.arange(len(table))
    if label_kinds(table)[name] == "number":
        bad = np.flatnonzero(~np.isfinite(table[name].to_numpy(np.float64)))
    if bad.size:
        raise LabelError(
            f"{path}, {rows_text(bad)}: {name!r} holds no finite number; repair them", code="not-finite"
        )
    return table[name].to_numpy(np.float64)


def _times(table: pd.DataFrame, path: Path, rate_hz: float | None) -> Samples:
    name = next((name for name in TIMES if name in table.columns), None)
    if name is None:
        if rate_hz is None or not rate_hz > 0:
            raise LabelError(
                f"{path} has no column {' or '.join(TIMES)}; give its rate [Hz]", code="time-missing"
            )
        return np.arange(len(table)) / rate_hz
    time = _numbers(table, path, name)
    late = np.flatnonzero(np.diff(time) <= 0) + 1
    if late.size:
        raise LabelError(
            f"{path}, {rows_text(late)}: {name!r} does not rise; sort the rows", code="time-order"
        )
    return time - time[0]


def _frame_samples(table: pd.DataFrame, path: Path, frames: int) -> Int[ndarray, " f"]:
    if FRAME not in table.columns:
        if len(table) != frames:
            raise LabelError(
                f"{path} has {len(table)} rows and there are {frames} frames; give a row a frame, or a "
                f"column {FRAME!r} that says which frame each sample belongs to",
                code="row-count",
            )
        return np.arange(frames)
    index = _numbers(table, path, FRAME)
    back = np.flatnonzero((np.diff(index) < 0) | (index[1:] % 1 != 0)) + 1
    if back.size:
        raise LabelError(
            f"{path}, {rows_text(back)}: {FRAME!r} is not a whole number that never falls",
            code="frame-numbers",
        )
    kinds, first = np.unique(index.astype(np.int64), return_index=True)
    if len(kinds) != frames or kinds[0] != 0 or kinds[-1] != frames - 1:
        missing = np.setdiff1d(np.arange(frames), kinds)
        raise LabelError(
            f"{path} names {len(kinds)} frames, {kinds[0]} to {kinds[-1]}, and there are {frames}, 0 to "
            f"{frames - 1}{f'; frame {missing[0]} has no row' if len(missing) else ''}: is it of this press?",
            code="frame-count",
        )
    return first
