"""Models behind one small interface, and the list of them by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from importlib import import_module
from typing import Any

from palpate.core.errors import InputError, MissingExtraError
from palpate.estimators.networks.base import Fitted, Model, Progress, TrainingData, silent

MODELS: dict[str, tuple[str, str, int]] = {
    "mean": ("mean", "Mean", 32),
    "pca-ridge": ("pca_ridge", "PcaRidge", 112),
    "pixel-mlp": ("pixel_mlp", "PixelMlp", 64),
    "compact-cnn": ("compact_cnn", "CompactCnn", 160),
}
"""name -> (file, class, side of the input in px where none is asked for)."""


def make_model(name: str, options: Mapping[str, Any]) -> Model:
    """A model by name, with some of its fields set.

    Raises:
        InputError: no such model, or no such option; the message lists those there are.
        MissingExtraError: the model needs a package that is not installed.
    """
    if name not in MODELS:
        raise InputError(f"there is no model {name!r}; there are {', '.join(MODELS)}")
    file, kind, _ = MODELS[name]
    try:
        make: Callable[..., Model] = getattr(import_module(f"palpate.estimators.networks.{file}"), kind)
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


def model_size(name: str) -> int:
    """Side of the square input that a model takes where none is asked for [px]."""
    if name not in MODELS:
        raise InputError(f"there is no model {name!r}; there are {', '.join(MODELS)}")
    return MODELS[name][2]


__all__ = ["MODELS", "Fitted", "Model", "Progress", "TrainingData", "make_model", "model_size", "silent"]
