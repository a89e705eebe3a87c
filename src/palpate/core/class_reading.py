"""Class of what was touched, read from one frame, with the set of classes that the frame leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from palpate.core.errors import InputError, UnitError
from palpate.core.reading import MeasurementResult


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
