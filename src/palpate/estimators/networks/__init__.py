"""Models behind one small interface, and the list of them by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any

from palpate.core.errors import InputError, MissingExtraError
from palpate.estimators.networks.base import Fitted, Model, Progress, TrainingData, silent


@dataclass(frozen=True, slots=True)
class Kind:
    """Where a model's code is, and what it is like.

    Attributes:
        file, name: module and class.
        side_px: of the square input it takes where no size is asked for [px].
        costly: whether training it again for every fold is more than most would wait for.
        channels: it was made for, 1 or 3; 0 where any will do.
        delta: whether it was made for differences from the untouched sensor; None where either will do.
        targets: what it estimates, where that is fixed; empty where it estimates what it is asked.
        views: how many parts of a frame it sees, side by side.
    """

    file: str
    name: str
    side_px: int
    costly: bool = False
    channels: int = 0
    delta: bool | None = None
    targets: tuple[str, ...] = ()
    views: int = 1


_FORCES = ("force_x_N", "force_y_N", "force_N")
_PLACE = ("x_mm", "y_mm")

MODELS: dict[str, Kind] = {
    "mean": Kind("mean", "Mean", 32),
    "pca-ridge": Kind("pca_ridge", "PcaRidge", 112),
    "pixel-mlp": Kind("pixel_mlp", "PixelMlp", 64),
    "compact-cnn": Kind("compact_cnn", "CompactCnn", 224, costly=True),
    "palm-joint-raw": Kind(
        "palm_joint_raw",
        "PalmJointRaw",
        128,
        costly=True,
        channels=3,
        delta=False,
        targets=(*_FORCES, *_PLACE),
        views=2,
    ),
    "palm-force-conditioned": Kind(
        "palm_force_conditioned",
        "PalmForceConditioned",
        128,
        costly=True,
        channels=3,
        delta=True,
        targets=("force_N", *_PLACE),
        views=2,
    ),
    "palm-mlp-delta": Kind(
        "palm_mlp_delta", "PalmMlpDelta", 128, channels=1, delta=True, targets=_FORCES, views=2
    ),
    "palm-two-stage": Kind(
        "palm_two_stage",
        "PalmTwoStage",
        128,
        costly=True,
        channels=1,
        delta=True,
        targets=("depth_mm", *_PLACE, *_FORCES, "force_magnitude_N"),
        views=2,
    ),
    "palm-compact": Kind(
        "palm_compact",
        "PalmCompact",
        96,
        costly=True,
        channels=3,
        delta=True,
        targets=("depth_mm", *_PLACE, "force_N"),
        views=2,
    ),
}


def model_kind(name: str) -> Kind:
    """What the named model is like.

    Raises:
        InputError: there is no such model; the message lists those there are.
    """
    if name not in MODELS:
        raise InputError(f"there is no model {name!r}; there are {', '.join(MODELS)}")
    return MODELS[name]


def make_model(name: str, options: Mapping[str, Any]) -> Model:
    """A model by name, with some of its fields set.

    Raises:
        InputError: no such model, or no such option; the message lists those there are.
        MissingExtraError: the model needs a package that is not installed.
    """
    kind = model_kind(name)
    try:
        module = import_module(f"palpate.estimators.networks.{kind.file}")
        make: Callable[..., Model] = getattr(module, kind.name)
    except ImportError as e:
        raise MissingExtraError(
            f"model {name} needs {e.name}, which is not installed; run: pip install 'palpate[train]'"
        ) from e
    known = [f.name for f in fields(make)]  # type: ignore[arg-type]
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise InputError(
            f"model {name} has no option {', '.join(unknown)}; it has {', '.join(known) or 'none'}"
        )
    return make(**options)


def settings_of(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """All of a model's fields, as a card tells them: those that were set, and those that were not."""
    model = make_model(name, options)
    return {f.name: getattr(model, f.name) for f in fields(model)}  # type: ignore[arg-type]


__all__ = [
    "MODELS",
    "Fitted",
    "Kind",
    "Model",
    "Progress",
    "TrainingData",
    "make_model",
    "model_kind",
    "settings_of",
    "silent",
]
