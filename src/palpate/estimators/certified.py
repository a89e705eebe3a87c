"""Calibration folder, opened: checked in every part, then Frame in, Readings out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime

from palpate.core import (
    CertificateError,
    CircularReading,
    ClassReading,
    Drift,
    Float32,
    Frame,
    Image,
    ImageError,
    PathText,
    Reading,
    Readings,
    Tensor,
    VectorReading,
    half_width_text,
    rounded,
    sha256_of,
    storage_errors,
    unit,
)
from palpate.core.parsing import parser
from palpate.core.reading import NONE, ReasonCode, Refusal
from palpate.estimators.admission import admit_model
from palpate.estimators.card_ground import FileCard, sealed_from
from palpate.estimators.class_sets import Outputs, class_count, class_readings
from palpate.estimators.guard import CopyDiscriminator, NoveltyDetector, Verdict
from palpate.estimators.intervals import intervals_of, layout_of, vector_reading
from palpate.estimators.model_card import FORMAT, Card, TargetCard
from palpate.estimators.reference_uncertainty import doubt, with_reference
from palpate.recordings.exchange.image_files import opencv_image

CARD_FILE = "card.json"
MAX_CARD_BYTES = 4_000_000
MAX_MODEL_BYTES = 1_000_000_000

PreparedFloat = Float32[np.ndarray, "h w c"]


@parser("calibration card", CertificateError)
def read_card(folder: PathText) -> Card:
    """Read and check a calibration's card."""
    path = Path(folder) / CARD_FILE
    if not path.parent.exists():
        raise CertificateError(
            f"there is no {folder} here; name a calibration's folder, or a session's", code="card-missing"
        )
    if not path.is_file():
        raise CertificateError(
            f"{folder} is not a calibration: it has no {CARD_FILE}; {_meant(path.parent)}",
            code="card-missing",
        )
    if path.stat().st_size > MAX_CARD_BYTES:
        raise CertificateError(
            f"{path} is larger than {MAX_CARD_BYTES} bytes; a card never is", code="file-size"
        )
    text = path.read_bytes()
    return sealed_from(Card, text, path, FORMAT, "a card", "restore it or calibrate again")


def _meant(folder: Path) -> str:
    """Folder to suggest instead of one that is no calibration: the newest calibration inside it."""
    with suppress(OSError):
        within = sorted(folder.glob(f"*/{CARD_FILE}"), key=lambda card: card.stat().st_mtime)
        if within:
            return f"name {within[-1].parent}, which lies within and is one"
    return "name a folder that `palpate calibrate` made"


def checked_file(folder: Path, part: FileCard) -> Path:
    """Return the path of a part whose bytes match the card."""
    path = folder / part.file
    if path.is_symlink() or not path.is_file():
        raise CertificateError(
            f"{path} is missing or a link; restore the folder or calibrate again", code="file-missing"
        )
    if path.stat().st_size > MAX_MODEL_BYTES or sha256_of(path) != part.sha256:
        raise CertificateError(
            f"{path} has another SHA-256 than its card states; restore it or calibrate again",
            code="file-hash",
        )
    return path


def check_files(folder: PathText, card: Card) -> None:
    """Check that all files named by a card are unchanged."""
    of_copy = None if card.copy_of is None else card.copy_of.file
    for part in (card.model, card.guard, of_copy, *card.files):
        if part is not None:
            checked_file(Path(folder), part)


@dataclass(frozen=True, slots=True)
class Zero:
    """Reference image that a differential model subtracts, and its drift."""

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
        self,
        folder: Path,
        card: Card,
        session: onnxruntime.InferenceSession,
        novelty: NoveltyDetector,
        copies: CopyDiscriminator | None = None,
        *,
        coloured: bool = False,
    ) -> None:
        self.folder = folder
        self.card = card
        self._session = session
        self._novelty = novelty
        self._copies, self._coloured = copies, coloured
        self._preparation = card.input.preparation
        self._intervals = intervals_of(card)
        self._layout = layout_of(card)

    @classmethod
    @parser("calibration", CertificateError)
    def open(cls, folder: PathText, *, threads: int = 0) -> Estimator:
        """Open a calibration folder and check every part against the card.

        Args:
            folder: Folder made by `palpate calibrate`.
            threads: Number of threads of the inference engine; 0 lets it choose.

        Raises:
            CertificateError: A part is missing, altered, or does not fit the card.
        """
        folder = Path(folder)
        card = read_card(folder)
        novelty = NoveltyDetector.load(checked_file(folder, card.guard))
        session = _session(checked_file(folder, card.model), card, threads)
        copies = _copies_of(folder, card, novelty)
        return cls(folder, card, session, novelty, copies, coloured=_is_of_colour(folder, card))

    def zero(self, untouched: Image) -> Zero:
        """Return an image of the sensor without contact as reference, with its drift."""
        self._check_size(untouched)
        prepared = self._preparation.apply(untouched)
        return Zero(prepared.astype(np.float32), self._novelty.drift(prepared))

    def values(self, inputs: Tensor) -> Outputs:
        """Run the network on inputs ``[n c h w]``.

        Returns:
            Outputs ``[n o]``: estimates in the targets' units (cosine and sine of circular ones), then
                classes.
        """
        with _runtime_errors(f"the model in {self.folder} cannot read this image"):
            (value,) = self._session.run(["value"], {"image": inputs})
        return np.asarray(value, dtype=np.float64)

    def read(self, frame: Frame | Image, zero: Zero | None = None) -> Readings:
        """Read every target from one frame.

        Args:
            frame: Frame or image, 8-bit gray ``[h w]`` or RGB ``[h w 3]``; another size or kind gives invalid
                readings.
            zero: Reference from `zero`, needed if the calibration is differential.

        Returns:
            A reading for each target's column, in that column's unit.

        Raises:
            ImageError: A differential calibration got no `zero`, or `frame` is no such image.
        """
        return self.read_with_outputs(frame, zero)[0]

    def read_with_outputs(
        self, frame: Frame | Image, zero: Zero | None = None
    ) -> tuple[Readings, Outputs | None]:
        """Read a frame as `read` does, with the outputs ``[1 o]``; None if the frame has another size."""
        frame = frame if isinstance(frame, Frame) else Frame(frame)
        self._check_zero(zero)
        if frame.image.shape[:2] != self.card.input.frame_px:
            return self._readings(frame, None, self._wrong_size(frame.image), zero), None
        prepared = self._preparation.apply(frame.image)
        verdict = self._novelty.judge(prepared)
        why = NONE
        if verdict.atypicality > 1:
            why = Refusal(ReasonCode.OUT_OF_DISTRIBUTION, verdict.reason)
        if not why and self._copies is not None and self._copies.is_of_former(prepared):
            why = Refusal(ReasonCode.FORMER_UNIT, _copy_reason(self.card))
        if self._coloured and _is_grey(frame.image):
            why = Refusal(ReasonCode.GRAY_IMAGE, "the image is grey, and the calibration is of colour")
        outputs = self._outputs(prepared, zero)
        return self._readings(frame, outputs, why, zero), outputs

    def verdict(self, frame: Frame | Image) -> Verdict:
        """Return the guard's judgment of a frame, with the kind of change it resembles."""
        image = frame.image if isinstance(frame, Frame) else Frame(frame).image
        self._check_size(image)
        return self._novelty.judge(self._preparation.apply(image))

    def outputs(self, frame: Frame | Image, zero: Zero | None = None) -> Outputs:
        """Return the network's outputs ``[1 o]`` for one frame of the calibrated size."""
        image = frame.image if isinstance(frame, Frame) else Frame(frame).image
        self._check_size(image)
        self._check_zero(zero)
        return self._outputs(self._preparation.apply(image), zero)

    def _outputs(self, prepared: Image, zero: Zero | None) -> Outputs:
        picture = prepared.astype(np.float32)
        difference = picture - zero.image if self.card.input.delta and zero is not None else picture
        return self.values(np.ascontiguousarray(difference.transpose(2, 0, 1))[None])

    def unread(self, name: str, time_s: float, why: Refusal) -> Readings:
        """Return invalid readings without values for a frame that could not be read."""
        nothing = Frame(np.zeros((1, 1), np.uint8), time_s, name=name)
        return self._readings(nothing, None, why, None)

    def _readings(self, frame: Frame, outputs: Outputs | None, why: Refusal, zero: Zero | None) -> Readings:
        targets, drift = self.card.targets, None if zero is None else zero.drift
        whole = outputs
        outputs = None if outputs is None or not targets else outputs[:, : self._layout.outputs]
        if outputs is None:
            value = low = high = np.full(len(targets), np.nan)
        else:
            value = self._layout.decoded(outputs)[0]
            low, high = (ends[0] for ends in self._intervals.ends(outputs))
        read: dict[str, Reading | CircularReading | VectorReading] = {
            target.column: self._reading(target, (float(v), float(a), float(b)), why, drift, frame)
            for target, v, a, b in zip(targets, value, low, high, strict=True)
        }
        for vector in self.card.vectors or ():
            parts = [read[column] for column in vector.columns]
            at = [self.card.columns.index(column) for column in vector.columns]
            spread = None if outputs is None else self._intervals.spread.at(outputs)[0, at]
            reference = [targets[k].measured_by for k in at]
            read[vector.column] = vector_reading(vector, parts, spread, reference)
        return Readings({**read, **self._classes(frame, whole, why, drift)})

    def _classes(
        self, frame: Frame, outputs: Outputs | None, why: Refusal, drift: Drift | None
    ) -> dict[str, ClassReading]:
        return class_readings(
            self.card.classes or (),
            None if outputs is None else outputs[:, self._layout.outputs :],
            why,
            coverage=self.card.coverage,
            drift=drift,
            calibration=self.card.id,
            frame=frame.name,
            time_s=frame.time_s,
        )

    def _reading(
        self,
        target: TargetCard,
        place: tuple[float, float, float],
        why: Refusal,
        drift: Drift | None,
        frame: Frame,
    ) -> Reading | CircularReading:
        """Reading of an estimate and its interval, in the target's unit."""
        si, (value, low, high) = unit(target.unit), place
        why = why or doubt(target, value, low, high)
        low, high = (float(end) for end in with_reference(target, value, low, high))
        common: dict[str, Any] = {
            "quantity": target.quantity,
            "value": si.to_si(value),
            "low": si.to_si(low),
            "high": si.to_si(high),
            "unit": si.si,
            "coverage": self.card.coverage,
            "calibrated_range": (si.to_si(target.least), si.to_si(target.greatest)),
            "valid": not why,
            "why": why.why,
            "code": why.code,
            "drift": drift,
            "calibration": self.card.id,
            "frame": frame.name,
            "time_s": frame.time_s,
        }
        if target.circular is None:
            return Reading(**common)
        return CircularReading(**common, period=si.to_si(target.circular.period))

    def __repr__(self) -> str:
        targets = ", ".join(
            [f"{t.column} ± {half_width_text(t.score.half_width)}" for t in self.card.targets]
            + [f"{c.column} of {len(c.names)} classes" for c in self.card.classes or ()]
        )
        return f"<Estimator {self.card.id} of {self.card.sensor or 'a sensor'}: {targets}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(t.column)}</td><td>{rounded(t.least, half)} to {rounded(t.greatest, half)} "
            f"{t.unit}</td><td>{rounded(t.score.mae, half)} {t.unit}</td><td>± {half_width_text(half)} "
            f"{t.unit}</td></tr>"
            for t in self.card.targets
            for half in (t.score.half_width,)
        )
        heads = ("target", "range", "mean absolute error", f"{100 * self.card.coverage:g} % interval")
        head = "".join(f"<th>{name}</th>" for name in heads)
        return f"<table><caption>{escape(repr(self)[1:-1])}</caption><tr>{head}</tr>{rows}</table>"

    def _check_zero(self, zero: Zero | None) -> None:
        if self.card.input.delta and zero is None:
            raise ImageError(
                "this calibration needs an image without contact; give one with --reference FRAME"
            )

    def _check_size(self, image: Image) -> None:
        if image.shape[:2] != self.card.input.frame_px:
            raise ImageError(self._wrong_size(image).why)

    def _wrong_size(self, image: Image) -> Refusal:
        height, width = self.card.input.frame_px
        rows, columns = image.shape[:2]
        text = f"the image is {columns}x{rows} px, the calibration is for {width}x{height} px"
        return Refusal(ReasonCode.IMAGE_SIZE, text)


def _copies_of(folder: Path, card: Card, novelty: NoveltyDetector) -> CopyDiscriminator | None:
    """Discriminator of an adapted calibration's sensor units, or None."""
    if card.copy_of is None or card.copy_of.file is None:
        return None
    return CopyDiscriminator.load(checked_file(folder, card.copy_of.file), novelty.neighbours.thumbs[0].size)


def _is_of_colour(folder: Path, card: Card) -> bool:
    """Whether the model and its training frames have color."""
    example = next((part for part in card.files if part.file == "example.png"), None)
    if card.input.channels != 3 or example is None:
        return False
    image = opencv_image(np.fromfile(checked_file(folder, example), np.uint8), cv2.IMREAD_COLOR)
    return image is not None and not _is_grey(image)


def _is_grey(image: Image) -> bool:
    if image.ndim == 2:
        return True
    return np.array_equal(image[..., 0], image[..., 1]) and np.array_equal(image[..., 1], image[..., 2])


def _copy_reason(card: Card) -> str:
    name, former = (card.copy_of.name, card.copy_of.former) if card.copy_of else ("", "")
    return (
        f"the image looks like one of {former}, and this calibration was adapted to {name}; read it with the "
        "calibration that was adapted from, or adapt anew"
    )


def _session(path: Path, card: Card, threads: int) -> onnxruntime.InferenceSession:
    with storage_errors(path):
        model = path.read_bytes()
    outputs = layout_of(card).outputs + class_count(card.classes)
    admit_model(model, str(path), (card.input.channels, *card.input.size_px), outputs)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    # Threads that spin while idle take the cores from the novelty detector: asleep, they halve the 95th
    # percentile of a frame's latency on two cores.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    with _runtime_errors(f"{path} is not a model that can be run"):
        # From bytes, so that nothing beside the file can be drawn in.
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


@contextmanager
def _runtime_errors(what: str) -> Iterator[None]:
    try:
        yield
    except Exception as e:  # onnxruntime raises many kinds of its own, which share no parent
        raise CertificateError(f"{what} ({e}). Restore it or calibrate again.", code="onnx-runtime") from e
