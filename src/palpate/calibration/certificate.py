"""Certificate of a calibration: a folder of model, novelty detector, card, predictions and pictures.

Calibrations as one file: nested dataclasses as flat plain arrays, without pickles; the id is that of the
contents.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_type_hints
from zipfile import BadZipFile

import numpy as np
import onnx
import onnxruntime
import pandas as pd

from palpate.calibration.calibration_job import CalibrationJob
from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.classes import HeldOutClasses
from palpate.calibration.confounds.skin_region import MAP_FILE, DecidingPixels
from palpate.calibration.coverage.conformal import vector_cards
from palpate.calibration.coverage.range_scores import (
    calibrated_arc,
    mean_of,
    range_cards,
    uninformative_width,
)
from palpate.calibration.evaluation import score
from palpate.calibration.leakage import LeakageAudit
from palpate.core import (
    CertificateError,
    Float,
    Indices,
    Values,
    ndarray,
    new_file,
    new_folder,
    sha256_of,
    split_column,
    storage_errors,
)
from palpate.core.array_files import MAX_ARRAY_BYTES, read_arrays
from palpate.core.parsing import parser
from palpate.estimators.card_ground import FileCard, RunCard
from palpate.estimators.certified import CARD_FILE, checked_file
from palpate.estimators.class_sets import Outputs, TargetLayout
from palpate.estimators.findings import ChoiceCard, ConfoundCard, RobustnessCard, TrainingCard, TrialCard
from palpate.estimators.guard import NoveltyDetector
from palpate.estimators.intervals import Intervals, within
from palpate.estimators.model_card import (
    FORMAT,
    Card,
    CircularCard,
    InputCard,
    InstrumentCard,
    LensCard,
    RangeCard,
    ReferenceCard,
    SplitCard,
    TargetCard,
    sealed,
)
from palpate.estimators.networks import settings_of
from palpate.estimators.networks.model_interface import Chooses, Fitted, LearnsInSteps, TrainingData
from palpate.estimators.reference_uncertainty import reference_half_width
from palpate.recordings import Run
from palpate.recordings.exchange import image_files
from palpate.recordings.label_tables import read_table, with_own, write_table
from palpate.recordings.manifest import ReferenceInstrument
from palpate.version import __version__


@dataclass(frozen=True)
class CalibrationResult:
    """Everything that a certificate is written from.

    Attributes:
        held_out: outputs ``[n o]`` of models that had not seen the row's group; NaN for rows not scored.
        fitted, novelty: trained on all rows.
        robustness, confounds, classes, pixels: None where not measured.
    """

    job: CalibrationJob
    audit: LeakageAudit | None
    held_out: Outputs
    intervals: Intervals
    fitted: Fitted
    novelty: NoveltyDetector
    seconds: float = 0.0
    robustness: RobustnessCard | None = None
    confounds: ConfoundCard | None = None
    classes: HeldOutClasses | None = None
    pixels: DecidingPixels | None = None

    @property
    def data(self) -> TrainingData:
        return self.job.data

    @property
    def scored(self) -> Indices:
        """Rows that were held out once, and predicted."""
        return scored_rows(self.held_out if self.classes is None else self.classes.outputs)

    @property
    def one_fold(self) -> bool:
        """True if only one fold was held out, and the kept model has not seen it."""
        return any(np.array_equal(self.scored, np.sort(rows)) for rows in self.job.parts.folds)

    @property
    def layout(self) -> TargetLayout:
        return self.job.plan.layout

    @property
    def estimates(self) -> Values:
        """Held-out estimates ``[n t]`` of the outputs `held_out`."""
        return self.layout.decoded(self.held_out)

    @property
    def errors(self) -> Values:
        """Estimates less labels ``[n t]``, the shortest way round where a target is circular."""
        return self.layout.differences(self.estimates, self.data.values)


AGREEMENT = 1e-4  # largest difference of exported and trained model, relative to a target's range
WORST = 6


def worst_rows(result: CalibrationResult, read: Sequence[bool]) -> Indices:
    """Return the rows with the largest errors, see `most_missed`; without a target, by their class."""
    span, scored = np.ptp(result.data.values, axis=0), result.scored
    if not len(span) and result.classes is not None:
        return scored[np.argsort(result.classes.shortfalls(scored))[::-1][:WORST]]
    return scored[most_missed(result.errors[scored], span, read)]


def most_missed(errors: Values, span: Float[np.ndarray, " t"], read: Sequence[bool]) -> Indices:
    """Return the rows with the largest error relative to each target's range, the worst first.

    Args:
        errors: signed or absolute errors ``[n t]``.
        span: lengths of the targets' ranges; 0 counts as 1.
        read: whether each target is read; where none is, all count.
    """
    counted = np.array(read, bool) if any(read) else np.ones(len(span), bool)
    shares = np.abs(errors) / np.where(span > 0, span, 1.0)
    return np.argsort(shares[:, counted].max(axis=1))[::-1][:WORST]


def write_pictures(result: CalibrationResult, folder: Path, read: Sequence[bool]) -> None:
    """Write the pictures that the report shows; `read` as of `worst_rows`."""
    packed, untouched = result.job.packed, result.job.untouched
    chosen = [(f"worst-{row}.png", int(row)) for row in worst_rows(result, read)]
    for name, row in [*chosen, ("example.png", len(packed) // 2)]:
        write_picture(folder / name, packed.read(np.array([row]))[0])
    if len(untouched.rows):
        mean = untouched.images[0].transpose(1, 2, 0)
        write_picture(folder / "reference.png", mean.round().astype(np.uint8))


def write_picture(path: Path, prepared: np.ndarray) -> None:
    """Write a prepared frame ``[h w c]``: RGB, or grey without a channel axis."""
    image = prepared if prepared.shape[2] == 3 else prepared[..., 0]
    path.write_bytes(image_files.encode(image).tobytes())


def agreement(result: CalibrationResult, model: Path) -> float:
    """Return the largest difference of exported and trained model, relative to each target's range."""
    count = len(result.data.values)
    rows = np.linspace(0, count - 1, min(64, count)).astype(np.int64)
    inputs = result.data.fetch(rows)
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    (exported,) = session.run(["value"], {"image": inputs})
    spans = result.layout.spans(result.data.values)
    if result.classes is not None:
        spans = np.append(spans, np.ones(result.classes.outputs.shape[1]))
    difference = np.abs(exported - result.fitted.predict(inputs)) / spans
    worst = float(difference.max())
    if not worst <= AGREEMENT:
        raise CertificateError(
            f"the exported model differs from the trained one by {worst:.1e} of the range, more than "
            f"{AGREEMENT:.0e}; nothing was written"
        )
    return worst


def interval_fields(
    intervals: Intervals, j: int, over_range: RangeCard | None = None, untold_width: float | None = None
) -> dict[str, Any]:
    """Return the card fields from which `estimators.intervals.intervals_of` restores a target's interval.

    Args:
        j: index of the target.
        untold_width: width from which a circular target's interval carries no information.
    """
    spread, layout = intervals.spread, intervals.layout
    outputs, circular = slice(j, j + 1), None
    if layout is not None and not layout.plain:
        outputs = layout.outputs_of(j)
        if (period := layout.periods[j]) is not None:
            ends = [tuple(map(float, part[outputs])) for part in (spread.centre, spread.scale)]
            circular = CircularCard(period=period, centre=ends[0], scale=ends[1], untold_width=untold_width)
    return {
        "centre": float(spread.centre[outputs][0]),
        "scale": float(spread.scale[outputs][0]),
        "typical": float(spread.typical[j]),
        "coefficients": tuple(float(c) for c in spread.coefficients[j]),
        "quantile": float(intervals.quantile[j]),
        "over_range": over_range,
        "circular": circular,
    }


def target_cards(
    result: CalibrationResult, intervals: Intervals, halves: Values, kept: Sequence[TargetCard] = ()
) -> Iterator[TargetCard]:
    """Return ranges, intervals, and scores of each target.

    Args:
        kept: cards whose ranges and training means stay; none for those of the rows.
    """
    scored, values, groups = result.scored, result.data.values, result.data.groups
    outputs = result.held_out[scored]
    inside = intervals.hold(outputs, values[scored])
    if kept:  # the rows that set the width lie on its very end
        inside = within(intervals.errors(outputs, values[scored]), -halves, halves)
    ranges = [(one.least, one.greatest) for one in kept] or [
        _range_of(column, period) for column, period in zip(values.T, result.layout.periods, strict=True)
    ]
    over_range = range_cards(intervals, outputs, values[scored], groups[scored], ranges)
    for j, column in enumerate(result.job.plan.targets):
        (quantity, unit), true, period = split_column(column), values[:, j], result.layout.periods[j]
        least, greatest = ranges[j]
        mean_of_others = np.empty_like(true)
        for k, rows in enumerate(result.job.parts.folds):
            others = true[result.job.parts.training_rows(k)]
            mean_of_others[rows] = kept[j].training_mean if kept else mean_of(others, period)
        scores = score(
            unit.symbol,
            true[scored],
            result.estimates[scored, j],
            halves[:, j],
            mean_of_others[scored],
            groups[scored],
            inside=inside[:, j],
            period=period,
        )
        untold = uninformative_width(2 * halves[:, j], greatest - least, intervals.coverage)
        yield TargetCard(
            column=column,
            quantity=quantity,
            unit=unit.symbol,
            least=least,
            greatest=greatest,
            training_mean=kept[j].training_mean if kept else mean_of(true, period),
            measured_by=instrument_card(
                result.job.plan.instruments.get(column) or result.job.run.manifest.instruments.get(column),
                result.job.plan.coverage,
            ),
            **interval_fields(intervals, j, over_range[j], 0.0 if scores.says_nothing else untold),
            score=scores,
        )


def _range_of(true: np.ndarray, period: float | None) -> tuple[float, float]:
    return (float(true.min()), float(true.max())) if period is None else calibrated_arc(true, period)


def instrument_card(stated: ReferenceInstrument | None, coverage: float) -> InstrumentCard | None:
    """Return the instrument of a column's labels, with its part of intervals of this coverage."""
    if stated is None:
        return None
    half_width = reference_half_width(stated.standard_uncertainty, coverage)
    return InstrumentCard(**stated.model_dump(), half_width=half_width)


def reference_card(result: CalibrationResult) -> ReferenceCard:
    """Return the rule by which no-contact frames were found."""
    rule = result.job.untouched.rule
    return ReferenceCard(
        column=rule.column if rule else None,
        value=rule.value if rule else None,
        by=rule.by if rule else (),
        frames=len(result.job.untouched.rows),
        learnt=result.job.plan.learn_untouched,
    )


def run_card(run: Run) -> RunCard:
    """Return the card of a run."""
    manifest = run.manifest
    return RunCard(
        run_id=manifest.run_id,
        hash=run.hash,
        frames=len(run),
        origin=manifest.origin,
        licence=manifest.licence,
        provenance=manifest.provenance,
    )


def file_card(path: Path) -> FileCard:
    """Return the hash of a file of the calibration folder."""
    return FileCard(file=path.name, sha256=sha256_of(path))


def software() -> dict[str, str]:
    """Return the versions of palpate and the libraries that a calibration depends on."""
    names = ("numpy", "scikit-learn", "onnx", "onnxruntime", "opencv-python-headless")
    return {"palpate": __version__, "python": platform.python_version()} | {n: version(n) for n in names}


PREDICTIONS_FILE, FORMER_PREDICTIONS_FILE = "predictions.csv.gz", "predictions.parquet"


# from held-out outputs, labels, groups, coverage, and for circular targets `layout`
IntervalFit = Callable[..., Intervals]


def scored_rows(held_out: Outputs) -> Indices:
    """Return the rows that were held out once, and predicted."""
    return np.flatnonzero(~np.isnan(held_out).any(axis=1))


def intervals_by(fit: IntervalFit, held_out: Outputs, data: TrainingData, plan: CalibrationPlan) -> Intervals:
    """Return the intervals of the scored rows by an interval fit."""
    rows, layout = scored_rows(held_out), plan.layout
    given = (held_out[rows], data.values[rows], data.groups[rows], plan.coverage)
    return fit(*given) if layout.plain else fit(*given, layout=layout)


def write_certificate(
    result: CalibrationResult,
    out: Path,
    *,
    former: Card | None = None,
    split: SplitCard | None = None,
    more: Callable[[Path], Mapping[str, Any]] = lambda folder: {},
) -> Card:
    """Write the calibration folder; `out` appears whole or not at all.

    Args:
        former: card of the adapted calibration, whose model and input stay; None for a new one.
        split: split to state; None takes the result's own.
        more: further card fields, by a function of the folder that may add files.
    """
    data, scored, intervals = result.data, result.scored, result.intervals
    with new_folder(out) as folder:
        onnx.save(result.fitted.to_onnx(), str(folder / "model.onnx"))
        agrees = agreement(result, folder / "model.onnx")
        result.novelty.save(folder / "guard.npz")
        held_out = (result.held_out[scored], data.values[scored], data.groups[scored])
        ends = intervals.ends(held_out[0])
        halves = (ends[1] - ends[0]) / 2
        write_table(predictions_table(result, ends), folder / PREDICTIONS_FILE)
        targets = tuple(target_cards(result, intervals, halves))
        write_pictures(result, folder, [target.is_read for target in targets])
        further = dict(more(folder))
        if result.pixels is not None:
            result.pixels.save(folder / MAP_FILE)
        constant = _plan_fields(result) if former is None else former.model_dump(exclude={"id"})
        card = sealed(
            constant
            | {"sensor": result.job.run.manifest.sensor}
            | made_fields(folder)
            | {
                "targets": targets,
                "reference": reference_card(result),
                "split": split or split_card(result),
                "run": run_card(result.job.run),
                "agreement": agrees,
                "seconds": round(result.seconds, 1),
                "adapted_from": former and former.id,
                "vectors": vector_cards(
                    result.job.plan.vectors, result.job.plan.targets, intervals, *held_out
                )
                or None,
                "robustness": result.robustness,
                "confounds": result.confounds,
                "classes": result.classes and result.classes.cards,
            }
            | further
        )
        (folder / CARD_FILE).write_text(card.model_dump_json(indent=1))
    return card


def made_fields(folder: Path) -> dict[str, Any]:
    """Return the card fields of date, software, and files."""
    parts = ("model.onnx", "guard.npz")
    others = sorted(path for path in folder.iterdir() if path.is_file() and path.name not in parts)
    return {
        "created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": software(),
        "model": file_card(folder / "model.onnx"),
        "guard": file_card(folder / "guard.npz"),
        "files": tuple(file_card(path) for path in others),
    }


def predictions_table(result: CalibrationResult, ends: tuple[Values, Values]) -> pd.DataFrame:
    """Return one row per scored frame: labels, held-out estimates, and interval ends ``[n t]``."""
    rows = result.scored
    names = [result.job.packed.names[row] for row in rows]
    own = {"row": rows, "frame": names, "held_out_in_fold": result.job.fold_of[rows]}
    table = with_own(result.job.table.iloc[rows].reset_index(drop=True), own)
    for j, column in enumerate(result.job.plan.targets):
        table[f"estimate:{column}"] = result.estimates[result.scored, j]
        low, high = (end[:, j] for end in ends)
        table[f"half_width:{column}"] = (high - low) / 2
        table[f"low:{column}"], table[f"high:{column}"] = low, high
    return table if result.classes is None else result.classes.with_answers(table, rows)


def read_predictions(folder: Path, card: Card) -> pd.DataFrame:
    """Read the held-out predictions of a calibration."""
    for part in card.files:
        if part.file in (PREDICTIONS_FILE, FORMER_PREDICTIONS_FILE):
            return read_table(checked_file(folder, part))
    raise CertificateError(f"the card of {folder} names no {PREDICTIONS_FILE}; restore it or calibrate again")


def _plan_fields(result: CalibrationResult) -> dict[str, Any]:
    plan, preparation = result.job.plan, result.job.packed.preparation
    return {
        "format": FORMAT,
        "seed": plan.seed,
        "model_name": plan.model,
        "options": settings_of(plan.model, plan.options),
        "coverage": plan.coverage,
        "choice": choice_card(result.fitted),
        "training": training_card(result.fitted),
        "input": InputCard(
            frame_px=result.job.run.frame(0).image.shape[:2],
            size_px=preparation.size_px,
            channels=preparation.channels,
            crop_px=preparation.crop_px,
            beside_px=preparation.beside_px,
            lens=None if preparation.lens is None else LensCard.of(preparation.lens),
            delta=plan.delta,
        ),
    }


def choice_card(fitted: Fitted) -> ChoiceCard | None:
    """Return the choice that a model made by inner folds; None where it made none."""
    if not isinstance(fitted, Chooses):
        return None
    trials = [
        TrialCard(name=one.name, error=one.error, seconds=round(one.seconds, 2), note=one.note)
        for one in fitted.choice.trials
    ]
    return ChoiceCard(chosen=fitted.choice.chosen, trials=tuple(trials))


def training_card(fitted: Fitted) -> TrainingCard | None:
    """Return the training length of a network; None where it is not stated."""
    return TrainingCard(**asdict(fitted.training)) if isinstance(fitted, LearnsInSteps) else None


def split_card(result: CalibrationResult) -> SplitCard:
    """Return the split of the rows, and the findings of its audit."""
    assert result.audit is not None
    return SplitCard(
        kind=result.job.parts.kind,
        reason=result.job.parts.reason,
        block_rows=result.job.parts.block_rows,
        columns=result.job.parts.group_columns,
        groups=len(np.unique(result.data.groups)),
        folds=len(result.job.parts.folds),
        rows_learnt=len(result.job.packed) - (len(result.scored) if result.one_fold else 0),
        rows_scored=len(result.scored),
        clean=result.audit.clean,
        findings=result.audit.findings,
        details=result.audit.to_dict(),
    )


FLAT_FORMAT = 1
Kept = TypeVar("Kept")


def contents_id(record: Any, kind: str) -> str:
    """Return the name by the contents: the kind, and 12 hexadecimal digits of their SHA-256."""
    digest = hashlib.sha256()
    for name, value in sorted(flat_arrays(record).items()):
        digest.update(name.encode() + np.ascontiguousarray(value).tobytes())
    return f"{kind}-{digest.hexdigest()[:12]}"


def save_record(record: Any, path: Path) -> None:
    """Write one ``.npz``, whole or not at all."""
    with new_file(path) as building, building.open("wb") as file:
        np.savez_compressed(file, **flat_arrays(record), format=np.array(FLAT_FORMAT))  # type: ignore[arg-type]


@parser("calibration record", CertificateError, max_bytes=MAX_ARRAY_BYTES)
def load_record(kind: type[Kept], path: Path, what: str, maker: str) -> Kept:
    """Read what `save_record` wrote; no code in it is run.

    Args:
        what, maker: kind of calibration, and the command that makes one, for the message.
    """
    made_by = ""
    try:
        with storage_errors(path):
            data = read_arrays(path)
        made_by = f" of palpate {version}" if (version := data.get("version")) is not None else ""
        if (layout := int(data.pop("format"))) != FLAT_FORMAT:
            raise CertificateError(
                f"{path} has format {layout}, and palpate {__version__} reads format {FLAT_FORMAT}: open it "
                "with the version of palpate that wrote it, or calibrate anew"
            )
        record = from_flat_arrays(kind, data)
    except (KeyError, ValueError, TypeError, BadZipFile, EOFError) as e:
        raise CertificateError(
            f"{path} is no calibration of {what} that palpate {__version__} reads, but damaged or of another "
            f"version{made_by}: open it with that one, or calibrate anew by `{maker}`"
        ) from e
    assert isinstance(record, kind)
    return record


def flat_arrays(record: Any, prefix: str = "") -> dict[str, ndarray]:
    """Return fields of nested dataclasses under their dotted names, without None."""
    arrays: dict[str, ndarray] = {}
    for field in fields(record):
        value, name = getattr(record, field.name), prefix + field.name
        if is_dataclass(value):
            arrays |= flat_arrays(value, f"{name}.")
        elif value is not None:
            arrays[name] = np.asarray(value)
    return arrays


def from_flat_arrays(kind: type, data: Mapping[str, ndarray], prefix: str = "") -> Any:
    """Restore the dataclass that `flat_arrays` took apart."""
    values: dict[str, Any] = {}
    for name, hint in get_type_hints(kind).items():
        full, (inner, optional) = prefix + name, _plain(hint)
        if optional and not any(key == full or key.startswith(f"{full}.") for key in data):
            values[name] = None
        elif is_dataclass(inner):
            values[name] = from_flat_arrays(inner, data, f"{full}.")  # type: ignore[arg-type]
        else:
            values[name] = _value(data[full], inner)
    return kind(**values)


def _plain(hint: Any) -> tuple[Any, bool]:
    """A type without its None, and whether it had one."""
    if isinstance(hint, UnionType):
        rest = [one for one in get_args(hint) if one is not type(None)]
        return rest[0], len(rest) < len(get_args(hint))
    return hint, False


def _value(value: ndarray, kind: Any) -> Any:
    if kind in (int, float, str):
        return kind(value.item())
    return tuple(value.tolist()) if getattr(kind, "__origin__", None) is tuple else value
