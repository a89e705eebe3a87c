"""Leakage audit: held-out frames that were trained on, under another name."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, fields
from hashlib import sha256
from typing import Any

import cv2
import numpy as np
import pandas as pd
from sklearn.neighbors import NearestNeighbors

from palpate.calibration.near_copies import NearCopies, find_near_copies
from palpate.core import InputError, has_unit, split_column
from palpate.estimators.findings import Finding, FindingCode
from palpate.recordings.label_tables import label_kinds
from palpate.recordings.packed_set import PackedSet
from palpate.recordings.run_reader import NAME_COLUMN
from palpate.recordings.splits import SESSION, Split, conventional_groups, group_names, within_session

_THUMB_PX = 16
_MAX_COPIES = 0.05  # ratio of a session's frames that may equal another's, as of a dark sensor
# Two frames of one scene: their difference at half a cell over its second differences', and what a lamp's
# flicker and compression add [grey levels].
_NOISE_ROOM, _UNEVEN = 1.5, 0.4
_MEDIAN_OF_NORMAL = 0.6745  # of the absolute value, in standard deviations
_MANY = 0.05  # of the held-out frames, above which look-alikes are no chance
_AGREEING = 0.02  # of a label's range, within which a copy's label lies
_AT_REST = 0.002  # of the largest depth and force: a force gauge's untouched reading is seldom exactly 0
_SMALL_PX, _SMALL_BLUR = 48, 1.5
_SHIFT_PX = 2  # of the prepared frame; a recorded pixel may be more than one
_MAX_COMPARED = 1500  # held-out frames compared after gain and shift; beyond, every so many
_BATCH = 256
_NAMED = 3
# Area means over cells that differ by less than half a grey level are the same number in 8 bits.
_ROUNDING = 0.5
# Room for noise that is not the same everywhere, such as a lamp's flicker or JPEG's blocks.
_NOISE_FACTOR = 2.0
# Of 256 cells of pure noise the largest is three times their root mean square, four with room; a touch that
# changes only a small part of the view changes one cell by more.
_PEAK_FACTOR = 4.0
_NOISE_PAIRS = 200
_BLOCK = 4
# The quietest twentieth of all places has a third of the median's power where there is white noise and
# nothing else (sixteen values a place), and less where part of the view moved.
_EVEN = 0.2
# Black and white are clipped, and noise does not show there [grey levels].
_BLACK, _WHITE = 4, 251
_MAX_PAIRS = 400_000_000
# Second differences along both axes; the six keeps white noise at its standard deviation.
# Immerkaer 1996, https://doi.org/10.1006/cviu.1996.0060
_SECOND_DIFFERENCES = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32) / 6


@dataclass(frozen=True, slots=True)
class LeakageAudit:
    """Frames and groups that are on both sides of a split.

    Attributes:
        shared_groups, shared_names: number of groups with frames on both sides, and a few names.
        near_duplicates: held-out frames that equal a trained one within camera noise, or are an altered copy.
        altered_copies: those found only by comparison after gain and shift.
        examples: names of a few pairs, held-out frame first.
        checked_pairs: number of pairs compared.
        limit: largest RMS difference of thumbnails that counts as equal [grey levels].
        at_rest: number of no-contact frames, which were left out.
        clean: no near-duplicates, and no group shared under a random split.
    """

    shared_groups: dict[str, int]
    shared_names: dict[str, tuple[str, ...]]
    near_duplicates: int
    altered_copies: int
    examples: tuple[tuple[str, str], ...]
    checked_pairs: int
    limit: float
    at_rest: int
    clean: bool
    findings: tuple[Finding, ...]

    def to_dict(self) -> dict[str, Any]:
        """The numbers and names as JSON can hold them."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("findings", "clean")}


def audit(
    packed: PackedSet,
    split: Split,
    *,
    group_columns: Sequence[str] | None = None,
    at_rest: np.ndarray | None = None,
    classes: Collection[str] = (),
) -> LeakageAudit:
    """Find groups and frames that are on both sides of a split.

    Near-duplicates have 16 × 16 thumbnails that differ by at most the estimated camera noise.

    Args:
        group_columns: by default the conventional ones and every text column in which a text recurs.
        at_rest: no-contact rows ``[n]``; by default by a flag ``contact`` or a depth and force of 0.
        classes: columns that the model predicts, which are on both sides as any target is.
    """
    table, digests = packed.table, _digests(packed)
    _refuse_copied_sessions(table, split.group_columns, digests)
    shared = {name: _shared(groups, split) for name, groups in _groupings(table, group_columns)}
    shared = {name: groups for name, groups in shared.items() if groups.size and name not in classes}
    thumbs = _thumbnails(packed)
    resting = _at_rest(table) if at_rest is None else np.asarray(at_rest, dtype=bool)
    held, twin, pairs = _nearest_across(thumbs, split, resting)
    limit = max(_ROUNDING, _NOISE_FACTOR * _noise(packed, thumbs))
    at_rest_or_alike = _looks_like(thumbs, resting, limit) if resting.any() else resting
    agreeing = _labels_agree(table, held, twin)
    same = np.flatnonzero(_alike(thumbs[held], thumbs[twin], limit) & ~at_rest_or_alike[held] & agreeing)
    same = same[[_by_noise_alone(packed, int(held[i]), int(twin[i])) for i in same]] if same.size else same
    copies = _near_copies(packed, split, at_rest_or_alike)
    if len(same) < _MANY * len(held):  # of dense presses some look alike by chance, and as the next do
        same = same[np.isin(held[same], copies.lone)]
    agreeing = _labels_agree(table, copies.held, copies.twin)
    altered = dict(zip(copies.held[agreeing].tolist(), copies.twin[agreeing].tolist(), strict=True))
    equal = _equal_pairs(digests, split, at_rest_or_alike)
    same_pairs = dict(zip(held[same].tolist(), twin[same].tolist(), strict=True)) | equal
    pairs_found = altered | same_pairs
    sides = np.array(sorted(equal.items()), np.int64).reshape(-1, 2).T
    contradicting = sides[:, ~_labels_agree(table, *sides)].T.tolist()
    counts = {name: len(groups) for name, groups in shared.items()}
    clean = not pairs_found and not (split.groups is None and counts)
    return LeakageAudit(
        shared_groups=counts,
        shared_names={name: tuple(str(g) for g in groups[:_NAMED]) for name, groups in shared.items()},
        near_duplicates=len(pairs_found),
        altered_copies=len(pairs_found) - len(same_pairs),
        examples=tuple((packed.names[a], packed.names[b]) for a, b in sorted(pairs_found.items())[:_NAMED]),
        checked_pairs=pairs,
        limit=limit,
        at_rest=int(np.count_nonzero(resting)),
        clean=clean,
        findings=_findings(
            split,
            counts,
            len(same_pairs),
            len(pairs_found) - len(same_pairs),
            len(held),
            [(packed.names[a], packed.names[b]) for a, b in contradicting],
        ),
    )


def _groupings(table: pd.DataFrame, columns: Sequence[str] | None) -> Iterator[tuple[str, np.ndarray]]:
    if columns is None:
        # Images of two runs may well have one name.
        texts = [(n,) for n, kind in label_kinds(table).items() if kind == "text" and n != NAME_COLUMN]
        chosen = list(dict.fromkeys([*conventional_groups(table), *texts]))
    else:
        chosen = [(name,) for name in columns]
    for names in (within_session(table, one) for one in chosen):
        if columns is None and any(
            table[n].isna().any() or (table[n].astype(str) == "").any() for n in names
        ):
            continue  # a column with gaps was not meant to group; asked for by name it is an error
        groups = group_names(table, names)
        if 1 < len(np.unique(groups)) < len(groups):
            yield ",".join(names), groups


def _shared(groups: np.ndarray, split: Split) -> np.ndarray:
    """The groups with rows in more than one fold: held out in one, they are trained on in it too."""
    fold_of = np.empty(len(groups), dtype=np.int64)
    for k, fold in enumerate(split.folds):
        fold_of[fold] = k
    names, inverse = np.unique(groups, return_inverse=True)
    least, most = np.full(len(names), len(split.folds)), np.full(len(names), -1)
    np.minimum.at(least, inverse, fold_of)
    np.maximum.at(most, inverse, fold_of)
    crossing: np.ndarray = names[least != most]
    return crossing


def _at_rest(table: pd.DataFrame) -> np.ndarray:
    rest, any_column = np.ones(len(table), dtype=bool), False
    for name, kind in label_kinds(table).items():
        if kind == "flag" and name == "contact":
            return np.asarray(table[name].eq(False), dtype=bool)
        if kind == "number" and has_unit(name) and split_column(name)[0].endswith(("depth", "force")):
            size = np.abs(table[name].to_numpy())
            rest &= size <= _AT_REST * np.nanmax(size, initial=0.0)
            any_column = True
    return rest & any_column


def _thumbnails(packed: PackedSet) -> np.ndarray:
    """Area means of every frame ``[n k]`` [grey levels]."""
    batches = packed.batches(np.arange(len(packed)), _BATCH)
    return np.concatenate([_shrunk(batch, _THUMB_PX).reshape(len(batch), -1) for batch in batches])


def _shrunk(frames: np.ndarray, most_px: int) -> np.ndarray:
    """Area means ``[n h w c]``, at most so many along each side."""
    height, width = (min(most_px, side) for side in frames.shape[1:3])
    small = [cv2.resize(f.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) for f in frames]
    return np.stack(small).reshape(len(frames), height, width, -1)


def _nearest_across(
    thumbs: np.ndarray, split: Split, resting: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int]:
    # Beyond this many pairs every so many held-out frames stand for all.
    step = 1 + len(thumbs) ** 2 // _MAX_PAIRS
    held, twin, pairs = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)], 0
    for k, fold in enumerate(split.folds):
        queries, trained = fold[~resting[fold]][::step], split.training_rows(k)
        trained = trained[~resting[trained]]
        if queries.size and trained.size:
            search = NearestNeighbors(n_neighbors=1, algorithm="brute").fit(thumbs[trained])
            held.append(queries)
            twin.append(trained[search.kneighbors(thumbs[queries], return_distance=False)[:, 0]])
            pairs += len(queries) * len(trained)
    return np.concatenate(held), np.concatenate(twin), pairs


def _digests(packed: PackedSet) -> list[bytes]:
    batches = packed.batches(np.arange(len(packed)), _BATCH)
    return [sha256(frame.tobytes()).digest() for batch in batches for frame in batch]


def _refuse_copied_sessions(table: pd.DataFrame, columns: Sequence[str], digests: list[bytes]) -> None:
    """Raise `InputError` where sessions are held out and the frames of one equal another's."""
    if SESSION not in columns or SESSION not in table:
        return
    sessions = group_names(table, (SESSION,))
    seen: dict[bytes, set[str]] = {}
    for digest, session in zip(digests, sessions, strict=True):
        seen.setdefault(digest, set()).add(session)
    for session in np.unique(sessions):
        own = [digest for digest, of in zip(digests, sessions, strict=True) if of == session]
        for other in sorted(set(sessions) - {session}):
            copies = sum(other in seen[digest] for digest in own)
            if copies > _MAX_COPIES * len(own) and copies > 1:
                raise InputError(
                    f"{copies} of {len(own)} frames of session {session} equal frames of {other}. Give one "
                    "session once, or under one name",
                    code="session-twice",
                )


def _equal_pairs(digests: list[bytes], split: Split, resting: np.ndarray) -> dict[int, int]:
    rows_of: dict[bytes, list[int]] = {}
    for row in np.flatnonzero(~resting).tolist():
        rows_of.setdefault(digests[row], []).append(row)
    pairs: dict[int, int] = {}
    for k, fold in enumerate(split.folds if len(rows_of) < np.count_nonzero(~resting) else ()):
        trained = set(split.training_rows(k).tolist())
        for row in fold[~resting[fold]].tolist():
            twin = next((other for other in rows_of[digests[row]] if other in trained), None)
            if twin is not None:
                pairs[row] = twin
    return pairs


def _near_copies(packed: PackedSet, split: Split, resting: np.ndarray) -> NearCopies:
    step = 1 + len(packed) // _MAX_COMPARED
    sides = []
    for k, fold in enumerate(split.folds):
        trained = split.training_rows(k)
        sides.append((fold[~resting[fold]][::step], trained[~resting[trained]]))
    shift = _SHIFT_PX * _SMALL_PX / max(_SMALL_PX, *packed.shape[:2])
    return find_near_copies(_small(packed), sides, shift, _changing_labels(packed.table))


def _small(packed: PackedSet) -> np.ndarray:
    """Grey area means of every frame ``[n h w]``, blurred first, so that a shift is a slope."""
    blur = _SMALL_BLUR * max(1.0, max(packed.shape[:2]) / _SMALL_PX)
    batches = packed.batches(np.arange(len(packed)), _BATCH)
    greys = (frame.astype(np.float32).mean(axis=-1) for batch in batches for frame in batch)
    blurred = (cv2.GaussianBlur(grey, (0, 0), blur)[None, ..., None] for grey in greys)
    return np.concatenate([_shrunk(grey, _SMALL_PX)[..., 0] for grey in blurred])


def _noise(packed: PackedSet, thumbs: np.ndarray) -> float:
    """Standard deviation of a thumbnail's cell by camera noise [grey levels]; 0 where unknown."""
    rows, others = _most_alike(thumbs)
    roughness = [_roughness(*packed.read(pair)) for pair in np.column_stack([rows, others])]
    levels = [level for level, evenness in roughness if evenness > _EVEN]
    return float(np.median(levels)) if 2 * len(levels) > len(roughness) else 0.0


def _most_alike(thumbs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows = np.unique(np.linspace(0, len(thumbs) - 1, min(_NOISE_PAIRS, len(thumbs))).astype(np.int64))
    search = NearestNeighbors(n_neighbors=min(2, len(thumbs)), algorithm="brute").fit(thumbs)
    neighbours = search.kneighbors(thumbs[rows], return_distance=False)
    # A row's nearest is itself, unless it has an exact copy, which may then come first.
    return rows, np.where(neighbours[:, 0] == rows, neighbours[:, -1], neighbours[:, 0])


def _roughness(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Difference of two frames by location [grey levels in a cell] and its evenness, by second differences at
    half a cell, since noise of neighboring pixels is often correlated.
    """
    fine = 2 * _THUMB_PX
    apart = _shrunk(a[None], fine)[0] - _shrunk(b[None], fine)[0]
    power = cv2.filter2D(apart, -1, _SECOND_DIFFERENCES).reshape(apart.shape) ** 2
    power, level = _shrunk(power[None], fine // _BLOCK)[0], _shrunk(a[None], fine // _BLOCK)[0]
    exposed = power[(level > _BLACK) & (level < _WHITE)]
    typical = float(np.median(exposed)) if exposed.size else 0.0
    # A cell is the mean of four places, so its noise is half of theirs.
    return float(np.sqrt(typical)) / 2, float(np.quantile(exposed, 0.05)) / typical if typical else 0.0


def _alike(a: np.ndarray, b: np.ndarray, limit: float) -> np.ndarray:
    apart = np.abs(a - b)
    typical, largest = np.sqrt((apart**2).mean(axis=1)), apart.max(axis=1, initial=0)
    alike: np.ndarray = (typical <= limit) & (largest <= _PEAK_FACTOR * limit)
    return alike


def _by_noise_alone(packed: PackedSet, a: int, b: int) -> bool:
    """True if two frames differ as evenly at half a cell as noise does; markers that moved do not."""
    first, second = (_shrunk(frame[None], 2 * _THUMB_PX)[0] for frame in packed.read([a, b]))
    apart = first - second
    rough = cv2.filter2D(apart, -1, _SECOND_DIFFERENCES)
    noise = float(np.median(np.abs(rough))) / _MEDIAN_OF_NORMAL
    return bool(apart.std() ** 2 <= (_NOISE_ROOM * noise) ** 2 + _UNEVEN**2)


def _labels_agree(table: pd.DataFrame, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Pairs of rows whose labels are nearly equal: touches too light to be seen look alike anywhere."""
    values = _changing_labels(table)
    widths = _AGREEING * (np.nanmax(values, axis=0) - np.nanmin(values, axis=0))
    agree: np.ndarray = ~(np.abs(values[a] - values[b]) > widths).any(axis=1)
    return agree


def _changing_labels(table: pd.DataFrame) -> np.ndarray:
    """Labels with a unit that are not the same everywhere ``[n k]``, times aside."""
    columns = [np.empty((len(table), 0))]
    for name, kind in label_kinds(table).items():
        if kind == "number" and has_unit(name) and split_column(name)[0] != "time":
            values = table[name].to_numpy(dtype=np.float64)
            known = values[~np.isnan(values)]  # none of a place that was never seen
            if known.size and known.max() > known.min():
                columns.append(values[:, None])
    return np.concatenate(columns, axis=1)


def _looks_like(thumbs: np.ndarray, resting: np.ndarray, limit: float) -> np.ndarray:
    untouched = np.median(thumbs[resting], axis=0)
    unseen: np.ndarray = resting | _alike(thumbs, np.broadcast_to(untouched, thumbs.shape), limit)
    return unseen


def _findings(
    split: Split,
    shared: dict[str, int],
    twins: int,
    altered: int,
    held: int,
    contradicting: Sequence[tuple[str, str]],
) -> tuple[Finding, ...]:
    found = []
    if contradicting:
        first, second = contradicting[0]
        values = {"count": len(contradicting), "held": held, "first": first, "second": second}
        found.append(Finding(code=FindingCode.CONTRADICTING_LABELS, values=values))
    for code, count in ((FindingCode.ALTERED_COPIES, altered), (FindingCode.LOOK_ALIKES, twins)):
        if count:
            found.append(Finding(code=code, values={"count": count, "held": held}))
    if shared and split.groups is None:
        names = ", ".join(f"{name} ({count} groups)" for name, count in shared.items())
        found.append(Finding(code=FindingCode.GROUPS_SHARED, values={"groups": names}))
    elif shared:
        held_out = " and ".join(split.group_columns) or "stretches of rows"
        values = {"held_out": held_out, "groups": ", ".join(shared)}
        found.append(Finding(code=FindingCode.GROUPS_NOT_HELD_OUT, values=values))
    return tuple(found)
