"""Models behind one small interface, and the list of them by name; those of others by ``module:Class``."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError

from palpate.core import InputError, PluginError, Progress, silent
from palpate.core.plugins import ERROR, PluginRegistry, import_path, plugin_calls
from palpate.core.sensor import MODELS_OF_SENSORS
from palpate.estimators.networks.model_interface import Fitted, Model, TrainingData


@dataclass(frozen=True, slots=True)
class Kind:
    """Location of a model's code, its input and output; plug-ins may have a class variable ``kind``.

    Attributes:
        path: ``module:Class``; empty for plug-ins.
        side_px: Default side of the square input [px].
        costly: Whether retraining it for every fold takes long.
        channels: Channels it needs, 1 or 3; 0 for any.
        delta: Whether it needs differences from the reference; None for either.
        targets: Targets, if fixed.
        regions: Regions of a frame that it sees side by side; empty for the whole.
    """

    path: str = ""
    side_px: int = 112
    costly: bool = False
    channels: int = 0
    delta: bool | None = None
    targets: tuple[str, ...] = ()
    regions: tuple[str, ...] = ()


_GENERAL = {
    "mean": Kind("palpate.estimators.networks.pixel_models:MeanBaseline", 32),
    "pca-ridge": Kind("palpate.estimators.networks.pixel_models:PcaRidge", 112),
    "kernel-ridge": Kind("palpate.estimators.networks.kernel_ridge:KernelRidge", 128),
    "pixel-mlp": Kind("palpate.estimators.networks.pixel_models:PixelMlp", 64),
    "compact-cnn": Kind("palpate.estimators.networks.compact_cnn:CompactCnn", 224, costly=True),
}


class _Models(Mapping[str, Any]):
    """Models for any sensor, and those that a sensor's own folder declares."""

    def __getitem__(self, name: str) -> Any:
        if name in _GENERAL:
            return _GENERAL[name]
        return self._own(name.partition("-")[0])[name]

    def __iter__(self) -> Iterator[str]:
        return iter((*_GENERAL, *(name for sensor in MODELS_OF_SENSORS for name in self._own(sensor))))

    def __len__(self) -> int:
        return len(tuple(iter(self)))

    @staticmethod
    def _own(sensor: str) -> Mapping[str, Kind]:
        return import_path(MODELS_OF_SENSORS[sensor], "model") if sensor in MODELS_OF_SENSORS else {}


class _Paths(_Models):
    def __getitem__(self, name: str) -> Any:
        return super().__getitem__(name).path


MODELS: Mapping[str, Kind] = _Models()
REGISTRY = PluginRegistry("model", "palpate.models", _Paths())


def model_kind(name: str) -> Kind:
    """Return the kind of the named model."""
    path = REGISTRY.path_of(name)
    if name in MODELS:
        return MODELS[name]
    kind = getattr(model_class(path), "kind", Kind())
    if not isinstance(kind, Kind):
        raise PluginError(f"model {path}: its class variable kind is a {type(kind).__name__}, not a Kind")
    return kind


def model_class(path: str) -> type:
    """Return the class of a plug-in, a dataclass with a method `fit`."""
    model = import_path(path, "model")
    if not (isinstance(model, type) and is_dataclass(model)):
        raise PluginError(
            f"model {path} is not a dataclass; its settings are its fields, which the certificate tells"
        )
    if not callable(getattr(model, "fit", None)):
        raise PluginError(f"model {path} has no method fit(data, rows, *, seed, progress, checkpoint)")
    return model


def make_model(name: str, options: Mapping[str, Any]) -> Model:
    """Return a model by name or ``module:Class``, with some of its fields set."""
    path = REGISTRY.path_of(name)
    make = model_class(path)
    _check_options(name, make, options)
    with plugin_calls(f"model {name} with options {dict(options)} cannot be made ({ERROR})"):
        model: Model = make(**options)
    return model


def _check_options(name: str, make: type, options: Mapping[str, Any]) -> None:
    """Check options against a model's fields and types."""
    settable = [f for f in fields(make) if f.init]
    names = [f.name for f in settable]
    unknown = sorted(set(options) - set(names))
    if unknown:
        raise InputError(
            f"model {name} has no option {', '.join(unknown)}; it has {', '.join(names) or 'none'}",
            code="option-unknown",
        )
    needed = [f.name for f in settable if f.default is MISSING and f.default_factory is MISSING]
    if missing := [field for field in needed if field not in options]:
        raise InputError(f"model {name} needs the option {', '.join(missing)}; it has no default")
    hints: dict[str, Any] = {}
    with suppress(Exception):  # types that a plug-in names and does not import, say nothing
        hints = get_type_hints(make)
    for option in set(options) & set(hints):
        if not _is_of(hints[option], options[option]):
            kind = inspect.formatannotation(hints[option])
            raise InputError(f"model {name}: its option {option} is {options[option]!r}; give {kind}")


def _is_of(kind: Any, value: Any) -> bool:
    """Whether a value is of a type, as JSON represents it; True for types unknown to JSON."""
    try:
        TypeAdapter(kind).validate_json(json.dumps(value), strict=True)
    except ValidationError:
        return False
    except Exception:  # of a type without a schema, or a value such as a function
        return True
    return True


def settings_of(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return all of a model's fields."""
    model = make_model(name, options)
    return {f.name: getattr(model, f.name) for f in fields(model)}  # type: ignore[arg-type]


__all__ = [
    "MODELS", "REGISTRY", "Fitted", "Kind", "Model", "Progress", "TrainingData", "make_model",
    "model_class", "model_kind", "settings_of", "silent",
]  # fmt: skip
