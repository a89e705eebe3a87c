"""Copies of a sensor told apart: how a calibration that was adapted to one refuses frames of the other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.covariance import ledoit_wolf
from sklearn.model_selection import GroupKFold
from sklearn.neighbors import NearestNeighbors

from palpate.calibration.certificate import file_card
from palpate.core import Float, Indices
from palpate.estimators.finding_cards import CopyCard
from palpate.estimators.guard import CopyDiscriminator
from palpate.estimators.model_card import Card
from palpate.recordings import Run
from palpate.recordings.joined_runs import SENSOR, run_names

COPY_FILE = "copy.npz"

MAX_REFUSED_OWN = 0.03
"""Share of the copy's own frames that may be taken for the former's."""

MIN_REFUSED_FORMER = 0.5
"""Share of the former copy's frames that has to be told for a discriminator to be worth its false alarms."""

FOLDS, NEAREST = 5, 8
"""Parts that are held out in turn; frames of the former copy compared with each of this one's."""
ROUNDING = 1 / 12
"""Variance of a value that is kept in whole grey levels."""

Flat = Float[np.ndarray, "_ k"]


@dataclass(frozen=True, slots=True)
class CopiesToldApart:
    """A discriminator of two sensor units, and how it judges frames that it has not seen.

    Attributes:
        discriminator: trained on all frames.
        refused_own, refused_former: ratios of each unit's frames that are assigned to the former's, each
            judged without its own group.
    """

    discriminator: CopyDiscriminator
    refused_own: float
    refused_former: float

    @property
    def useful(self) -> bool:
        """True if enough of the former copy's frames are told."""
        return self.refused_former >= MIN_REFUSED_FORMER


class _Frames(NamedTuple):
    """Flat thumbnails of a copy, and the group (press) that each is of."""

    thumbs: Flat
    groups: Indices

    def parts(self, count: int) -> np.ndarray:
        """Number of the fold that each frame is held out in, whole groups together."""
        fold = np.empty(len(self.groups), np.int64)
        for k, (_, held) in enumerate(GroupKFold(count).split(self.groups, groups=self.groups)):
            fold[held] = k
        return fold


def tell_apart(
    own: np.ndarray, own_groups: Indices, former: np.ndarray, former_groups: Indices
) -> CopiesToldApart:
    """Train a discriminator of two sensor units.

    It is judged by those of the former's frames that are most like this unit's. At its limit no more than the
    stated ratio of this unit's own frames, each judged without its group, is refused; where the units lie
    apart, it is the middle of the gap.

    Args:
        own, former: thumbnails of the unit adapted to ``[n h w c]`` and of the former one ``[m h w c]``.
        own_groups, former_groups: group (press) of each; two or more.
    """
    sides = [_Frames(_flat(own), own_groups), _Frames(_flat(former), former_groups)]
    count = min(FOLDS, *(len(np.unique(side.groups)) for side in sides))
    folds = [side.parts(count) for side in sides]
    places = [np.empty(len(side.thumbs)) for side in sides]
    for k in range(count):
        learnt = [side.thumbs[fold != k] for side, fold in zip(sides, folds, strict=True)]
        axis, offset = _fisher(*learnt)
        for side, fold, place in zip(sides, folds, places, strict=True):
            place[fold == k] = side.thumbs[fold == k] @ axis - offset
    places[1] = places[1][_most_alike(sides[1].thumbs, sides[0].thumbs)]
    limit = _limit(*places)
    axis, offset = _fisher(sides[0].thumbs, sides[1].thumbs)
    refused = [float(np.mean(place > limit)) for place in places]
    return CopiesToldApart(CopyDiscriminator(axis, offset, limit), *refused)


def _most_alike(former: Flat, own: Flat) -> Indices:
    """Rows of the former copy's frames that are among the nearest of any of this one's."""
    search = NearestNeighbors(n_neighbors=min(NEAREST, len(former)), algorithm="brute").fit(former)
    return np.unique(search.kneighbors(own, return_distance=False))


def _flat(thumbs: np.ndarray) -> Flat:
    return np.asarray(thumbs, np.float64).reshape(len(thumbs), -1)


def _fisher(own: Flat, former: Flat) -> tuple[np.ndarray, float]:
    """Fisher's axis with a shrunken covariance (Ledoit and Wolf 2004, doi:10.1016/S0047-259X(03)00096-4).

    It is scaled so that the means of the two lie at 0 and 1.
    """
    within = np.concatenate([side - side.mean(axis=0) for side in (own, former)])
    covariance = ledoit_wolf(within, assume_centered=True)[0]
    covariance[np.diag_indices_from(covariance)] += ROUNDING
    axis = np.linalg.solve(covariance, former.mean(axis=0) - own.mean(axis=0))
    means = own.mean(axis=0), former.mean(axis=0)
    apart = float(axis @ (means[1] - means[0]))
    axis = axis / apart if apart > 0 else 0 * axis
    return axis, float(axis @ means[0])


def _limit(own: np.ndarray, former: np.ndarray) -> float:
    highest = float(np.quantile(own, 1 - MAX_REFUSED_OWN, method="higher"))
    lowest = float(np.quantile(former, MAX_REFUSED_OWN, method="lower"))
    return (highest + lowest) / 2 if lowest > highest else highest


def copy_card(found: CopiesToldApart, former: Card, run: Run, folder: Path) -> CopyCard:
    """The card's part on copies; the discriminator is written where it is useful.

    Args:
        found: the discriminator.
        former: the card of the calibration that was adapted.
        run: of the copy.
        folder: the calibration's, to write to.
    """
    name, other = copy_names(former, run)
    if found.useful:
        found.discriminator.save(folder / COPY_FILE)
    own, seen = 100 * found.refused_own, 100 * found.refused_former
    told = (
        f"Adapted to {name}. Frames of {other}, which the network came from, are refused: {seen:.0f} % of "
        f"its frames most like this copy's, each judged without its neighbours, and {own:.1f} % of this "
        "copy's own by mistake."
    )
    untold = (
        f"Adapted to {name}. Its frames cannot be told from those of {other}, which the network came from: "
        f"no more than {seen:.0f} % of them. Make sure by other means which one is read."
    )
    return CopyCard(
        name=name,
        former=other,
        run_id=run.manifest.run_id,
        file=file_card(folder / COPY_FILE) if found.useful else None,
        refused_own=found.refused_own if found.useful else 0.0,
        refused_former=found.refused_former if found.useful else 0.0,
        text=told if found.useful else untold,
    )


def copy_names(former: Card, run: Run) -> tuple[str, str]:
    """Names of the copy adapted to and of the former one, with their runs where the sensor's name is one."""
    own = _labelled(run) or run.manifest.sensor or run_names((run,))[0]
    other = (former.copy_of.name if former.copy_of else former.sensor) or "the former copy"
    return (
        (own, other)
        if own != other
        else (f"{own} of {run_names((run,))[0]}", f"{other} of calibration {former.id}")
    )


def _labelled(run: Run) -> str:
    """The one value of a label ``copy`` or ``sensor``; nothing where there is none or several."""
    for column in ("copy", SENSOR):
        if column in run.labels:
            values = run.labels[column].dropna().astype(str).unique()
            return str(values[0]) if len(values) == 1 else ""
    return ""
