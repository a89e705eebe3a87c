"""Plan of a calibration: one frozen page, checked when it is made and saved with the result."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal

from palpate.core import InputError, Lens, split_column
from palpate.core.plugins import import_path_of
from palpate.estimators.class_sets import FULL_TURN, TargetLayout, default_period
from palpate.estimators.intervals import vector_column
from palpate.recordings.manifest import ReferenceInstrument

if TYPE_CHECKING:
    from palpate.estimators.model_card import Card

SESSION = "session"  # of `recordings.splits`, which would load tables


@dataclass(frozen=True, slots=True)
class ReferenceRule:
    """Rule that names the no-contact rows.

    Attributes:
        column, value: rows where a label column has this value (compared as a number where both are).
        by: columns whose groups have a reference each; empty for one reference.
    """

    column: str
    value: str
    by: tuple[str, ...] = ()

    @classmethod
    def parse(cls, text: str, by: tuple[str, ...] = ()) -> ReferenceRule:
        """Parse ``column=value``, e.g. ``mass_g=0``."""
        column, equals, value = text.partition("=")
        if not (column and equals and value):
            raise InputError(
                f"reference {text!r} is not COLUMN=VALUE, as in mass_g=0 or touched=false",
                code="reference-form",
            )
        return cls(column.strip(), value.strip(), by)

    @classmethod
    def of_card(cls, card: Card) -> ReferenceRule | None:
        """Rule that a certificate states; None where it has none."""
        rule = card.reference
        return None if rule.column is None or rule.value is None else cls(rule.column, rule.value, rule.by)

    def for_columns(self, columns: Iterable[str]) -> ReferenceRule:
        """The same rule in a table of these columns: one that names no session is all of one session."""
        by = tuple(name for name in self.by if name != SESSION or name in set(columns))
        return replace(self, by=by)


@dataclass(frozen=True, slots=True)
class CalibrationPlan:
    """Checked plan of one calibration.

    Attributes:
        targets: label columns to estimate, named quantity_unit.
        model: name from `estimators.networks.MODELS`, ``module:Class``, or an entry point's name; a class or
            an instance is kept as ``module:Class`` and `options`.
        split: see `recordings.splits.split`; a function is kept as ``module:function``.
        folds: number of folds; None takes five, or eight where the model is costly to train.
        scored_folds: number of folds held out in turn; None takes all, or one where the model is costly and
            one fold gives enough scores. With one, the scored model is the one kept.
        fold_by: label columns by which a single scored fold is chosen; empty takes the targets.
        seed: seed of everything random.
        size_px: (height, width) of the network's input [px]; None takes the model's own.
        crop_px, beside_px: (x, y, width, height) cut from each frame first, and a second crop laid to its
            right [px].
        delta: train on the difference to a no-contact reference.
        learn_untouched: train on (and score) no-contact rows too.
        coverage: rate of the intervals, 0.5 to 1.
        skin_px: (x, y, width, height) of the skin in the frame [px]; None finds it.
        options: the model's own fields.
        circular: periodic targets and their period in their unit; None takes a full turn.
        vectors: name of each vector that is also read as a whole, and its components among the targets.
        instruments: reference instruments of label columns; precede the run's manifest.
        classes: label columns of classes or counts, and their names in ascending order; none for the values.
        lens: camera lens by which frames are rectified first; crops then count in the rectified image.

    Raises:
        InputError: a field is out of its range; the message says what is allowed.
        UnitError, SplitError, PluginError: a target without a unit, an unknown split, or a plug-in that
            fails.

    Example:
        >>> CalibrationPlan(("depth_mm", "force_N"), split="group:press").model
        'kernel-ridge'
    """

    targets: Sequence[str]
    model: Any = "kernel-ridge"
    split: Any = "auto"
    folds: int | None = None
    scored_folds: int | None = None
    fold_by: tuple[str, ...] = ()
    seed: int = 0
    size_px: tuple[int, int] | None = None
    channels: Literal[1, 3] = 1
    crop_px: tuple[int, int, int, int] | None = None
    beside_px: tuple[int, int, int, int] | None = None
    delta: bool = False
    reference: ReferenceRule | None = None
    learn_untouched: bool = False
    coverage: float = 0.9
    skin_px: tuple[int, int, int, int] | None = None
    options: dict[str, Any] = field(default_factory=dict)
    circular: dict[str, float | None] = field(default_factory=dict)
    vectors: dict[str, tuple[str, ...]] = field(default_factory=dict)
    instruments: dict[str, ReferenceInstrument] = field(default_factory=dict)
    classes: dict[str, tuple[str, ...]] = field(default_factory=dict)
    lens: Lens | None = None

    def __post_init__(self) -> None:
        # Here, since whoever senses reads a `ReferenceRule`, and needs neither models nor tables.
        from palpate.estimators.networks import model_kind
        from palpate.recordings.splits import check_split_text

        object.__setattr__(self, "targets", _targets(self.targets, classes=bool(self.classes)))
        if not isinstance(self.model, str):
            name, options = _own_model(self.model, self.options)
            object.__setattr__(self, "model", name)
            object.__setattr__(self, "options", options)
        model_kind(self.model)
        if not isinstance(self.split, str):
            object.__setattr__(self, "split", import_path_of(self.split, "split"))
        check_split_text(self.split)
        self._check_numbers()
        _check_classes(self)
        object.__setattr__(self, "circular", _periods(self.circular, self.targets))
        if self.circular and self.options.get("turns", 1) != 1:
            raise InputError(
                f"turns={self.options['turns']} turns training images, and a direction would have to "
                f"turn with "
                f"them, which is not built; leave turns out, or calibrate {', '.join(self.circular)} "
                f"by itself",
                code="turned-images",
            )
        object.__setattr__(self, "vectors", _vectors(self.vectors, self.targets, self.circular))
        if both := sorted(self.vectors.keys() & self.classes.keys()):
            raise InputError(
                f"{', '.join(both)} is a vector and a class at once; give the vector another name",
                code="name-taken",
            )

    @classmethod
    def of_card(
        cls,
        card: Card,
        reference: ReferenceRule | None,
        split: str = "auto",
        instruments: Mapping[str, ReferenceInstrument] | None = None,
    ) -> CalibrationPlan:
        """Return the plan that prepares images and rows as a certificate's did; the model is not its own.

        Args:
            instruments: reference instruments of a new run; where it states none, the certificate's stands.
        """
        image = card.input
        former = {t.column: t.measured_by for t in card.targets if t.measured_by is not None}
        return cls(
            targets=tuple(card.columns),
            split=split,
            seed=card.seed,
            size_px=image.size_px,
            channels=image.channels,
            crop_px=image.crop_px,
            beside_px=image.beside_px,
            delta=image.delta,
            reference=reference,
            learn_untouched=card.reference.learnt,
            coverage=card.coverage,
            circular={t.column: t.circular.period for t in card.targets if t.circular is not None},
            vectors={vector.column: vector.columns for vector in card.vectors or ()},
            instruments={
                **{
                    column: ReferenceInstrument(**one.model_dump(exclude={"half_width"}))
                    for column, one in former.items()
                },
                **{column: one for column, one in (instruments or {}).items() if column in card.columns},
            },
            classes={one.column: one.names for one in card.classes or ()},
            lens=image.preparation.lens,
        )

    @property
    def layout(self) -> TargetLayout:
        return TargetLayout(tuple(self.circular.get(target) for target in self.targets))

    def _check_numbers(self) -> None:
        boxes = {"crop": self.crop_px, "second crop": self.beside_px, "skin": self.skin_px}
        checks = [
            (self.folds is None or self.folds >= 2,
             f"{self.folds} folds; a split needs 2 or more, to train on one and hold one out"),
            (self.scored_folds is None or self.scored_folds >= 1,
             f"{self.scored_folds} folds to score; at least 1 must be held out"),
            (self.seed >= 0, f"seed {self.seed}; a seed is 0 or more"),
            (self.channels in (1, 3), f"{self.channels} channels; 1 for grey or 3 for RGB"),
            (0.5 <= self.coverage < 1,
             f"coverage is {self.coverage}; it is a rate from 0.5 up to, not including, 1"),
            (self.size_px is None or min(self.size_px) >= 1,
             f"an input of {self.size_px} px; its height and width are 1 px or more"),
            *((box is None or (min(box[:2]) >= 0 and min(box[2:]) >= 1),
               f"{name} {box} px; x and y are 0 or more, width and height 1 or more")
              for name, box in boxes.items()),
        ]  # fmt: skip
        for holds, why in checks:
            if not holds:
                raise InputError(why, code="plan-range")

    def to_dict(self) -> dict[str, Any]:
        plain = asdict(replace(self, lens=None)) | {
            "instruments": {k: v.model_dump() for k, v in self.instruments.items()},
            "lens": None if self.lens is None else self.lens.card(),
        }
        later = ("fold_by", "circular", "vectors", "instruments", "classes", "lens")
        return {k: v for k, v in plain.items() if v or k not in later}


def _periods(asked: dict[str, float | None], targets: Sequence[str]) -> dict[str, float | None]:
    periods: dict[str, float | None] = {}
    for column, period in asked.items():
        if column not in targets:
            raise InputError(
                f"circular {column} is not among the targets, {', '.join(targets) or 'none'}",
                code="no-target",
            )
        symbol = split_column(column)[1].symbol
        period = default_period(symbol) if period is None else period
        turn = FULL_TURN.get(symbol)
        parts = None if turn is None or not period > 0 else turn / period
        if not 0 < period < math.inf or (parts is not None and abs(parts - round(parts)) > 1e-6 * parts):
            allowed = (
                "above 0" if turn is None else f"a full turn, {turn:.6g} {symbol}, or a whole part of it"
            )
            raise InputError(
                f"circular {column}: a period of {period:g} {symbol}; it is {allowed}", code="period"
            )
        periods[column] = float(period)
    return periods


def _vectors(
    asked: dict[str, tuple[str, ...]], targets: Sequence[str], circular: dict[str, float | None]
) -> dict[str, tuple[str, ...]]:
    vectors: dict[str, tuple[str, ...]] = {}
    for name, parts in asked.items():
        column = vector_column(name, parts, targets)
        if turning := [part for part in parts if part in circular]:
            raise InputError(
                f"vector {name}: {', '.join(turning)} is circular, and an ellipsoid has no turn",
                code="circular-component",
            )
        if column in vectors:
            raise InputError(
                f"two vectors are called {column}; give each a name of its own", code="name-taken"
            )
        vectors[column] = tuple(parts)
    return vectors


VECTOR_NAME = re.compile(r"[^\W_][\w.-]*")


def check_vector_names(vectors: Iterable[str], labels: Iterable[str], source: str) -> None:
    """Check the column names of vectors, which share tables and readings with the labels.

    Args:
        vectors: vector columns, with the unit.
        labels: label columns of the run.
        source: name of the run in messages.
    """
    for column in vectors:
        if not VECTOR_NAME.fullmatch(column):
            raise InputError(
                f"vector {column!r}: its name has letters, digits, _, - and . alone, and begins with a "
                "letter or a digit, as in force",
                code="vector-name",
            )
        if column in labels:
            raise InputError(
                f"vector {column}: {source} has a label column of that name; give the vector a name "
                "of its own",
                code="name-taken",
            )


def _check_classes(plan: CalibrationPlan) -> None:
    from palpate.estimators.networks import model_kind

    for column, names in plan.classes.items():
        if column in plan.circular:
            raise InputError(
                f"{column} is circular and a class at once: an angle is no class; say one of both",
                code="two-roles",
            )
        if column in plan.targets:
            raise InputError(
                f"{column} is named as a target and as a class; say one of both", code="two-roles"
            )
        if len(set(names)) < len(names) or not all(name.strip() and "|" not in name for name in names):
            raise InputError(
                f"classes of {column}: {', '.join(names)}; each has a name of its own, without |",
                code="class-names",
            )
    if plan.classes and model_kind(plan.model).targets:
        raise InputError(
            f"model {plan.model} was made for {', '.join(model_kind(plan.model).targets)} alone, and "
            "learns no classes; take another, such as kernel-ridge",
            code="model-classes",
        )


def _targets(names: Sequence[str], *, classes: bool = False) -> tuple[str, ...]:
    """The targets' names, each once and with a unit; none where there are classes to learn."""
    if isinstance(names, str):
        hint = ", ".join(repr(name.strip()) for name in names.split(","))
        raise InputError(f"targets are a tuple of names, not the text {names!r}; give ({hint},)")
    targets = tuple(names)
    if not targets and not classes:
        raise InputError(
            "no target to calibrate; name label columns, as in --targets depth_mm,force_N", code="no-target"
        )
    repeated = sorted({t for t in targets if targets.count(t) > 1})
    if repeated:
        raise InputError(f"targets named twice: {', '.join(repeated)}; name each once", code="target-twice")
    for name in targets:
        split_column(name)
    return targets


def _own_model(model: Any, options: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The ``module:Class`` of a class or an instance, and the settings that an instance carries."""
    if isinstance(model, type):
        return import_path_of(model, "model"), options
    from palpate.estimators.networks import model_class

    path = import_path_of(type(model), "model")
    model_class(path)
    if options:
        raise InputError(f"model {path} is an instance with its settings; set {', '.join(options)} there")
    return path, {f.name: getattr(model, f.name) for f in fields(model) if f.init}
