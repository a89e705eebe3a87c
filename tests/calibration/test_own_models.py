"""A user's own models and splits: taken by name, class or instance, and refused by the law they break."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar

import numpy as np
import onnx
import pandas as pd
import pytest
from onnx import helper
from tests.refusals import refused
from typer.testing import CliRunner

from palpate import core
from palpate.calibration import CalibrationPlan, check_model
from palpate.cli import app
from palpate.core import InputError, PluginError, silent
from palpate.estimators import Estimator, read_card
from palpate.estimators.networks import Kind
from palpate.estimators.networks.onnx_graph import image_to_value
from palpate.recordings import Split, split
from palpate.recordings.label_tables import read_table

HERE = __name__
TINY = {"shape": (1, 12, 16)}


@dataclass(frozen=True)
class FittedLevel:
    """value = slope × mean grey level + offset."""

    shape: tuple[int, int, int]
    slope: np.ndarray
    offset: np.ndarray

    def predict(self, inputs: np.ndarray) -> np.ndarray:
        return inputs.mean(axis=(1, 2, 3), dtype=np.float64)[:, None] * self.slope + self.offset

    def to_onnx(self) -> onnx.ModelProto:
        nodes = [
            helper.make_node("ReduceMean", ["image", "axes"], ["level"], keepdims=0),
            helper.make_node("Reshape", ["level", "column"], ["levels"]),
            helper.make_node("Mul", ["levels", "slope"], ["rise"]),
            helper.make_node("Add", ["rise", "offset"], ["value"]),
        ]
        constants = {
            "axes": np.array([1, 2, 3], np.int64),
            "column": np.array([-1, 1], np.int64),
            "slope": self.slope.astype(np.float32)[None, :],
            "offset": self.offset.astype(np.float32)[None, :],
        }
        return image_to_value(nodes, constants, self.shape, len(self.offset))


@dataclass(frozen=True)
class Level:
    """A line through the mean grey level; `shrink` flattens it."""

    shrink: float = 1.0
    kind: ClassVar[Kind] = Kind(side_px=24)

    def fit(self, data, rows, *, seed, progress=silent, checkpoint=None) -> FittedLevel:
        level = np.array([data.fetch(np.array([row])).mean(dtype=np.float64) for row in rows])
        values = data.values[rows]
        centred = level - level.mean()
        slope = self.shrink * (centred @ (values - values.mean(axis=0))) / (centred @ centred)
        return FittedLevel(data.shape, slope, values.mean(axis=0) - slope * level.mean())


@dataclass(frozen=True)
class Broken(Level):
    """What `Level` learns, spoilt by one change."""

    change: Callable = field(default=lambda fitted, seed: fitted)

    def fit(self, data, rows, *, seed, progress=silent, checkpoint=None):
        return self.change(super().fit(data, rows, seed=seed), seed)


class Spoilt:
    """A fitted model with other methods."""

    def __init__(self, fitted, **methods) -> None:
        self.fitted = fitted
        for name in ("predict", "to_onnx"):
            setattr(self, name, methods.get(name, getattr(fitted, name)))


DRAWS = np.random.default_rng(0)


def wrong_values(fitted, change) -> Spoilt:
    return Spoilt(fitted, predict=lambda inputs: change(fitted.predict(inputs)))


BREAKS = {
    "no predict": (lambda fitted, _: object(), "model-methods"),
    "another shape": (lambda f, _: wrong_values(f, lambda v: v[:, 0]), "model-output"),
    "a list": (lambda f, _: wrong_values(f, lambda v: v.tolist()), "model-output"),
    "another unit": (lambda f, _: wrong_values(f, lambda v: v / 1000), "model-units"),
    "no number": (lambda f, _: wrong_values(f, lambda v: v * np.nan), "not-finite"),
    "chance": (
        lambda f, _: replace(f, offset=f.offset + DRAWS.uniform()),
        "model-chance",
    ),
    "other onnx": (
        lambda f, _: Spoilt(f, to_onnx=replace(f, slope=1.01 * f.slope).to_onnx),
        "onnx-differs",
    ),
    "onnx of another shape": (
        lambda f, _: Spoilt(f, to_onnx=replace(f, shape=(1, 8, 8)).to_onnx),
        "onnx-shape",
    ),
    "no onnx": (lambda f, _: Spoilt(f, to_onnx=lambda: b"onnx"), "plugin-import"),
    "exit in fit": (lambda *_: sys.exit(0), "plugin-import"),
    "exit in predict": (
        lambda f, _: Spoilt(f, predict=lambda inputs: sys.exit(0)),
        "plugin-import",
    ),
    "exit in to_onnx": (lambda f, _: Spoilt(f, to_onnx=lambda: sys.exit(0)), "plugin-import"),
}


@pytest.mark.parametrize("broken", BREAKS)
def test_a_model_that_breaks_a_law_is_refused_by_its_name_and_the_law(broken: str) -> None:
    change, code = BREAKS[broken]
    with refused(code, PluginError, f"{HERE}:Broken"):
        check_model(Broken(change=change), **TINY)


def test_a_model_that_keeps_the_laws_passes_as_class_instance_and_text() -> None:
    for model in (Level, Level(shrink=0.9), f"{HERE}:Level"):
        check_model(model, **TINY)
    for model in ("mean", "pca-ridge", "pixel-mlp"):
        check_model(model, shape=(1, 24, 32))


@dataclass(frozen=True)
class Peeks(Level):
    """Fetches rows that it may not learn from."""

    def fit(self, data, rows, *, seed, progress=silent, checkpoint=None):
        data.fetch(np.arange(len(data.values)))
        return super().fit(data, rows, seed=seed)


@dataclass(frozen=True)
class LearnsFromAll(Level):
    """Takes the mean of every row's labels."""

    def fit(self, data, rows, *, seed, progress=silent, checkpoint=None):
        fitted = super().fit(data, rows, seed=seed)
        return replace(fitted, offset=fitted.offset + 0 * data.values.mean(axis=0))


@pytest.mark.parametrize(("model", "code"), [(Peeks, "held-out-read"), (LearnsFromAll, "not-finite")])
def test_a_model_that_learns_from_held_out_rows_is_refused(model, code) -> None:
    with refused(code, PluginError):
        check_model(model, **TINY)


class NoDataclass:
    def fit(self) -> None: ...


@dataclass
class NoFit:
    pass


@pytest.mark.parametrize(
    ("model", "law"),
    [
        ("no_such_package:Model", "no_such_package:Model"),
        (f"{HERE}:NoSuchModel", "NoSuchModel"),
        (f"{HERE}:NoDataclass", "a dataclass"),
        (f"{HERE}:NoFit", "method fit"),
        (NoFit, "method fit"),
        (type("Local", (Level,), {"__qualname__": "f.<locals>.Local"}), "Local"),
    ],
)
def test_a_plan_refuses_what_is_no_model(model, law) -> None:
    with pytest.raises(PluginError, match=law):
        CalibrationPlan(("x_mm",), model=model)


def test_an_instance_s_settings_are_the_plan_s_options() -> None:
    plan = CalibrationPlan(("x_mm",), model=Level(shrink=0.5))
    assert (plan.model, plan.options) == (f"{HERE}:Level", {"shrink": 0.5})
    with pytest.raises(InputError, match="shrink"):
        CalibrationPlan(("x_mm",), model=Level(), options={"shrink": 0.5})


PLUGIN_FILE = """
from dataclasses import dataclass
import numpy as np
from palpate.estimators.networks.pixel_models import MeanBaseline, PcaRidge

@dataclass(frozen=True)
class Constant(MeanBaseline):
    pass

@dataclass(frozen=True)
class Line(PcaRidge):
    pass

def by_press(table, *, folds, seed):
    return table["press"]

def blocks(table, *, folds, seed):
    return np.arange(len(table)) * folds // len(table)
"""


@pytest.fixture
def plugin(tmp_path, monkeypatch) -> str:
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "my_touch_models.py").write_text(PLUGIN_FILE)
    monkeypatch.syspath_prepend(str(tmp_path / "plugins"))
    yield "my_touch_models"
    sys.modules.pop("my_touch_models", None)


@pytest.mark.slow
def test_a_certificate_of_an_own_model_is_opened_without_it(
    plugin, record_spots, tmp_path, monkeypatch
) -> None:
    run = record_spots("run", 10)
    words = ["calibrate", str(run.path), "--targets", "x_mm", "--model", f"{plugin}:Constant"]
    words += ["--split", f"{plugin}:by_press", "--size", "12x16", "--out", str(tmp_path / "cal"), "--quiet"]
    told = CliRunner().invoke(app, words)
    assert told.exit_code == 0, told.output
    card = read_card(tmp_path / "cal")
    assert (card.model_name, card.split.kind) == (f"{plugin}:Constant", f"{plugin}:by_press")
    table = read_table(tmp_path / "cal" / "predictions.csv.gz")
    assert table.groupby("press")["held_out_in_fold"].nunique().eq(1).all()
    sys.modules.pop(plugin)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if not p.endswith("plugins")])
    readings = Estimator.open(tmp_path / "cal").read(run.frame(1).image)
    assert np.isfinite(readings["x_mm"].value)


@dataclass(frozen=True)
class Rewrites(Level):
    """Makes the labels easy to estimate."""

    def fit(self, data, rows, *, seed, progress=silent, checkpoint=None):
        data.values[:] = 1
        return super().fit(data, rows, seed=seed)


def test_a_model_cannot_rewrite_the_labels() -> None:
    with pytest.raises(PluginError, match=r"Rewrites: fit.* failed .*read-only"):
        check_model(Rewrites, **TINY)


def added(monkeypatch, group: str, **names: str) -> None:
    points = [EntryPoint(name.replace("_", "-"), value, group) for name, value in names.items()]
    monkeypatch.setattr(core.plugins, "installed", lambda group: [p for p in points if p.group == group])


def test_an_entry_point_that_takes_an_existing_name_is_refused(monkeypatch) -> None:
    added(monkeypatch, "palpate.models", kernel_ridge=f"{HERE}:Level")
    with pytest.raises(PluginError, match=f"'kernel-ridge' of {HERE}:Level takes the name of palpate"):
        CalibrationPlan(("x_mm",))
    added(monkeypatch, "palpate.splits", auto=f"{HERE}:halves")
    with pytest.raises(PluginError, match=f"split 'auto' of {HERE}:halves takes the name of palpate itself"):
        CalibrationPlan(("x_mm",))


TABLE = pd.DataFrame({"press": list("aabbccdd"), "x_mm": np.arange(8.0)})


def halves(table, *, folds, seed):
    return np.arange(len(table)) // 4


def gives(make):
    """A split function that returns what `make` makes of the table."""
    return lambda table, *, folds, seed: make(table)


def spoilt(**fields):
    """A split whose fields are not of the kinds that type checkers ask for."""
    parts = Split("any", (), None, (np.arange(4), np.arange(4, 8)), "")
    for name, value in fields.items():
        object.__setattr__(parts, name, value)
    return parts


PARTS = (np.arange(3), np.arange(3, 8))
exact = gives(lambda table: Split("any", (), None, PARTS, "three first"))
too_few = gives(lambda table: [0, 1])
repeats = gives(lambda table: Split("any", (), None, (np.arange(8), np.arange(2)), ""))
tears = gives(lambda table: Split("any", (), table["press"].to_numpy(str), PARTS, ""))
one = gives(lambda table: Split("any", (), None, (np.arange(8),), ""))
chance = gives(lambda table: DRAWS.permutation(8))
fails = gives(lambda table: {}["place"])
leaves = gives(lambda table: sys.exit(0))
float_folds = gives(lambda table: spoilt(folds=(np.arange(4.0), np.arange(4.0, 8.0))))
ragged_folds = gives(lambda table: spoilt(folds=([[0, 1], [2]], [3])))
no_folds = gives(lambda table: spoilt(folds=None))
mixed = gives(lambda table: spoilt(groups=np.array([1, 1, 1, 1, "b", "b", "b", "b"], object)))
no_reason = gives(lambda table: spoilt(reason=None))
no_columns = gives(lambda table: spoilt(group_columns=None))
ragged = gives(lambda table: [["a"], ["a", "b"], *table["press"][2:]])
gaps = gives(lambda table: table["press"].where(table["x_mm"] > 0))
gap_in_a_list = gives(lambda table: ["a", "b", None, float("nan"), *table["press"][4:]])
not_a_function = 3


def test_a_split_of_one_s_own_gives_groups_or_the_folds_themselves() -> None:
    grouped = split(TABLE, f"{HERE}:halves", folds=2)
    assert [fold.tolist() for fold in grouped.folds] == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert grouped.groups is not None
    assert [len(fold) for fold in split(TABLE, f"{HERE}:exact").folds] == [3, 5]
    assert CalibrationPlan(("x_mm",), split=halves).split == f"{HERE}:halves"


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("too_few", r"\[2\] for"),
        ("repeats", "rows once"),
        ("tears", "group b"),
        ("one", "1 folds"),
        ("chance", "other folds"),
        ("fails", "KeyError"),
        ("leaves", "SystemExit"),
        ("float_folds", "row numbers"),
        ("ragged_folds", "numbers|ValueError"),
        ("no_folds", "row numbers"),
        ("mixed", "'<' not"),
        ("no_reason", "its reason"),
        ("no_columns", "of texts"),
        ("ragged", "row's group"),
        ("gaps", "row 2"),
        ("gap_in_a_list", "rows 4, 5"),
        ("not_a_function", "no function"),
        ("missing", "not import"),
    ],
)
@pytest.mark.cases(8)
def test_a_split_that_breaks_a_law_is_refused_by_its_name_and_the_law(name: str, law: str) -> None:
    with pytest.raises(PluginError, match=rf"{name}.*{law}"):
        split(TABLE, f"{HERE}:{name}", folds=2)


def test_the_model_of_the_how_to_keeps_the_laws(tmp_path, monkeypatch) -> None:
    page = Path(__file__).parents[2] / "docs" / "how-to" / "bring-your-own-model.md"
    code = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    (tmp_path / "my_how_to_models.py").write_text(code[0] + code[2])
    monkeypatch.syspath_prepend(str(tmp_path))
    check_model("my_how_to_models:Level", targets=("depth_mm",))
    table = pd.DataFrame({"time_of_day_s": [0.0, 30.0, 70.0, 80.0]})
    assert split(table, "my_how_to_models:by_minute", folds=2).folds[0].tolist() in ([0, 1], [2, 3])
