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
    """

    file: str
    name: str
    side_px: int
    costly: bool = False


MODELS: dict[str, Kind] = {
    "mean": Kind("mean", "Mean", 32),
    "pca-ridge": Kind("pca_ridge", "PcaRidge", 112),
    "pixel-mlp": Kind("pixel_mlp", "PixelMlp", 64),
    "compact-cnn": Kind("compact_cnn", "CompactCnn", 224, costly=True),
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


__all__ = [
    "MODELS",
    "Fitted",
    "Kind",
    "Model",
    "Progress",
    "TrainingData",
    "make_model",
    "model_kind",
    "silent",
]
