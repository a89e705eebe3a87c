"""Measured quantities that say how far they can be trusted: scalars, angles, vectors, fields, candidates.

Each kind says what its coverage is a rate of, and its `contains` is the event that is counted. All carry what
`MeasurementResult` holds; `Readings` are those of one frame.

Class of what was touched, read from one frame, with the set of classes that the frame leaves open.

Reason why a reading is not valid: a code for programs, a sentence for people.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from html import escape
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from palpate.core.errors import ColumnError, InputError, UnitError
from palpate.core.shapes import Float
from palpate.core.units import half_width_text, has_unit, interval_text, rounded, split_column, unit

Same = TypeVar("Same", bound="MeasurementResult")


@dataclass(frozen=True, slots=True)
class Drift:
    """Change of the untouched sensor since calibration.

    Attributes:
        statistic: distance of the no-contact image from the calibration's, in units of the spread among
            the calibration's own no-contact images; around 1 when nothing has changed.
        limit: the statistic above which the calibration is stale.
    """

    statistic: float
    limit: float

    @property
    def drifted(self) -> bool:
        """True where the sensor must be re-zeroed or calibrated anew."""
        return not self.statistic <= self.limit  # NaN counts as drifted

    def to_dict(self) -> dict[str, Any]:
        """Statistic, limit, and verdict as plain values for JSON."""
        return {
            "statistic": plain_number(self.statistic),
            "limit": plain_number(self.limit),
            "drifted": self.drifted,
        }


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class MeasurementResult:
    """The part of a reading beside its value, the same for every kind.

    Attributes:
        quantity: what was measured, e.g. ``depth``.
        unit: of all that has one; SI until `in_unit` converts it.
        coverage: how often such intervals or regions hold the truth, by calibration (0.9 is nine in ten).
        valid: False when the value should not be used.
        why: why it should not be; empty when valid.
        code: machine-readable reason, such as ``camera_moved``; empty when valid.
        drift: of the sensor since calibration; None where no no-contact image was given or kept.
        calibration: id of the calibration that made the estimate.
        frame: name of the frame it was read from.
        time_s: that frame's capture time [s].
    """

    _WITH_UNIT: ClassVar[tuple[str, ...]]  # the fields of a kind that have the unit

    quantity: str
    unit: str
    coverage: float
    valid: bool
    why: str
    drift: Drift | None
    calibration: str
    frame: str
    time_s: float
    code: str = ""

    @property
    def column(self) -> str:
        """The name at the edges, with the unit in it: ``depth_mm``."""
        return f"{self.quantity}_{self.unit}"

    @property
    def verdict(self) -> str:
        """Verdict in words: may it be used, and why not."""
        return "inside the calibrated range" if self.valid else self.why

    def in_unit(self: Same, symbol: str) -> Same:
        """The same reading in another unit of the same quantity."""
        if symbol == self.unit:
            return self
        old, new = unit(self.unit), unit(symbol)
        if old.si != new.si:
            raise UnitError(
                f"{self.quantity} is in {self.unit}, which cannot be shown in {symbol}",
                code="unit-conversion",
            )

        def convert(part: Any) -> Any:
            if isinstance(part, tuple | list):
                return tuple(convert(one) for one in part)
            if isinstance(part, Ellipsoid | AlignedBox):
                return part.scaled(convert(1.0))
            return new.from_si(old.to_si(part))

        return replace(self, unit=symbol, **{name: convert(getattr(self, name)) for name in self._WITH_UNIT})

    def to_dict(self) -> dict[str, Any]:
        """Value, interval, verdict, and drift as plain values for JSON; what is no number is None."""
        drift = None if self.drift is None else self.drift.to_dict()
        return {
            **self._numbers(), "valid": self.valid, "why": self.why, "code": self.code, "drift": drift,
        }  # fmt: skip

    def _numbers(self) -> dict[str, Any]:
        """The value and what surrounds it, as plain values."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self}>"

    def _repr_html_(self) -> str:
        return f"<code>{escape(str(self))}</code>"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Reading(MeasurementResult):
    """One scalar read from one frame.

    Attributes:
        value: the estimate, in `unit`.
        low, high: the interval around it, in `unit`.
        calibrated_range: least and greatest value the calibration saw, in `unit`.
    """

    _WITH_UNIT = ("value", "low", "high", "calibrated_range")

    value: float
    low: float
    high: float
    calibrated_range: tuple[float, float]

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise InputError(
                f"{self.quantity}: the interval {self.low} to {self.high} {self.unit} runs downwards"
            )

    def contains(self, truth: float) -> bool:
        """True where a value, in `unit`, lies in the interval."""
        return bool(self.low <= truth <= self.high)

    def _numbers(self) -> dict[str, Any]:
        value, low, high = _plain((self.value, self.low, self.high))
        ends = {"low": low, "high": high, "range": _plain(self.calibrated_range)}
        return {"value": value, "unit": self.unit, **ends}

    def __str__(self) -> str:
        value, around = interval_text(self.value, self.low, self.high)
        unit = self.unit.replace("_per_", "/")
        return f"{self.quantity} {value} {unit} {around} {unit}, {self.verdict}"


class Readings(Mapping[str, MeasurementResult]):
    """The readings of one frame, each in the unit that the key asks for.

    The keys are the calibration's columns. A quantity's name alone gives it in SI, and with another unit of
    the same quantity behind it, in that one.

    Example:
        readings = estimator.read(frame)
        readings["depth_mm"].value      # in mm
        readings["depth_um"].value      # the same in µm
        readings["depth"].value         # the same in m
    """

    def __init__(self, readings: Mapping[str, MeasurementResult]) -> None:
        """Keep readings in SI by their columns.

        Args:
            readings: a reading for each column, whose name ends in its unit.
        """
        self._by_column = dict(readings)

    def __getitem__(self, key: str) -> Any:
        if key in self._by_column:
            own = self._by_column[key]
            return own.in_unit(split_column(key)[1].symbol) if own.unit else own  # a class has no unit
        quantity, target = split_column(key) if has_unit(key) else (key, None)
        alike = [one for one in self._by_column.values() if one.unit and one.quantity in (key, quantity)]
        if target is not None:
            alike = [one for one in alike if one.quantity == key or unit(one.unit).si == target.si]
        if len(alike) != 1:
            several = f"{len(alike)} readings are called" if alike else "there is no reading"
            raise ColumnError(f"{several} {key!r}; there are {', '.join(self)}", code="no-reading")
        (one,) = alike
        return one.in_unit(target.symbol if target is not None and one.quantity != key else unit(one.unit).si)

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_column)

    def __len__(self) -> int:
        return len(self._by_column)

    @property
    def valid(self) -> bool:
        """True where every reading may be used."""
        return all(one.valid for one in self._by_column.values())

    def __repr__(self) -> str:
        return f"<Readings {'; '.join(str(one) for one in self.values())}>"

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><td>{name}</td><td>{escape(str(one))}</td></tr>" for name, one in self.items())
        return f"<table>{rows}</table>"


def plain_number(value: float) -> float | None:
    """Six significant digits, or None for what is not a number."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def wrapped(difference: float, period: float) -> float:
    """A difference modulo the period: the shortest way round, from -period/2 up to, not including, period/2.

    Example:
        >>> wrapped(179.0 - (-179.0), 360.0)
        -2.0
    """
    return (difference + period / 2) % period - period / 2


MAX_ROUNDINGS = 4  # units in the last place by which an end of an arc moves when turns are added to it


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class CircularReading(MeasurementResult):
    """A scalar that comes round again, such as an angle of ±180°; the coverage is that of the arc.

    Attributes:
        value: the estimate, in `unit`.
        low, high: the arc, from `low` upwards to `high`, with low ≤ value ≤ high; an end may lie outside the
            principal turn, as 170° and 190° do around 180°.
        period: after which it comes round again, in `unit`.
        calibrated_range: the arc that the calibration saw, from the first upwards to the second.
    """

    _WITH_UNIT = ("value", "low", "high", "period", "calibrated_range")

    value: float
    low: float
    high: float
    period: float
    calibrated_range: tuple[float, float]

    def __post_init__(self) -> None:
        if not self.period > 0:
            raise InputError(f"{self.quantity}: the period is {self.period} {self.unit}; it is above 0")
        if self.low > self.value or self.value > self.high:
            raise InputError(
                f"{self.quantity}: the arc from {self.low} to {self.high} {self.unit} does not hold its "
                f"value {self.value} {self.unit}; let its ends run on beyond half a period",
                code="arc-without-value",
            )

    def distance(self, other: float) -> float:
        """The shortest way from `other` to the value, with its sign, in `unit`."""
        return wrapped(self.value - other, self.period)

    def contains(self, truth: float) -> bool:
        """True where a value, in `unit`, lies on the arc, its ends included whatever the turn."""
        if not math.isfinite(truth):
            return False
        if self.high - self.low >= self.period:
            return True
        rounding = MAX_ROUNDINGS * np.spacing(max(abs(truth), abs(self.low), abs(self.high), self.period))
        beyond_low = (truth - self.low + rounding) % self.period
        return bool(beyond_low <= self.high - self.low + 2 * rounding)

    def _numbers(self) -> dict[str, Any]:
        numbers = {n: plain_number(getattr(self, n)) for n in ("value", "low", "high", "period")}
        return {**numbers, "unit": self.unit, "range": _plain(self.calibrated_range)}

    def __str__(self) -> str:
        half = min(self.high - self.low, self.period) / 2
        shown = wrapped(self.value, self.period)
        return (
            f"{self.quantity} {rounded(shown, half)} {self.unit} ± {half_width_text(half)} {self.unit} "
            f"(modulo {self.period:g} {self.unit}), {self.verdict}"
        )


MAX_ASYMMETRY = 1e-5  # of a covariance, over its trace: what numbers of single precision leave


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """A joint region around a vector: offsets d with dᵀ S⁻¹ d ≤ radius².

    Attributes:
        covariance: S, in the square of the unit, symmetric and positive definite.
        radius: how many standard deviations it reaches along each axis of S.
    """

    covariance: Float[np.ndarray, "k k"]
    radius: float

    def __post_init__(self) -> None:
        if not (_positive_definite(self.covariance) and self.radius > 0):
            raise InputError("a region's covariance is symmetric and positive definite, its radius above 0")

    def contains(self, offset: Float[np.ndarray, " k"]) -> bool:
        """True where an offset from the estimate lies within it."""
        return bool(offset @ np.linalg.solve(self.covariance, offset) <= self.radius**2)

    @property
    def half_widths(self) -> Float[np.ndarray, " k"]:
        """Reach of the ellipsoid along each component."""
        return np.asarray(self.radius * np.sqrt(np.diag(self.covariance)))

    def scaled(self, factor: float) -> Ellipsoid:
        """The same region in a unit that is 1/`factor` as large."""
        return Ellipsoid(self.covariance * factor**2, self.radius)


@dataclass(frozen=True, slots=True, eq=False)
class AlignedBox:
    """A joint region around a vector: each component within its half-width, all at once.

    Attributes:
        half_widths: in the unit, 0 or more.
    """

    half_widths: Float[np.ndarray, " k"]

    def __post_init__(self) -> None:
        if not (self.half_widths >= 0).all():
            raise InputError(f"a box has half-widths of 0 or more, got {self.half_widths.tolist()}")

    def contains(self, offset: Float[np.ndarray, " k"]) -> bool:
        """True where an offset from the estimate lies within it."""
        return bool((np.abs(offset) <= self.half_widths).all())

    def scaled(self, factor: float) -> AlignedBox:
        """The same region in a unit that is 1/`factor` as large."""
        return AlignedBox(self.half_widths * factor)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class VectorReading(MeasurementResult):
    """Several components that were estimated together; the coverage is that of the joint region.

    Attributes:
        components: their names, such as ``("x", "y")``.
        value: the estimates ``[k]``, in `unit`.
        region: around `value`; it holds all components at once at the rate `coverage`.
        calibrated_range: least and greatest of each component that the calibration saw ``[2 k]``, in `unit`.
    """

    _WITH_UNIT = ("value", "region", "calibrated_range")

    components: tuple[str, ...]
    value: Float[np.ndarray, " k"]
    region: Ellipsoid | AlignedBox
    calibrated_range: Float[np.ndarray, "2 k"]

    def __post_init__(self) -> None:
        k = len(self.components)
        if not k or len(set(self.components)) != k:
            raise InputError(f"{self.quantity}: components {self.components}; name one or more, each once")
        if self.value.shape != (k,) or self.region.half_widths.shape != (k,):
            raise InputError(f"{self.quantity}: {k} components need {k} values and a region of {k} axes")
        if np.shape(self.calibrated_range) != (2, k):
            raise InputError(
                f"{self.quantity}: a calibrated range {np.shape(self.calibrated_range)}; {k} components need "
                f"the least and the greatest of each, {(2, k)}",
                code="range-shape",
            )

    def contains(self, truth: Float[np.ndarray, " k"]) -> bool:
        """True where a vector, in `unit`, lies in the joint region."""
        return self.region.contains(truth - self.value)

    def component(self, name: str) -> Reading:
        """One component with the region's reach along it; it holds the truth at least at the joint rate."""
        if name not in self.components:
            raise ColumnError(
                f"{self.quantity} has no component {name!r}: {', '.join(self.components)}",
                code="no-component",
            )
        at = self.components.index(name)
        value, half = float(self.value[at]), float(self.region.half_widths[at])
        least, greatest = (float(end) for end in self.calibrated_range[:, at])
        return Reading(
            quantity=f"{self.quantity}_{name}",
            value=value,
            low=value - half,
            high=value + half,
            calibrated_range=(least, greatest),
            **provenance(self),
        )

    def _numbers(self) -> dict[str, Any]:
        region = self.region
        joint = (
            {"covariance": _plain(region.covariance), "radius": plain_number(region.radius)}
            if isinstance(region, Ellipsoid)
            else {"half_widths": _plain(region.half_widths)}
        )
        return {
            "value": dict(zip(self.components, _plain(self.value), strict=True)),
            "unit": self.unit,
            "region": joint,
            "range": _plain(self.calibrated_range),
        }

    def __str__(self) -> str:
        each = zip(self.components, self.value, self.region.half_widths, strict=True)
        shown = ", ".join(f"{name} {rounded(v, half)} ± {half_width_text(half)}" for name, v, half in each)
        return f"{self.quantity} ({shown}) {self.unit} together, {self.verdict}"


def _positive_definite(matrix: np.ndarray) -> bool:
    """Tell whether it is a square matrix that is finite, symmetric and positive definite."""
    square = np.ndim(matrix) == 2 and len(matrix) == len(matrix.T) > 0
    if not (square and np.isfinite(matrix).all()):
        return False
    symmetric = np.allclose(matrix, matrix.T, rtol=0, atol=MAX_ASYMMETRY * abs(np.trace(matrix)))
    return symmetric and bool(np.linalg.eigvalsh(matrix).min() > 0)


def frame_record(frame: str, time_s: float, readings: Readings | None) -> dict[str, Any]:
    """The readings of a frame in plain values, for one JSON object."""
    first = next(iter(readings.values()), None) if readings else None
    return {
        "frame": frame,
        "time_s": round(time_s, 6),
        "readings": {name: one.to_dict() for name, one in (readings or {}).items()},
        "drift": None if first is None or first.drift is None else first.drift.to_dict(),
        "calibration": None if first is None else first.calibration,
    }


def provenance(of: MeasurementResult) -> dict[str, Any]:
    """All that a reading carries beside its quantity and its value, for another made from it."""
    names = ("unit", "coverage", "valid", "why", "code", "drift", "calibration", "frame", "time_s")
    return {name: getattr(of, name) for name in names}


def _plain(array: Any) -> Any:
    """Nested lists of plain numbers; None where there is none."""
    return [_plain(part) if np.ndim(part) else plain_number(float(part)) for part in array]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ClassReading(MeasurementResult):
    """One class of several, or one count; the coverage is that of the set, in each class by itself.

    It has no unit, and its `quantity` is the label column.

    Attributes:
        value: the likeliest class; empty where nothing was read.
        members: the prediction set, in the order of `classes`; it holds the true class at the rate `coverage`
            whichever class that is.
        classes: all that were calibrated.
    """

    _WITH_UNIT: ClassVar[tuple[str, ...]] = ()

    value: str
    members: tuple[str, ...]
    classes: tuple[str, ...]

    def __post_init__(self) -> None:
        if strangers := {*self.members, self.value} - {*self.classes, ""}:
            raise InputError(
                f"{self.quantity}: {', '.join(sorted(strangers))} is none of the classes "
                f"{', '.join(self.classes)}"
            )

    @property
    def column(self) -> str:
        """The label column, which carries no unit."""
        return self.quantity

    @property
    def verdict(self) -> str:
        """Verdict in words: may it be used, and why not."""
        told = "told" if len(self.members) == 1 else "narrowed down"
        return told if self.valid else self.why

    def in_unit(self, symbol: str) -> ClassReading:
        """The same reading; a class has no unit."""
        if symbol != self.unit:
            raise UnitError(f"{self.quantity} is a class, which cannot be shown in {symbol}")
        return self

    def contains(self, truth: str) -> bool:
        """True where a class is in the set."""
        return truth in self.members

    def _numbers(self) -> dict[str, Any]:
        return {"value": self.value or None, "set": list(self.members), "classes": list(self.classes)}

    def __str__(self) -> str:
        return f"{self.quantity} {self.value or '-'}, set {{{', '.join(self.members)}}}, {self.verdict}"


class ReasonCode(StrEnum):
    """Codes of invalid readings in JSON; the last ones are of presses on an object."""

    UNREADABLE = "unreadable_frame"
    IMAGE_SIZE = "image_size"
    GRAY_IMAGE = "gray_image"
    NO_REFERENCE_IMAGE = "no_reference_image"
    OUT_OF_DISTRIBUTION = "out_of_distribution"
    FORMER_UNIT = "former_unit"
    NOT_LEARNED = "not_learned"
    UNDETERMINED = "undetermined"
    OUTSIDE_RANGE = "outside_range"
    INTERVAL_OUTSIDE_RANGE = "interval_outside_range"
    NO_CLASS = "no_class"
    ALL_CLASSES = "all_classes"
    CLASS_NOT_IN_SET = "class_not_in_set"
    FLAWED_PRESS = "flawed_press"
    DRIFTED = "drifted"
    SPEED = "speed_outside_range"
    REPEATED_FRAMES = "repeated_frames"
    OFF_CENTER = "off_center"
    CUES_DISAGREE = "cues_disagree"
    TWO_REFERENCES = "two_references"
    CURVED = "curved_object"
    TOO_STIFF = "too_stiff"
    INCLINED = "inclined"
    NOT_HERTZ = "not_hertz"
    SHAPE_OUTSIDE_RANGE = "shape_outside_range"


OF_ALL_FRAMES = frozenset({ReasonCode.IMAGE_SIZE, ReasonCode.NO_REFERENCE_IMAGE})
"""Codes that hold for every frame of a source alike until the source or the reference image changes."""


class Refusal(NamedTuple):
    """Reason of an invalid reading; false where there is none.

    Attributes:
        code: machine-readable, such as ``camera_moved``.
        why: the same in words.
    """

    code: str = ""
    why: str = ""

    def __bool__(self) -> bool:
        return bool(self.code)


NONE = Refusal()
SEPARATOR = "; "  # between the reasons of one reading


def joined(reasons: Iterable[Refusal]) -> dict[str, str | bool]:
    """Return the fields `valid`, `why`, and `code` of a reading; each text and each code occurs once."""
    listed = list(reasons)
    return {
        "valid": not listed,
        "why": SEPARATOR.join(dict.fromkeys(one.why for one in listed)),
        "code": SEPARATOR.join(dict.fromkeys(str(one.code) for one in listed)),
    }
