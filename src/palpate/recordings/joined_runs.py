"""Several runs as one: a row a frame, each with the session that it was recorded in."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np
import pandas as pd

from palpate.core import InputError, LabelError, SplitError
from palpate.core.provenance import joint_provenance
from palpate.recordings.label_tables import Label
from palpate.recordings.manifest import (
    LabelKind,
    Manifest,
    ReferenceInstrument,
    StoredManifest,
    refuse_strangers,
)
from palpate.recordings.run_reader import Run
from palpate.recordings.segments.segment_reader import Damage
from palpate.recordings.splits import SESSION, group_names

SENSOR = "sensor"


class JoinedRun(Run):
    """Several runs as one, in the order given.

    The labels are the columns that all runs share, and ``session`` (a run's own column, else its name).
    A column's instrument is the least certain one, see `refuse_partly_measured`. A column ``sensor`` is
    added for different sensors. Times count from the earliest beginning.

    Attributes:
        left_out: Label columns that only some runs have.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        _check(runs)
        self.runs = tuple(runs)
        shared = [name for name in runs[0].manifest.labels if all(name in r.manifest.labels for r in runs)]
        every = {name for run in runs for name in run.manifest.labels} - {SESSION}
        self.left_out = tuple(sorted(every - set(shared)))
        segments = tuple(segment for run in runs for segment in run.segments)
        path = Path(" + ".join(str(run.path) for run in runs))
        super().__init__(path, StoredManifest.of(_manifest(runs, shared)), segments)

    @cached_property
    def hash(self) -> str:
        """SHA-256 over the runs' own, in their order."""
        return sha256("\0".join(run.hash for run in self.runs).encode()).hexdigest()

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of all runs."""
        return tuple(path for run in self.runs for path in run.files)

    @cached_property
    def damage(self) -> tuple[Damage, ...]:
        """Damage of all runs."""
        return tuple(damage for run in self.runs for damage in run.damage)

    @cached_property
    def _abouts(self) -> list[tuple[float | None, dict[str, Label]]]:
        columns = self.manifest.labels.keys()
        abouts = []
        for run, name in zip(self.runs, run_names(self.runs), strict=True):
            sessions = sessions_of(run, name)
            for (exposure_s, labels), session in zip(run._abouts, sessions, strict=True):
                own = {SENSOR: run.manifest.sensor, **labels, SESSION: str(session)}
                abouts.append((exposure_s, {key: own[key] for key in own if key in columns}))
        return abouts

    @cached_property
    def _named(self) -> list[str]:
        """Names of the frames, each with its run's."""
        named = zip(self.runs, run_names(self.runs), strict=True)
        return [f"{name}/{run._name(i)}" for run, name in named for i in range(len(run))]

    def _name(self, index: int) -> str:
        return self._named[index]


def joined(runs: Run | Sequence[Run]) -> Run:
    """One run from one or several, see `JoinedRun`; a single one is itself."""
    if isinstance(runs, Run):
        return runs
    if not runs:
        raise InputError("no run to calibrate on; name one or more")
    return runs[0] if len(runs) == 1 else JoinedRun(runs)


def run_names(runs: Sequence[Run]) -> tuple[str, ...]:
    """Names of runs by their folders; with as many folders above as tell all apart."""
    parts = [run.path.resolve().parts for run in runs]
    for depth in range(1, max(map(len, parts)) + 1):
        names = tuple("/".join(part[-depth:]) for part in parts)
        if len(set(names)) == len(names):
            return names
    return tuple(f"{name} ({i + 1})" for i, name in enumerate(names))


def sessions_of(run: Run, name: str | None = None) -> np.ndarray:
    """Session of each frame ``[n]``: the run's own label, else the run's name.

    Args:
        name: what a run without the label is called; by default its folder's name.
    """
    if SESSION not in run.manifest.labels:
        return np.full(len(run), name or run_names((run,))[0])
    own = pd.DataFrame({SESSION: [about[1].get(SESSION) for about in run._abouts]})
    if run.manifest.labels[SESSION] == "number":
        own = own.astype(np.float64)
    try:
        return group_names(own, (SESSION,))
    except SplitError as e:
        raise LabelError(f"{run.path}: {e}") from e


def _check(runs: Sequence[Run]) -> None:
    first, names = runs[0], run_names(runs)
    for i, run in enumerate(runs):
        for j, other in enumerate(runs[:i]):
            if run.hash == other.hash or run.manifest.run_id == other.manifest.run_id:
                raise InputError(
                    f"{names[i]} and {names[j]} are one recording ({run.manifest.run_id}); give each once: a "
                    "session counts only if it was recorded by itself"
                )
        if not len(run):
            raise InputError(f"{run.path} holds no frames; leave it out")
        for name, kind in run.manifest.labels.items():
            former = first.manifest.labels.get(name, kind)
            if kind != former and name != SESSION:
                raise LabelError(
                    f"label {name!r} is a {kind} in {run.path} and a {former} in {first.path}; runs are "
                    "joined where a column is of one kind in all: import one of them again"
                )
        if _size(run) != _size(first):
            raise InputError(
                f"frames of {run.path} are {_size(run)}, those of {first.path} {_size(first)}: another "
                "camera or another setting of it; a calibration is of one kind of frame, so calibrate "
                "each for itself"
            )
        if run.manifest.regions != first.manifest.regions:
            raise InputError(
                f"{run.path} names the regions {run.manifest.regions}, {first.path} "
                f"{first.manifest.regions}; runs are joined where these are the same"
            )


def _size(run: Run) -> str:
    """Size and kind of a run's first frame, in words."""
    shape = run.frame(0).image.shape
    return f"{shape[1]}x{shape[0]} px {'RGB' if len(shape) == 3 else 'grey'}"


def _manifest(runs: Sequence[Run], shared: Sequence[str]) -> Manifest:
    about = [run.manifest for run in runs]
    first = about[0]
    labels: dict[str, LabelKind] = {name: first.labels[name] for name in shared}
    if len({one.sensor for one in about}) > 1:
        labels.setdefault(SENSOR, "text")
    labels[SESSION] = "text"
    return first.model_copy(
        update={
            "run_id": "joined: " + ", ".join(one.run_id for one in about),
            "created_utc": min(about, key=lambda one: one.created_ns).created_utc,
            "clock": "measured" if all(one.clock == "measured" for one in about) else "ordinal",
            "order": "names" if any(one.order == "names" for one in about) else "recorded",
            "sensor": _listed(one.sensor for one in about),
            "rig": _listed(one.rig for one in about),
            "licence": _listed(one.licence for one in about),
            "origin": _listed(one.origin for one in about),
            "provenance": joint_provenance(one.provenance for one in about),
            "seed": None,
            "units": {name: unit for name, unit in first.units.items() if name in shared and name != SESSION},
            "labels": labels,
            "targets": tuple(name for name in first.targets if name in shared),
            "instruments": {
                name: _least_certain([one.instruments[name] for one in about])
                for name in shared
                if all(name in one.instruments for one in about)
            },
        }
    )


def _least_certain(stated: Sequence[ReferenceInstrument]) -> ReferenceInstrument:
    """The instrument of the largest standard uncertainty, which says so where the runs' are several."""
    worst = max(stated, key=lambda one: one.standard_uncertainty)
    names = list(dict.fromkeys(one.instrument for one in stated))
    if len(names) == 1:
        return worst
    return worst.model_copy(
        update={"instrument": f"{worst.instrument}, the least certain of {'; '.join(names)}"}
    )


def check_instruments(run: Run, columns: Sequence[str], stated: Mapping[str, ReferenceInstrument]) -> None:
    """Check what is stated, beside a run, of what its columns were measured with.

    Args:
        stated: instruments by column; they go before those that the run states.
    """
    refuse_strangers(stated, tuple(run.manifest.labels), str(run.path))
    refuse_partly_measured(run, [column for column in columns if column not in stated])


def refuse_partly_measured(run: Run, columns: Sequence[str]) -> None:
    """Raise a LabelError if only some of a joined run's parts state what a column was measured with.

    An interval for all of them would lack an instrument, or have one that some were not measured with.
    """
    parts = run.runs if isinstance(run, JoinedRun) else ()
    for column in columns:
        without = [part for part in parts if column not in part.manifest.instruments]
        if 0 < len(without) < len(parts):
            raise LabelError(
                f"{column}: {', '.join(run_names(without))} states no instrument for it, and the others do; "
                f"state one for all in a file, as [{column}] in --instruments FILE, or leave these runs out"
            )


def _listed(words: Iterable[str]) -> str:
    return "; ".join(word for word in dict.fromkeys(words) if word)
