"""Quantisation of a calibration's network to int8: faster, and never without what that costs.

Activations and weights are rounded to 8 bits with a scale for each tensor, for weights one for each output
channel (Jacob et al., CVPR 2018, doi:10.1109/CVPR.2018.00286). The scales of activations are set by images.

Only convolutions are rounded, with their rectifiers and the sums of residual blocks. Those that see the image
itself, and the dense layers, stay in float32: they take little time, and rounding them costs the most.

The scales that the network rounds by are set by images that it has learnt from. What the rounding costs is
measured on the rows that the calibration held out, by the calibration's own measures, and its intervals are
set anew from what the rounded network says of them.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnx
import onnxruntime
import pandas as pd
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from palpate.calibration.calibration_plan import CalibrationPlan, ReferenceRule
from palpate.calibration.certificate import (
    PREDICTIONS_FILE,
    WORST,
    interval_fields,
    made_fields,
    read_predictions,
    write_picture,
)
from palpate.calibration.confounds.deciding_pixels import MAP_FILE
from palpate.calibration.coverage import range_cards
from palpate.calibration.coverage.conformal import fit_intervals
from palpate.calibration.coverage.counted_groups import held_out_groups
from palpate.calibration.evaluation import score
from palpate.calibration.training_data import learning_set, rows_to_learn
from palpate.core import (
    CertificateError,
    Indices,
    InputError,
    PathText,
    Progress,
    Tensor,
    Values,
    new_folder,
    refuse_existing,
    silent,
)
from palpate.estimators.certified import CARD_FILE, Estimator, checked_file
from palpate.estimators.model_card import Card, TargetCard, sealed
from palpate.estimators.networks.model_interface import TrainingData
from palpate.recordings import PackedSet, Run, pack
from palpate.recordings.label_tables import own_column
from palpate.recordings.table_files import write_table

ROUNDED = ("Conv", "Relu", "Add")


def int8_model(model: Path, images: Iterator[Tensor], work: Path) -> onnx.ModelProto:
    """A model in int8, self-contained and of standard operators alone.

    Args:
        model: one from `image` to `value`, in float32.
        images: inputs to set the scales of activations by.
        work: a folder for passing files.

    Raises:
        InputError: it has no convolution to round.
    """
    fused, rounded = work / "fused.onnx", work / "int8.onnx"
    # Normalisation goes into the convolutions before them. Shapes are told apart without symbols, which would
    # need another package.
    quant_pre_process(str(model), str(fused), skip_symbolic_shape=True)
    plain = onnx.load(str(fused))
    for i, node in enumerate(plain.graph.node):
        node.name = f"{node.op_type}{i}"
    chosen = nodes_to_round(plain.graph)
    if not any(name.startswith("Conv") for name in chosen):
        raise InputError(
            f"{model} has no convolution behind those that see the image, so that int8 would gain nothing; "
            "keep it as it is"
        )
    onnx.save(plain, str(fused))
    quantize_static(
        str(fused),
        str(rounded),
        _Images(images),
        quant_format=QuantFormat.QDQ,
        op_types_to_quantize=list(ROUNDED),
        nodes_to_quantize=chosen,
        per_channel=True,
        # With weights of 7 bits a sum of two products fits 16: the numbers are the same without VNNI.
        reduce_range=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
    )
    return _tidied(onnx.load(str(rounded)))


def nodes_to_round(graph: onnx.GraphProto) -> list[str]:
    """Names of the convolutions behind the first ones, their rectifiers, and the sums of residual blocks."""
    constants = {tensor.name for tensor in graph.initializer}
    behind: set[str] = set()  # what a convolution has made, or something that had it from one
    chosen = []
    for node in graph.node:
        deep = not behind.isdisjoint(node.input)
        # A sum with a constant is the last step, into the targets' units: it must not be rounded.
        shift = node.op_type == "Add" and not constants.isdisjoint(node.input)
        if deep and node.op_type in ROUNDED and not shift:
            chosen.append(node.name)
        if deep or node.op_type == "Conv":
            behind.update(node.output)
    return chosen


def _tidied(model: onnx.ModelProto) -> onnx.ModelProto:
    """Without the families of operators that the runtime declares and no node uses."""
    used = {node.domain for node in model.graph.node}
    families = [family for family in model.opset_import if family.domain in used]
    del model.opset_import[:]
    model.opset_import.extend(families)
    onnx.checker.check_model(model, full_check=True)
    return model


class _Images(CalibrationDataReader):  # type: ignore[misc]  # onnxruntime is seen as Any
    """Inputs as the runtime asks for them."""

    def __init__(self, images: Iterator[Tensor]) -> None:
        self.images = images

    def get_next(self) -> dict[str, Tensor] | None:
        inputs = next(self.images, None)
        return None if inputs is None else {"image": inputs}


ROUNDS, FRAMES, WARM = 8, 25, 3


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of int8, and its gain.

    Attributes:
        mae: of each target, in its unit: with the network in float32 and in int8, on the same held-out rows.
        seconds: median time of the network alone for one image, in float32 and in int8, on this machine [s].
    """

    mae: dict[str, tuple[float, float]]
    seconds: tuple[float, float]


def cost(folder: Path, quantised: Path) -> Cost:
    """Cost of a calibration's int8 copy, by both cards, and how fast both are here, taken in turn.

    Raises:
        InputError: the second does not come from the first.
    """
    both = Estimator.open(folder), Estimator.open(quantised)
    cards = [estimator.card for estimator in both]
    if cards[1].options.get("quantised_from") != cards[0].id:
        raise InputError(f"{quantised} was not made from {folder}; name a calibration and its own int8 copy")
    image = np.zeros((1, cards[0].input.channels, *cards[0].input.size_px), np.float32)
    calls = [lambda e=estimator: e.values(image) for estimator in both]
    first, second = (float(np.median(times)) for times in times_in_turn(calls, ROUNDS, FRAMES))
    mae = {
        a.column: (a.score.mae, b.score.mae) for a, b in zip(cards[0].targets, cards[1].targets, strict=True)
    }
    return Cost(mae, (first, second))


def times_in_turn(
    calls: Sequence[Callable[[], object]],
    rounds: int,
    each: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[list[float]]:
    """Times of each call [s], so many in each round, so that all see the machine's other work.

    The first calls of a round are not timed.
    """
    seconds: list[list[float]] = [[] for _ in calls]
    for done in range(rounds):
        for call, times in zip(calls, seconds, strict=True):
            for i in range(-WARM, each):
                started = time.perf_counter()
                call()
                if i >= 0:
                    times.append(time.perf_counter() - started)
        progress(done + 1, rounds)
    return seconds


MAX_ROWS_FOR_SCALES = 512  # rows
AT_ONCE = 32
REPEATS = 1e-3  # share of a target's range within which the model must repeat its held-out estimates


@dataclass(frozen=True)
class _Material:
    """A calibration's rows as it learnt from them: `held` are those by which it was scored."""

    packed: PackedSet
    data: TrainingData
    predictions: pd.DataFrame
    held: Indices
    learnt: Indices

    @property
    def before(self) -> Values:
        """Estimates of the held-out rows by the network in float32."""
        return self.predictions[[f"estimate:{name}" for name in self.data.names]].to_numpy(np.float64)

    def largest_change(self, estimates: Values) -> float:
        """Largest change of any estimate of a held-out row, as a share of its target's range."""
        return float((np.abs(estimates - self.before) / np.ptp(self.data.values, axis=0)).max())


def quantise(folder: PathText, run: Run, out: PathText, progress: Progress = silent) -> Card:
    """Write a calibration anew with its network in int8, scored on the rows that it held out.

    The card's options say ``int8``, ``quantised_from`` (the id of the calibration it comes from) and
    ``fp32_mae``; its `agreement` is the largest change by the rounding.

    Args:
        folder: the calibration; left as it is.
        run: what it was calibrated on.
        out: the calibration folder to make; must not exist.
        progress: called with what is being done and how far it is.

    Raises:
        InputError: another run, a network without convolutions to round, one that is in int8 already or
            adapted to another copy, or one that has learnt from every row, so that none is left to tell what
            int8 costs.
        CertificateError: the folder is damaged, or its model is not the one that was scored.
        ExistsError: `out` exists.
    """
    folder, out = Path(folder), Path(out)
    refuse_existing(out)
    estimator = Estimator.open(folder)
    card = estimator.card
    _check_asked(card, run)
    with new_folder(out) as building, TemporaryDirectory(dir=building) as work:
        material = _material(folder, card, run, Path(work), progress)
        _check_repeats(estimator, material, folder)
        model = folder / card.model.file
        images = _inputs_learnt_from(material, card.seed, progress)
        onnx.save(int8_model(model, images, Path(work)), str(building / "model.onnx"))
        shutil.copyfile(checked_file(folder, card.guard), building / "guard.npz")
        estimates = _answers(_running(building / "model.onnx"), material, progress)
        targets, ends = _rescored(card, material, estimates)
        write_table(_predictions(card, material, estimates, ends), building / PREDICTIONS_FILE)
        _pictures(folder, card, building, material, estimates)
        quantised = _card(card, building, targets, material.largest_change(estimates))
        (building / CARD_FILE).write_text(quantised.model_dump_json(indent=1))
        Estimator.open(building)
    return quantised


def _check_asked(card: Card, run: Run) -> None:
    if run.hash != card.run.hash:
        raise InputError(
            f"{run.path} is not the run that calibration {card.id} learnt from (run {card.run.run_id}, hash "
            f"{card.run.hash[:12]}; this one's is {run.hash[:12]}); give that run, unaltered"
        )
    if card.options.get("int8"):
        raise InputError(f"calibration {card.id} is in int8 already")
    if card.vectors or card.classes or any(target.circular is not None for target in card.targets):
        raise InputError(
            f"calibration {card.id} has circular targets, vectors or classes, which int8 is not measured "
            "for; keep it as it is, or calibrate without --circular, --vector and --classes first"
        )
    if card.interval_reset is not None or (card.sessions and card.sessions.rule != "one session"):
        raise InputError(
            f"the intervals of calibration {card.id} are for another session than its held-out rows would "
            "set them for; quantise a calibration of one session, then set its intervals anew "
            "(palpate adapt --intervals-only)"
        )
    if card.adapted_from is not None:
        raise InputError(
            f"calibration {card.id} is adapted from {card.adapted_from}, and its rows were held out from "
            "other corrections than its own, so that what int8 costs cannot be told of it; keep it as it is"
        )


def _material(folder: Path, card: Card, run: Run, work: Path, progress: Progress) -> _Material:
    preparation = card.input.preparation
    whole = pack(run, work / "packed", preparation, lambda done, total: progress("packing", done, total))
    plan = CalibrationPlan.of_card(card, ReferenceRule.of_card(card))
    rows = rows_to_learn(whole.table, plan)
    if card.split.rows_learnt + card.split.rows_scored != len(rows):
        raise InputError(
            f"the network of calibration {card.id} has learnt from {card.split.rows_learnt} of {len(rows)} "
            "rows, and none that it has not seen can tell what int8 costs; calibrate with one fold held out "
            "(--scored-folds 1)"
        )
    table = read_predictions(folder, card)
    held = own_column(table, "row").to_numpy(np.int64)
    groups = np.full(len(rows), -1)  # of those learnt from none is asked
    groups[held] = held_out_groups(card, table)[0]
    learning = learning_set(whole, plan, groups, str(run.path))
    return _Material(learning.packed, learning.data, table, held, np.setdiff1d(np.arange(len(rows)), held))


def _check_repeats(estimator: Estimator, material: _Material, folder: Path) -> None:
    """The network must be the very one whose estimates of held-out rows were kept."""
    worst = material.largest_change(_answers(estimator.values, material, silent))
    if not worst <= REPEATS:
        raise CertificateError(
            f"the model in {folder} differs by {worst:.1e} of the range from the estimates it was scored by, "
            f"more than {REPEATS:.0e}, so that its cost in int8 cannot be told; calibrate again"
        )


def _answers(run: Callable[[Tensor], Values], material: _Material, progress: Progress) -> Values:
    """Estimates of the held-out rows by a network."""
    answers = np.empty((len(material.held), len(material.data.names)))
    done = 0
    for rows, inputs in material.data.batches(material.held, AT_ONCE):
        answers[done : done + len(rows)] = run(inputs)
        done += len(rows)
        progress("scoring int8", done, len(answers))
    return answers


def _inputs_learnt_from(material: _Material, seed: int, progress: Progress) -> Iterator[Tensor]:
    """Inputs of some of the rows that the network has learnt from, a few at a time."""
    count, done = min(MAX_ROWS_FOR_SCALES, len(material.learnt)), 0
    rows = np.sort(np.random.default_rng(seed).choice(material.learnt, count, replace=False))
    for part, inputs in material.data.batches(rows, AT_ONCE):
        yield inputs
        done += len(part)
        progress("finding scales", done, count)


def _running(model: Path) -> Callable[[Tensor], Values]:
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    return lambda inputs: np.asarray(session.run(["value"], {"image": inputs})[0], np.float64)


def _rescored(
    card: Card, material: _Material, estimates: Values
) -> tuple[tuple[TargetCard, ...], tuple[Values, Values]]:
    """Targets with intervals and scores from the int8 estimates, and the intervals' ends."""
    held, values = material.held, material.data.values
    groups, true, means = material.data.groups[held], values[held], values[material.learnt].mean(axis=0)
    intervals = fit_intervals(estimates, true, groups, card.coverage)
    inside, ends = intervals.hold(estimates, true), intervals.ends(estimates)
    over_range = range_cards(
        intervals, estimates, true, groups, [(target.least, target.greatest) for target in card.targets]
    )

    def rescored(j: int, target: TargetCard) -> TargetCard:
        half = (ends[1] - ends[0])[:, j] / 2
        scores = score(
            target.unit, true[:, j], estimates[:, j], half, float(means[j]), groups, inside=inside[:, j]
        )
        return target.model_copy(update=interval_fields(intervals, j, over_range[j]) | {"score": scores})

    return tuple(rescored(j, target) for j, target in enumerate(card.targets)), ends


def _predictions(
    card: Card, material: _Material, estimates: Values, ends: tuple[Values, Values]
) -> pd.DataFrame:
    """The held-out rows as before, with the int8 estimates."""
    low, high = ends
    kinds = {"estimate": estimates, "half_width": (high - low) / 2, "low": low, "high": high}
    return material.predictions.assign(
        **{f"{kind}:{c}": of[:, j] for kind, of in kinds.items() for j, c in enumerate(card.columns)}
    )


def _pictures(folder: Path, card: Card, building: Path, material: _Material, estimates: Values) -> None:
    """The report's pictures: the usual ones as they were, and the rows that int8 misses most."""
    for part in card.files:
        if part.file in ("example.png", "reference.png", MAP_FILE):
            shutil.copyfile(checked_file(folder, part), building / part.file)
    error = np.abs(estimates - material.data.values[material.held]) / np.ptp(material.data.values, axis=0)
    for row in material.held[np.argsort(error.max(axis=1))[::-1][:WORST]].tolist():
        write_picture(building / f"worst-{row}.png", material.packed.read([row])[0])


def _card(card: Card, building: Path, targets: tuple[TargetCard, ...], change: float) -> Card:
    before = {target.column: float(f"{target.score.mae:.4g}") for target in card.targets}
    options = card.options | {"int8": True, "quantised_from": card.id, "fp32_mae": before}
    changed = {"options": options, "targets": targets, "agreement": change}
    return sealed(card.model_dump(exclude={"id"}) | made_fields(building) | changed)
