"""A calibration in int8: it opens, answers nearly as before, and tells by how much it errs more."""

import json
import shutil

import numpy as np
import onnx
import pytest
import typer
from onnx import TensorProto, helper
from typer.testing import CliRunner

from palpate.calibration import CalibrationPlan, ReferenceRule, calibrate
from palpate.calibration.quantisation import cost, nodes_to_round, quantise
from palpate.cli.calibrate.calibrate_verbs import _quantised_text, quantise as verb
from palpate.core import CertificateError, ExistsError, InputError, ManualClock
from palpate.core.files import sha256_of
from palpate.estimators import Estimator, read_card
from palpate.estimators.model_card import sealed
from palpate.recordings import Manifest, Run, RunWriter
from palpate.recordings.table_files import read_table, write_table

pytest.importorskip("torch", reason="networks with convolutions train with torch")

TARGETS = ("x_mm", "height_mm")
NETWORK = {"widths": (8, 12, 16), "members": 1, "hidden": 16, "epochs": 6, "batch": 16, "shift_px": 0}
PLAN = CalibrationPlan(
    TARGETS, model="compact-cnn", split="group:press", scored_folds=1, size_px=(24, 32), options=NETWORK
)
CHANGES = 0.05
"""Share of a target's range that no estimate may change by: 8 bits hold 1/255 of each map, in two layers."""


def record(folder, *, presses: int = 40, seed: int = 0, two_views: bool = False) -> Run:
    """A bright spot whose place and height are the labels; before each press a frame without it."""
    rng, clock = np.random.default_rng(seed), ManualClock()
    labels = {"press": "text", "reference": "flag"} | dict.fromkeys(
        ("depth_mm", "x_mm", "y_mm", "force_N", "height_mm"), "number"
    )
    rows, columns = np.mgrid[0:24, 0:32]
    with RunWriter.create(
        folder, Manifest.new(sensor="spots", labels=labels), clock=clock, overflow="wait"
    ) as writer:
        for press in range(presses):
            for i in range(5):
                place, height = rng.uniform(-2, 2), rng.uniform(0.5, 2.0) * (i > 0)
                spot = np.exp(-((columns - 16 - 4 * place) ** 2 + (rows - 12) ** 2) / 15)
                image = 60 + 70 * height * spot + rng.normal(0, 1.5, spot.shape)
                if two_views:
                    image = np.tile(np.pad(image, ((4, 4), (0, 0)), mode="edge"), (1, 2))
                clock.sleep(0.1)
                held = {
                    "x_mm": place,
                    "height_mm": height,
                    "depth_mm": height,
                    "y_mm": place,
                    "force_N": height,
                }
                writer.frame(
                    np.clip(image, 0, 255).astype(np.uint8),
                    labels=held | {"press": f"press-{press:02d}", "reference": i == 0},
                )
    return Run.open(folder)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    return record(tmp_path_factory.mktemp("spots") / "run")


@pytest.fixture(scope="module")
def calibration(run, tmp_path_factory):
    return calibrate(run, PLAN, tmp_path_factory.mktemp("cal") / "cal")


@pytest.fixture(scope="module")
def quantised(calibration, run, tmp_path_factory):
    """The int8 copy, and what the source folder's files were before."""
    before = bytes_of(calibration)
    out = tmp_path_factory.mktemp("int8") / "cal"
    quantise(calibration, run, out)
    return out, before


def bytes_of(folder) -> dict[str, str]:
    return {path.name: sha256_of(path) for path in folder.iterdir()}


def test_the_copy_opens_and_its_convolutions_are_in_int8(quantised) -> None:
    Estimator.open(quantised[0])
    kinds = [node.op_type for node in onnx.load(quantised[0] / "model.onnx").graph.node]
    # Its two convolutions behind the one that sees the image: a weight and an input are read back for each.
    assert kinds.count("Conv") == 3
    assert kinds.count("DequantizeLinear") >= 4
    assert "BatchNormalization" not in kinds
    assert {family.domain for family in onnx.load(quantised[0] / "model.onnx").opset_import} == {""}


def test_the_source_is_left_as_it_was(calibration, quantised) -> None:
    assert bytes_of(calibration) == quantised[1]


def test_frames_it_never_saw_are_read_nearly_as_before(calibration, quantised, tmp_path) -> None:
    fresh = record(tmp_path / "fresh", presses=12, seed=1)
    both = [Estimator.open(folder) for folder in (calibration, quantised[0])]
    before, now = (
        np.array([[r.value for r in each.read(frame).values()] for frame in fresh.frames()]) for each in both
    )
    span = [target.greatest - target.least for target in both[0].card.targets]
    changed = np.abs(now - before) / span
    assert 0 < changed.max() < CHANGES


def test_the_cost_told_is_the_one_that_the_networks_have(calibration, quantised, run) -> None:
    found = cost(calibration, quantised[0])
    pressed = np.flatnonzero(run.labels["reference"].astype(str).str.lower() != "true")
    held = pressed[read_table(calibration / "predictions.csv.gz")["row"].to_numpy()]
    for i, folder in enumerate((calibration, quantised[0])):
        estimator = Estimator.open(folder)
        for column in TARGETS:
            said = [estimator.read(run.frame(int(row)))[column].in_unit("mm").value for row in held]
            mae = np.abs(np.array(said) - run.labels[column].to_numpy()[held]).mean()
            assert found.mae[column][i] == pytest.approx(mae, rel=1e-5)
    assert min(found.seconds) > 0


def test_the_card_says_that_it_is_int8_of_what_and_at_what_cost(calibration, quantised) -> None:
    before, now = read_card(calibration), read_card(quantised[0])
    assert now.options["int8"]
    assert now.options["quantised_from"] == before.id != now.id
    for target in before.targets:
        assert now.options["fp32_mae"][target.column] == pytest.approx(target.score.mae, rel=1e-3)
    assert before.agreement < now.agreement < CHANGES
    assert now.split == before.split
    assert now.run == before.run


def test_intervals_are_set_by_what_int8_said(quantised) -> None:
    card, table = read_card(quantised[0]), read_table(quantised[0] / "predictions.csv.gz")
    for target in card.targets:
        error = (table[f"estimate:{target.column}"] - table[target.column]).abs()
        inside = (error <= table[f"half_width:{target.column}"]).mean()
        assert inside == target.score.coverage_90
        assert error.mean() == pytest.approx(target.score.mae)
        assert abs(inside - card.coverage) < 0.1


def test_another_run_is_refused_and_leaves_nothing(calibration, tmp_path) -> None:
    other = record(tmp_path / "other", presses=3, seed=2)
    with pytest.raises(InputError, match="is not the run that calibration"):
        quantise(calibration, other, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def test_what_is_int8_already_and_what_exists_is_refused(calibration, quantised, run, tmp_path) -> None:
    with pytest.raises(InputError, match="int8 already"):
        quantise(quantised[0], run, tmp_path / "out")
    with pytest.raises(ExistsError):
        quantise(calibration, run, tmp_path)
    with pytest.raises(InputError, match="was not made from"):
        cost(quantised[0], calibration)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("held_out", "says"), [(None, "none that it has not seen"), (1, "no convolution behind")]
)
def test_a_network_that_int8_cannot_help_or_be_judged_on_is_refused(held_out, says, run, tmp_path) -> None:
    plan = CalibrationPlan(TARGETS, split="group:press", scored_folds=held_out, size_px=(24, 32))
    calibrate(run, plan, tmp_path / "cal")
    with pytest.raises(InputError, match=says):
        quantise(tmp_path / "cal", run, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["cal"]


def test_a_calibration_adapted_to_another_copy_is_refused(calibration, run, tmp_path) -> None:
    shutil.copytree(calibration, tmp_path / "cal")
    adapted = sealed(read_card(calibration).model_dump(exclude={"id"}) | {"adapted_from": "0123456789ab"})
    (tmp_path / "cal" / "card.json").write_text(adapted.model_dump_json())
    with pytest.raises(InputError, match="is adapted from"):
        quantise(tmp_path / "cal", run, tmp_path / "out")


def test_a_network_that_is_not_the_one_scored_is_refused(calibration, run, tmp_path) -> None:
    shutil.copytree(calibration, tmp_path / "cal")
    told, card = tmp_path / "cal" / "predictions.csv.gz", read_card(calibration)
    table = read_table(told)
    table["estimate:x_mm"] += 0.1
    write_table(table, told)
    files = [{"file": p.file, "sha256": sha256_of(tmp_path / "cal" / p.file)} for p in card.files]
    altered = sealed(card.model_dump(exclude={"id"}) | {"files": files})
    (tmp_path / "cal" / "card.json").write_text(altered.model_dump_json())
    with pytest.raises(CertificateError, match="from the estimates it was scored by"):
        quantise(tmp_path / "cal", run, tmp_path / "out")


@pytest.mark.slow
def test_the_palms_network_of_two_views_in_differences_goes_the_same_way(tmp_path) -> None:
    run = record(tmp_path / "run", presses=20, two_views=True)
    plan = CalibrationPlan(
        ("depth_mm", "x_mm", "y_mm", "force_N"),
        model="palm-compact",
        split="group:press",
        scored_folds=1,
        size_px=(32, 64),
        channels=3,
        crop_px=(0, 0, 32, 32),
        beside_px=(32, 0, 32, 32),
        delta=True,
        reference=ReferenceRule("reference", "true", ("press",)),
        options={"rendered": 0, "epochs": 4, "batch": 8},
    )
    calibrate(run, plan, tmp_path / "cal")
    card = quantise(tmp_path / "cal", run, tmp_path / "int8")
    assert 0 < card.agreement < CHANGES
    assert Estimator.open(tmp_path / "int8").card.options["rendered"] == 0


def test_first_convolutions_dense_layers_and_the_last_sum_are_not_rounded() -> None:
    def node(kind: str, inputs: list[str], output: str):
        return helper.make_node(kind, inputs, [output], name=output)

    nodes = [
        node("Sub", ["image", "w"], "scaled"),
        node("Conv", ["scaled", "w"], "first"),
        node("Relu", ["first"], "seen"),
        node("Conv", ["seen", "w"], "second"),
        node("Add", ["second", "seen"], "residual"),
        node("Gemm", ["residual", "w"], "dense"),
        node("Add", ["dense", "w"], "value"),
    ]
    weights = [helper.make_tensor("w", TensorProto.FLOAT, [1], [1.0])]
    graph = helper.make_graph(nodes, "residual", [], [], weights)
    assert nodes_to_round(graph) == ["seen", "second", "residual"]


@pytest.mark.slow
def test_the_verb_prints_what_int8_costs(calibration, run, tmp_path) -> None:
    app, out = typer.Typer(), tmp_path / "int8"
    app.command()(verb)
    words = [str(calibration), str(run.path), "--quiet", "--json", "--out", str(out)]
    printed = CliRunner().invoke(app, words)
    assert printed.exit_code == 0, printed.output
    found, now = json.loads(printed.output), read_card(out)
    assert found["calibration"] == now.id
    for target in now.targets:
        assert found["targets"][target.column]["int8_mae"] == target.score.mae
    assert set(found["network_ms"]) == {"fp32", "int8"}
    assert (out / "report.html").is_file()
    text = _quantised_text(now.id, out, found["targets"], {"fp32": 1.0, "int8": 2.0})
    assert "MAE fp32" in text
    assert "gains nothing on this machine" in text
