"""The laws that a model of a user's must keep, checked on a small made-up set before a calibration begins."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
import onnxruntime

from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.certificate import AGREEMENT
from palpate.core import CertificateError, Indices, InputError, PluginError, Tensor, Values
from palpate.core.plugins import ERROR, plugin_calls
from palpate.estimators.admission import admit_model
from palpate.estimators.networks import MODELS, make_model, model_kind, settings_of
from palpate.estimators.networks.model_interface import Fitted, TrainingData

GROUPS, ROWS_A_GROUP = 12, 3
HELD_OUT_GROUPS = 2


def check_model(
    model: Any,
    options: Mapping[str, Any] | None = None,
    *,
    shape: tuple[int, int, int] | None = None,
    targets: tuple[str, ...] = ("depth_mm", "force_N"),
) -> None:
    """Check that a model keeps the laws of models, by training it twice on 30 synthetic images.

    Args:
        model: class, instance, ``module:Class``, or name.
        options: its settings.
        shape: (channels, height, width) of its input; None takes its default.
        targets: columns to estimate, where it does not fix them itself.

    Raises:
        PluginError: it breaks a law; the message names the model and the law.
        InputError: there is no such model, or no such option.

    Example:
        >>> check_model("pca-ridge", shape=(1, 24, 32))
    """
    plan = CalibrationPlan(targets, model=model, options=dict(options or {}))
    kind = model_kind(plan.model)
    columns = kind.targets or tuple(plan.targets)
    sample = _MadeUp.of(
        shape or (kind.channels or 1, kind.side_px, kind.side_px * max(len(kind.regions), 1)), columns
    )
    fitted = _fitted(plan, sample)
    _check_estimates(plan.model, fitted, sample)
    _check_same_again(plan, fitted, sample)
    _check_onnx(plan.model, fitted, sample)


def check_plugged_in(plan: CalibrationPlan, shape: tuple[int, int, int]) -> None:
    """Check that a card can state a model's fields, and all laws of a plug-in."""
    for name, value in settings_of(plan.model, plan.options).items():
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as e:
            raise InputError(
                f"model {plan.model}: its field {name} is {type(value).__name__} that no certificate can "
                f"tell ({e}); give numbers, texts, or lists of these",
                code="field-kind",
            ) from e
    if plan.model not in MODELS:
        fixed = tuple(model_kind(plan.model).targets)
        if fixed not in ((), tuple(plan.targets)):
            raise InputError(
                f"model {plan.model} estimates {', '.join(fixed)}; asked for were {', '.join(plan.targets)}; "
                "ask for its own, in its order",
                code="model-targets",
            )
        asked = (*plan.targets, *(f"{column}_ratio" for column in plan.classes))
        check_model(plan.model, plan.options, shape=shape, targets=asked)


@dataclass
class _MadeUp:
    """Spots whose brightness encodes the targets, in twelve groups of three rows, two groups held out.

    Attributes:
        values: NaN where held out, so that training on them shows.
        trespass: held-out rows fetched while training.
    """

    images: Tensor
    values: Values
    names: tuple[str, ...]
    learnt: Indices
    trespass: list[int] = field(default_factory=list)

    @classmethod
    def of(cls, shape: tuple[int, int, int], names: tuple[str, ...]) -> _MadeUp:
        rng, n = np.random.default_rng(0), GROUPS * ROWS_A_GROUP
        level = rng.uniform(0, 1, n)
        rows, columns = np.mgrid[-1 : 1 : shape[1] * 1j, -1 : 1 : shape[2] * 1j]
        spot = np.exp(-4 * (rows**2 + columns**2))
        images = 40 + 150 * level[:, None, None, None] * spot + rng.normal(0, 2, (n, *shape))
        values = np.stack([10.0 ** (2 - k % 3) * (2 + level) for k in range(len(names))], axis=1)
        learnt = np.arange((GROUPS - HELD_OUT_GROUPS) * ROWS_A_GROUP)
        values[len(learnt) :] = np.nan
        return cls(images.astype(np.float32), values, names, learnt)

    @property
    def data(self) -> TrainingData:
        return TrainingData(
            self.images.shape[1:],
            self.values,
            np.repeat(np.arange(GROUPS), ROWS_A_GROUP),
            self._fetch,
            self.names,
        )

    def _fetch(self, rows: Indices) -> Tensor:
        self.trespass += np.setdiff1d(rows, self.learnt).tolist()
        return self.images[rows]


def _fitted(plan: CalibrationPlan, sample: _MadeUp) -> Fitted:
    name, rows = plan.model, sample.learnt.copy()
    with plugin_calls(
        f"model {name}: fit(data, rows, *, seed, progress, checkpoint) failed on {len(rows)} rows of "
        f"{list(sample.images.shape[1:])} ({ERROR})"
    ):
        fitted = make_model(name, plan.options).fit(sample.data, rows, seed=0)
    if sample.trespass:
        raise PluginError(
            f"model {name} fetched rows it may not learn from: {sample.trespass[:5]}; keep to `rows`",
            code="held-out-read",
        )
    if not isinstance(fitted, Fitted):
        raise PluginError(
            f"model {name}: fit gave a {type(fitted).__name__}, which lacks predict(inputs) or to_onnx()",
            code="model-methods",
        )
    return fitted


def _predicted(name: str, fitted: Fitted, inputs: Tensor, count: int) -> Values:
    with plugin_calls(f"model {name}: predict failed on {list(inputs.shape)} ({ERROR})", ()):
        estimates: Any = fitted.predict(inputs)
    shape = (len(inputs), count)
    if not isinstance(estimates, np.ndarray) or estimates.shape != shape or estimates.dtype.kind != "f":
        array = isinstance(estimates, np.ndarray)
        got = f"{estimates.dtype} {list(estimates.shape)}" if array else type(estimates).__name__
        raise PluginError(
            f"model {name}: predict gave {got} for {len(inputs)} images, not floats {list(shape)}",
            code="model-output",
        )
    if not np.isfinite(estimates).all():
        raise PluginError(
            f"model {name}: predict gave what is no number; it learns from `rows` and no others",
            code="not-finite",
        )
    return estimates


def _check_estimates(name: str, fitted: Fitted, sample: _MadeUp) -> None:
    """Shape for one image and for several, and the unit: near the values learnt, not a thousandth of them."""
    labels = sample.values[sample.learnt]
    _predicted(name, fitted, sample.images[:1], len(sample.names))
    mean = _predicted(name, fitted, sample.images[sample.learnt], len(sample.names)).mean(axis=0)
    least, greatest = labels.min(axis=0), labels.max(axis=0)
    span = greatest - least
    for column, value, low, high in zip(sample.names, mean, least - span, greatest + span, strict=True):
        if not low <= value <= high:
            raise PluginError(
                f"model {name}: {column} is {value:.3g} on average over rows whose labels are {low:.3g} to "
                f"{high:.3g} or nearer; predict gives the targets in their own units",
                code="model-units",
            )


def _check_same_again(plan: CalibrationPlan, fitted: Fitted, sample: _MadeUp) -> None:
    again = _fitted(plan, sample)
    first, second = (_predicted(plan.model, one, sample.images, len(sample.names)) for one in (fitted, again))
    if not np.allclose(first, second, rtol=1e-6, atol=0):
        raise PluginError(
            f"model {plan.model}: the same rows and seed give other estimates; draw all chance from `seed`",
            code="model-chance",
        )


def _check_onnx(name: str, fitted: Fitted, sample: _MadeUp) -> None:
    """The ONNX model, which is what senses: its names and shapes, and the same estimates."""
    with plugin_calls(f"model {name}: to_onnx gave no model that runs ({ERROR})", ()):
        model: Any = fitted.to_onnx()
        onnx.checker.check_model(model)
        session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    inputs = {one.name: one.shape[1:] for one in session.get_inputs()}
    outputs = {one.name: one.shape[1:] for one in session.get_outputs()}
    expected = {"image": list(sample.images.shape[1:])}, {"value": [len(sample.names)]}
    if (inputs, outputs) != expected:
        raise PluginError(
            f"model {name}: its ONNX model takes {inputs} and gives {outputs}, not {expected[0]} and "
            f"{expected[1]} behind a free first axis",
            code="onnx-shape",
        )
    try:
        admit_model(model.SerializeToString(), "its ONNX model", sample.images.shape[1:], len(sample.names))
    except CertificateError as e:
        raise PluginError(f"model {name}: {e}", code=e.code) from e
    span = np.ptp(sample.values[sample.learnt], axis=0)
    (estimates,) = session.run(["value"], {"image": sample.images})
    apart = float(np.max(np.abs(estimates - fitted.predict(sample.images)) / span))
    if not apart <= AGREEMENT:
        raise PluginError(
            f"model {name}: its ONNX model and predict differ by {apart:.2g} of a target's range; at most "
            f"{AGREEMENT:g}",
            code="onnx-differs",
        )
