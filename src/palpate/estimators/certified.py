"""Calibration folder, opened: checked in every part, then Frame in, Readings out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from pydantic import ValidationError

from palpate.core import (
    CertificateError,
    Drift,
    Float,
    Float32,
    Frame,
    Image,
    ImageError,
    PathText,
    Reading,
    Readings,
    StorageError,
    Tensor,
    Values,
    sha256_of,
    unit,
)
from palpate.estimators.model_card import FORMAT, Card, FileCard, TargetCard, card_id
from palpate.estimators.novelty import NoveltyDetector
from palpate.version import needed_version

MIN_RATIO, MAX_RATIO = 0.2, 5.0
"""The spread is held between these multiples of the typical error: a quadratic fitted inside the
calibrated range must not run away outside it."""


def design(scaled: Values) -> Float[np.ndarray, "n k"]:
    """Terms of a quadratic in the scaled values: 1, each value, each product of two."""
    n, t = scaled.shape
    first, second = np.triu_indices(t)
    return np.concatenate([np.ones((n, 1)), scaled, scaled[:, first] * scaled[:, second]], axis=1)


@dataclass(frozen=True, slots=True)
class ErrorSpread:
    """Expected size of an estimate's error: log spread is a quadratic in the estimated values.

    Attributes:
        centre, scale: of the estimates, ``[t]`` each.
        typical: mean absolute held-out error ``[t]``.
        coefficients: of the quadratic of log(spread / typical), ``[t k]``, see `design`.
    """

    centre: Float[np.ndarray, " t"]
    scale: Float[np.ndarray, " t"]
    typical: Float[np.ndarray, " t"]
    coefficients: Float[np.ndarray, "t k"]

    def at(self, values: Values) -> Values:
        """The spread at these estimates ``[n t]``, in the targets' units."""
        scaled = np.clip((values - self.centre) / self.scale, -3.0, 3.0)
        ratio = np.exp(np.clip(design(scaled) @ self.coefficients.T, np.log(MIN_RATIO), np.log(MAX_RATIO)))
        return self.typical * ratio


@dataclass(frozen=True, slots=True)
class Intervals:
    """half-width = quantile · spread.

    Attributes:
        spread: how the size of the error varies with the estimate.
        quantile: conformal quantile of the scaled held-out errors ``[t]``.
        coverage: how often the intervals hold the truth.
    """

    spread: ErrorSpread
    quantile: Float[np.ndarray, " t"]
    coverage: float

    def half_widths(self, values: Values) -> Values:
        """Half-width of the interval around each estimate ``[n t]``."""
        return self.quantile * self.spread.at(values)


CARD_FILE = "card.json"
MAX_CARD_BYTES = 4_000_000
MAX_MODEL_BYTES = 1_000_000_000

PreparedFloat = Float32[np.ndarray, "h w c"]


def read_card(folder: PathText) -> Card:
    """Read and check a calibration's card.

    Raises:
        CertificateError: it is missing, damaged or altered, or another version of palpate has to read it.
    """
    path = Path(folder) / CARD_FILE
    if not path.is_file():
        raise CertificateError(
            f"{folder} is not a calibration: it has no {CARD_FILE}; name a folder that "
            "`palpate calibrate` made"
        )
    if path.stat().st_size > MAX_CARD_BYTES:
        raise CertificateError(f"{path} is larger than {MAX_CARD_BYTES} bytes; a card never is")
    text = path.read_bytes()
    try:
        card = Card.model_validate_json(text)
    except ValidationError as e:
        if version := needed_version(text, FORMAT):
            raise CertificateError(f"{path} {version}") from e
        first = e.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the text"
        raise CertificateError(
            f"{path} cannot be read as a card: {where}: {first['msg']}; restore it or calibrate again"
        ) from e
    if card_id(card.model_dump(mode="json")) != card.id:
        raise CertificateError(
            f"{path} was altered: its content no longer gives its id {card.id}; restore it or calibrate again"
        )
    return card


def checked_file(folder: Path, part: FileCard) -> Path:
    """The path of a part whose bytes are those the card names.

    Raises:
        CertificateError: missing, a link, or other bytes.
    """
    path = folder / part.file
    if path.is_symlink() or not path.is_file():
        raise CertificateError(f"{path} is missing or a link; restore the folder or calibrate again")
    if path.stat().st_size > MAX_MODEL_BYTES or sha256_of(path) != part.sha256:
        raise CertificateError(
            f"{path} is not the file this card was made with (its SHA-256 differs); "
            "restore it or calibrate again"
        )
    return path


@dataclass(frozen=True, slots=True)
class Zero:
    """An untouched sensor's image: what a differential model subtracts, and how far it has drifted."""

    image: PreparedFloat
    drift: Drift | None


class Estimator:
    """A certified estimator, ready to sense.

    Example:
        estimator = Estimator.open("cal")
        readings = estimator.read(image)        # an array, or a Frame
        readings["depth_mm"].value              # in mm, as the key says
    """

    def __init__(
        self, folder: Path, card: Card, session: onnxruntime.InferenceSession, novelty: NoveltyDetector
    ) -> None:
        self.folder = folder
        self.card = card
        self._session = session
        self._novelty = novelty
        self._preparation = card.input.preparation
        self._intervals = intervals_of(card)

    @classmethod
    def open(cls, folder: PathText, *, threads: int = 0) -> Estimator:
        """Open a calibration folder, checking every part against the card.

        Args:
            folder: what `palpate calibrate` made.
            threads: of the inference engine; 0 lets it choose.

        Raises:
            CertificateError: a part is missing, altered, or does not fit the card.
        """
        folder = Path(folder)
        card = read_card(folder)
        novelty = NoveltyDetector.load(checked_file(folder, card.guard))
        session = _session(checked_file(folder, card.model), card, threads)
        return cls(folder, card, session, novelty)

    def zero(self, untouched: Image) -> Zero:
        """Take an image of the untouched sensor as reference, and judge its drift by it."""
        self._check_size(untouched)
        prepared = self._preparation.apply(untouched)
        return Zero(prepared.astype(np.float32), self._novelty.drift(prepared))

    def values(self, inputs: Tensor) -> Values:
        """Run the network: inputs ``[n c h w]`` to estimates ``[n t]`` in the targets' units."""
        (value,) = self._session.run(["value"], {"image": inputs})
        return np.asarray(value, dtype=np.float64)

    def read(self, frame: Frame | Image, zero: Zero | None = None) -> Readings:
        """Read every target from one frame.

        Args:
            frame: a frame or its image, 8-bit grey ``[h w]`` or RGB ``[h w 3]``, of the kind calibrated on;
                another size or kind gives readings that are not valid and say why, never a value that looks
                right.
            zero: the untouched sensor, see `zero`; needed where the calibration is differential.

        Returns:
            A reading for each target's column, in that column's unit.

        Raises:
            ImageError: the calibration is differential and no `zero` was given, or it is no such image.
        """
        frame = frame if isinstance(frame, Frame) else Frame(frame)
        if self.card.input.delta and zero is None:
            raise ImageError(
                "this calibration is differential: it needs an image of the untouched sensor; "
                "give one with --reference FRAME"
            )
        if frame.image.shape[:2] != self.card.input.frame_px:
            return self._readings(frame, None, self._size_message(frame.image), zero)
        prepared = self._preparation.apply(frame.image)
        atypicality = self._novelty.atypicality(prepared)
        why = "" if atypicality <= 1 else _novelty_reason(atypicality)
        picture = prepared.astype(np.float32)
        difference = picture - zero.image if self.card.input.delta and zero is not None else picture
        values = self.values(np.ascontiguousarray(difference.transpose(2, 0, 1))[None])
        return self._readings(frame, values, why, zero)

    def unread(self, name: str, time_s: float, why: str) -> Readings:
        """Readings of a frame that could not be opened: no values, not valid, and the reason."""
        nothing = Frame(np.zeros((1, 1), np.uint8), time_s, name=name)
        return self._readings(nothing, None, why, None)

    def _readings(self, frame: Frame, values: Values | None, why: str, zero: Zero | None) -> Readings:
        targets = self.card.targets
        value = np.full(len(targets), np.nan) if values is None else values[0]
        half = np.full(len(targets), np.nan) if values is None else self._intervals.half_widths(values)[0]
        drift = None if zero is None else zero.drift
        return Readings(
            {
                target.column: self._reading(target, float(v), float(w), why, drift, frame)
                for target, v, w in zip(targets, value, half, strict=True)
            }
        )

    def _reading(
        self, target: TargetCard, value: float, half: float, why: str, drift: Drift | None, frame: Frame
    ) -> Reading:
        si = unit(target.unit)
        why = why or _outside(target, value, half)
        return Reading(
            quantity=target.quantity,
            value=si.to_si(value),
            low=si.to_si(value - half),
            high=si.to_si(value + half),
            unit=si.si,
            coverage=self.card.coverage,
            calibrated_range=(si.to_si(target.least), si.to_si(target.greatest)),
            valid=not why,
            why=why,
            drift=drift,
            calibration=self.card.id,
            frame=frame.name,
            time_s=frame.time_s,
        )

    def __repr__(self) -> str:
        targets = ", ".join(f"{t.column} ± {t.score.half_width:.2g}" for t in self.card.targets)
        return f"<Estimator {self.card.id} of {self.card.sensor or 'a sensor'}: {targets}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(t.column)}</td><td>{t.least:.3g} to {t.greatest:.3g} {t.unit}</td>"
            f"<td>{t.score.mae:.2g} {t.unit}</td><td>± {t.score.half_width:.2g} {t.unit}</td></tr>"
            for t in self.card.targets
        )
        heads = ("target", "range", "mean absolute error", f"{100 * self.card.coverage:g} % interval")
        head = "".join(f"<th>{name}</th>" for name in heads)
        return f"<table><caption>{escape(repr(self)[1:-1])}</caption><tr>{head}</tr>{rows}</table>"

    def _check_size(self, image: Image) -> None:
        if image.shape[:2] != self.card.input.frame_px:
            raise ImageError(self._size_message(image))

    def _size_message(self, image: Image) -> str:
        height, width = self.card.input.frame_px
        rows, columns = image.shape[:2]
        return f"the image is {columns}x{rows} px, the calibration is for {width}x{height} px"


def intervals_of(card: Card) -> Intervals:
    """The intervals that a card describes."""
    targets = card.targets
    spread = ErrorSpread(
        np.array([t.centre for t in targets]),
        np.array([t.scale for t in targets]),
        np.array([t.typical for t in targets]),
        np.array([t.coefficients for t in targets]),
    )
    return Intervals(spread, np.array([t.quantile for t in targets]), card.coverage)


def _novelty_reason(atypicality: float) -> str:
    return f"the image is unlike those calibrated on (distance {atypicality:.1f}, limit 1)"


def _outside(target: TargetCard, value: float, half: float) -> str:
    """Reason not to trust a value: its whole interval lies beyond what the calibration saw."""
    if target.least - half <= value <= target.greatest + half:
        return ""
    return (
        f"{target.quantity} {value:.3g} {target.unit} lies beyond the calibrated range "
        f"{target.least:.3g} to {target.greatest:.3g} {target.unit}"
    )


def _session(path: Path, card: Card, threads: int) -> onnxruntime.InferenceSession:
    """An inference session over a model that keeps to its card and to its own bytes."""
    try:
        model = path.read_bytes()
        refuse_other_files(model, str(path))
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        # Threads that spin while idle take the cores from the novelty detector: asleep, they halve the 95th
        # percentile of a frame's latency on two cores.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        # From bytes, so that nothing beside the file can be drawn in.
        session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except (CertificateError, StorageError):
        raise
    except Exception as e:  # protobuf and onnxruntime raise many kinds of their own
        raise CertificateError(f"{path} is not a model that can be run ({e}); calibrate again") from e
    _check_shapes(session, card, path)
    return session


def _check_shapes(session: onnxruntime.InferenceSession, card: Card, path: Path) -> None:
    inputs = {i.name: i.shape[1:] for i in session.get_inputs()}
    outputs = {o.name: o.shape[1:] for o in session.get_outputs()}
    wanted_in = {"image": [card.input.channels, *card.input.size_px]}
    wanted_out = {"value": [len(card.targets)]}
    if inputs != wanted_in or outputs != wanted_out:
        raise CertificateError(
            f"{path} takes {inputs} and gives {outputs}, its card says {wanted_in} and {wanted_out}; "
            "model and card do not belong together"
        )


EXTERNAL = 1  # of TensorProto.DataLocation

# Sensing needs to know one thing of a model's bytes, and without the onnx package: that they hold all of it.
# The messages are those of ONNX with only the fields that say so; protobuf skips the others. Field numbers
# are those of onnx.proto, which never change (https://github.com/onnx/onnx/blob/main/onnx/onnx.proto).
MESSAGES: dict[str, tuple[tuple[str, int, str], ...]] = {
    "Model": (("graph", 7, "Graph"),),
    "Graph": (("node", 1, "*Node"), ("initializer", 5, "*Tensor")),
    "Node": (("attribute", 5, "*Attribute"),),
    "Attribute": (("t", 5, "Tensor"), ("g", 6, "Graph"), ("graphs", 11, "*Graph")),
    "Tensor": (("external_data", 13, "*Entry"), ("data_location", 14, "")),
    "Entry": (),
}
"""Name, number and type of each field: a message, ``*`` for a repeated one, nothing for an integer."""


def refuse_other_files(model: bytes, source: str) -> None:
    """Refuse a model that keeps weights or constants in another file, or has graphs inside its graph.

    Args:
        model: the bytes of an ONNX file.
        source: what they came from, for the message.

    Raises:
        CertificateError: it does.
        google.protobuf.message.DecodeError: the bytes are no ONNX file.
    """
    graph = _model_class().FromString(model).graph
    if any(_is_external(tensor) for tensor in graph.initializer):
        raise CertificateError(f"{source} keeps weights in another file, which is refused; export it whole")
    for attribute in (one for node in graph.node for one in node.attribute):
        if _is_external(attribute.t):
            raise CertificateError(f"{source} keeps constants in another file, which is refused")
        if attribute.HasField("g") or attribute.graphs:
            raise CertificateError(f"{source} has graphs inside its graph, which palpate never writes")


def _is_external(tensor: Any) -> bool:
    return tensor.data_location == EXTERNAL or bool(tensor.external_data)


@cache
def _model_class() -> Any:
    """The class of the message `Model`, made from `MESSAGES`."""
    file = FileDescriptorProto(
        name="palpate/model_parts.proto",
        package="palpate",
        syntax="proto2",
        message_type=[
            DescriptorProto(name=name, field=[_field(*field) for field in fields])
            for name, fields in MESSAGES.items()
        ],
    )
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("palpate.Model"))


def _field(name: str, number: int, kind: str) -> FieldDescriptorProto:
    F = FieldDescriptorProto
    label = F.LABEL_REPEATED if kind.startswith("*") else F.LABEL_OPTIONAL
    message = kind.removeprefix("*")
    if not message:
        return F(name=name, number=number, label=label, type=F.TYPE_INT32)
    return F(name=name, number=number, label=label, type=F.TYPE_MESSAGE, type_name=f".palpate.{message}")
