"""Labels of sessions that cannot be what they say, and sessions that show nothing of another day."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date, datetime
from itertools import combinations

import numpy as np
import pandas as pd

from palpate.core import Float, Float32, Int, SplitError, Values
from palpate.recordings.joined_runs import JoinedRun
from palpate.recordings.run_reader import Run
from palpate.recordings.splits import SESSION, group_names

DATE_FORMATS = (
    "%Y-%m-%d", "%Y%m%d", "%Y/%m/%d", "%Y_%m_%d", "%d.%m.%Y", "%d-%m-%Y", "%d/%m/%Y", "%m/%d/%Y", "%m-%d-%Y",
    "%d %b %Y", "%d %B %Y",
)  # fmt: skip
MIN_ROWS = 10
"""Rows of a session below which it shows little of its day."""
MAX_STRETCHES = 3.0
"""Stretches of neighbouring rows, over the number of sessions, above which sessions alternate."""
MAX_SPANS = 20.0
"""Ratio of a target's spans in two sessions, above which they may be in two units."""
SHUFFLES, LEVEL = 199, 0.05
MIN_UNITS = 8
"""Presses of a session, with fewer of which its frames are not compared with another's."""
MAX_PAIRS, MAX_NAMED = 45, 3
COMPONENTS, UNITS_A_COMPONENT = 20, 4


def refuse_no_sessions(table: pd.DataFrame, columns: Sequence[str]) -> None:
    """Raise where the column `session` cannot name sessions that are held out.

    Args:
        table: labels of the rows to learn from.
        columns: of the targets.

    Raises:
        SplitError: it repeats a target, has a value of its own in most rows, or writes one day, or one name,
            in two ways.
    """
    sessions = group_names(table, (SESSION,))
    names = np.unique(sessions)
    remedy = (
        "name what was recorded without re-mounting the sensor, such as the day, or split by another column "
        f"({'--split random, --split group:press' if 'press' in table else '--split random'})"
    )
    for column in columns:
        if column in table and np.array_equal(sessions, group_names(table, (column,))):
            raise SplitError(
                f"label 'session' holds the values of target {column!r}: it is that target, and no session; "
                f"{remedy}"
            )
    if 2 * len(names) > len(sessions):
        raise SplitError(
            f"label 'session' has {len(names)} values in {len(sessions)} rows, most of them in one row: that "
            f"numbers rows, and no sessions; {remedy}"
        )
    for first, second in combinations(map(str, names[:100]), 2):
        if _plain(first) == _plain(second):
            raise SplitError(
                f"sessions {first!r} and {second!r} are one name, spelt in two ways, and would count as two "
                "days; spell it in one way"
            )
        if (day := _same_day(first, second)) is not None:
            raise SplitError(
                f"sessions {first} and {second} may both be {day}, written in two ways, and would count as "
                "two days; write dates in one way, such as 2026-11-21"
            )


def _plain(name: str) -> str:
    """A name without spaces, in one case."""
    return "".join(name.split()).casefold()


def _same_day(first: str, second: str) -> date | None:
    """The day that two names can both mean where no one way of writing reads both; None otherwise."""
    a, b = _readings(first), _readings(second)
    if set(a) & set(b):
        return None
    return min(set(a.values()) & set(b.values()), default=None)


def _readings(name: str) -> dict[str, date]:
    found = {}
    for form in DATE_FORMATS:
        try:
            found[form] = datetime.strptime(name.strip(), form).date()
        except ValueError:
            continue
    return found


def label_findings(
    table: pd.DataFrame, values: Values, columns: Sequence[str], in_recorded_order: bool = True
) -> list[str]:
    """Sentences on sessions, by their labels and targets.

    Args:
        table: labels of the rows to learn from, in the order they were recorded.
        values: the targets ``[n t]``.
        columns: their names.
        in_recorded_order: whether that is the order the rows lie in; where not, sessions may alternate.
    """
    sessions = group_names(table, (SESSION,))
    names, of, rows = np.unique(sessions, return_inverse=True, return_counts=True)
    found = [
        f"session {name} has {count} row{'s' if count > 1 else ''}: too few to show what another day brings, "
        "and it counts as one session all the same; join it to the session it belongs to, or leave it out"
        for name, count in zip(names, rows, strict=True)
        if count < MIN_ROWS
    ]
    stretches = 1 + int(np.sum(of[1:] != of[:-1]))
    if in_recorded_order and stretches > MAX_STRETCHES * len(names):
        found.append(
            f"rows of {len(names)} sessions alternate {stretches - 1} times in the order in which they were "
            "recorded, and a sensor is not mounted anew so often: unless the rows were shuffled, 'session' "
            "names something else, and no other day is tested"
        )
    for column, target in zip(columns, values.T, strict=True):
        spans = np.array([np.ptp(target[of == k]) for k in range(len(names))])
        still = [str(name) for name, span in zip(names, spans, strict=True) if span == 0]
        if still and len(still) < len(names):
            found.append(
                f"{column} has one value throughout session {', '.join(still[:3])}: it is not tested there "
                "over its range"
            )
        moving = (spans > 0) & (rows >= MIN_ROWS)
        if moving.sum() > 1 and spans[moving].max() > MAX_SPANS * spans[moving].min():
            small, large = (names[moving][np.argsort(spans[moving])[i]] for i in (0, -1))
            found.append(
                f"{column} runs over {spans[moving].min():.3g} in session {small} and over "
                f"{spans[moving].max():.3g} in {large}: is it in another unit there?"
            )
    return found


def unlabelled_runs(run: Run) -> list[str]:
    """A sentence on runs whose session is their name, joined with runs that label it."""
    runs = run.runs if isinstance(run, JoinedRun) else ()
    bare = [one.path.name for one in runs if SESSION not in one.manifest.labels]
    if not bare or len(bare) == len(runs):
        return []
    text = (
        f"without a label 'session', and each counted as a session by its name, beside runs that have one: "
        f"{', '.join(bare)}; label it in each, if it may be a session that another run names"
    )
    return [text]


def alike_sessions(
    pictures: Float32[np.ndarray, "n h w c"], sessions: np.ndarray, units: Int[np.ndarray, " n"]
) -> list[str]:
    """Sentences on sessions whose frames cannot be told apart.

    Mean pictures of two sessions are compared, in their main components and in units of how much presses
    differ (Hotelling's T²), with those of shuffled presses. A new mounting and another day's light show.

    Args:
        pictures: small pictures of the frames.
        sessions: of each ``[n]``.
        units: press of each, which is shuffled whole.
    """
    _, of_unit = np.unique(units, return_inverse=True)
    count = np.bincount(of_unit)
    flat = pictures.reshape(len(pictures), -1).astype(np.float64)
    means = np.zeros((len(count), flat.shape[1]))
    np.add.at(means, of_unit, flat)
    means /= count[:, None]
    session_of = np.empty(len(count), dtype=sessions.dtype)
    session_of[of_unit] = sessions
    pairs = []
    for first, second in list(combinations(np.unique(sessions), 2))[:MAX_PAIRS]:
        part = np.isin(session_of, (first, second))
        ours = session_of[part] == first
        if min(ours.sum(), (~ours).sum()) >= MIN_UNITS and _level(means[part], ours) > LEVEL:
            pairs.append(f"{first} and {second}")
    if not pairs:
        return []
    text = (
        f"frames of sessions {'; '.join(pairs[:MAX_NAMED])} cannot be told apart, as those of one mounting: "
        "unless the sensor rests as still as that, it is one session under two names, which tests no other "
        "day"
    )
    return [text]


def _level(means: Float[np.ndarray, "u d"], ours: np.ndarray) -> float:
    """Share of shufflings in which two groups of presses differ as much."""
    centred = means - means.mean(axis=0)
    axes, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    kept = min(COMPONENTS, len(means) // UNITS_A_COMPONENT, int((sizes > 1e-6 * max(sizes[0], 1e-12)).sum()))
    scores = axes[:, : max(kept, 1)]
    rng = np.random.default_rng(0)
    orders = np.array([ours, *(rng.permutation(ours) for _ in range(SHUFFLES))], dtype=np.float64)
    # Components have no mean, so that one group's sum is minus the other's.
    differences = ((orders @ scores) ** 2).sum(axis=1)
    return float((1 + np.sum(differences[1:] >= differences[0] * (1 - 1e-9))) / (1 + SHUFFLES))
