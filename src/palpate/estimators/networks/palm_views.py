"""What the palm's networks have in common: two views in one image, and targets found by name.

The photoelastic palm is seen twice: edge-on, where its fringes are, and in an angled mirror, where the
indenter's place is. One image holds both, side by side: its left half is the fringe crop, its right half the
mirror crop. Whether they are raw or differences from the untouched sensor, and grey or coloured, is decided
before a network sees them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.core.errors import InputError
from palpate.core.shapes import Indices
from palpate.estimators.networks.base import Scaler, TrainingData

FORCES = ("force_x_N", "force_y_N", "force_N")
"""The force's components; the normal one is positive in compression."""
PLACE = ("x_mm", "y_mm")
MAGNITUDE = "force_magnitude_N"
DEPTH = "depth_mm"

SEEN_FOR_SCALE = 500


def half_width(shape: tuple[int, int, int]) -> int:
    """Columns of each view [px] in an image of (channels, height, width).

    Raises:
        InputError: the width is odd, so that the image is not two views of one size.
    """
    if shape[2] % 2:
        raise InputError(
            f"an image {shape[2]} px wide is not two views side by side, the fringes left and the mirror "
            "right; give an even width, as in a size of 128 x 256 px"
        )
    return shape[2] // 2


def columns_of(targets: Sequence[str], asked: Sequence[str], model: str) -> Indices:
    """Where each of a model's targets stands among those asked for.

    Raises:
        InputError: they are not the same targets, in whatever order.
    """
    if sorted(targets) != sorted(asked):
        raise InputError(
            f"{model} estimates {', '.join(targets)}, no fewer and no others; asked for were "
            f"{', '.join(asked) or 'targets without names'}; ask for all of those, in any order"
        )
    return np.array([list(asked).index(name) for name in targets])


@dataclass(frozen=True)
class Scales:
    """How grey levels and targets become numbers of order one.

    Attributes:
        half: columns of each view [px].
        level, contrast: mean and spread of the fringe view and of the mirror view, over the rows learnt from
            [grey levels]. One for all channels, so that colours keep their proportions.
        targets: the scaler of the model's targets, in the model's order.
        order: where each target asked for stands in the model's order.
    """

    half: int
    level: tuple[float, float]
    contrast: tuple[float, float]
    targets: Scaler
    order: tuple[int, ...]

    @classmethod
    def of(
        cls,
        data: TrainingData,
        rows: Indices,
        columns: Indices,
        standardised: bool,
        rng: np.random.Generator,
    ) -> Scales:
        """Scales of these rows.

        Args:
            data: images and values.
            rows: those learnt from.
            columns: of `data.values`, in the model's order.
            standardised: whether targets are brought to zero mean and unit spread, or left in their units.
            rng: draws the images that are looked at.
        """
        half = half_width(data.shape)
        seen = data.sample(rows, SEEN_FOR_SCALE, rng)
        views = seen[..., :half], seen[..., half:]
        values = data.values[np.ix_(rows, columns)]
        plain = Scaler(np.zeros(len(columns)), np.ones(len(columns)))
        return cls(
            half,
            (float(views[0].mean()), float(views[1].mean())),
            (float(views[0].std()) or 1.0, float(views[1].std()) or 1.0),
            Scaler.of(values) if standardised else plain,
            tuple(int(i) for i in np.argsort(columns)),
        )
