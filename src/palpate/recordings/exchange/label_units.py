"""Units of imported columns: given by name where they have none, and doubted where the numbers are odd."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from palpate.core import UNITS, LabelError, Unit, UnitError, has_unit, split_column, unit
from palpate.recordings.label_tables import label_kinds, names_text, refuse_reserved, rows_text


def with_units(
    table: pd.DataFrame, renames: Mapping[str, str], units: Mapping[str, str], source: str
) -> pd.DataFrame:
    """Rename columns, and append a unit to the names of those that have none.

    Args:
        units: a column's name, or its new one -> its unit; ``depth`` in ``mm`` becomes ``depth_mm``.
    """
    _refuse_strangers(table, renames, source)
    for old, new in renames.items():
        if not new.strip():
            raise LabelError(f"{source}: column {old!r} is renamed to nothing; give a name such as depth_mm")
    table = table.rename(columns=dict(renames))
    _refuse_strangers(table, units, source)
    for name, symbol in units.items():
        unit(symbol)
        if has_unit(name):
            raise UnitError(
                f"{source}: column {name!r} has a unit already, {split_column(name)[1].symbol}; to correct "
                "it say "
                f"--rename {name}={split_column(name)[0]}_{symbol}"
            )
    table = table.rename(columns={name: f"{name}_{symbol}" for name, symbol in units.items()})
    names = [str(name) for name in table.columns]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LabelError(f"{source}: two columns would be called {twice[0]!r}; rename one otherwise")
    refuse_reserved([*renames.values()], source)
    return table


def _refuse_strangers(table: pd.DataFrame, names: Mapping[str, str], source: str) -> None:
    for name in names:
        if name not in table.columns:
            raise LabelError(f"{source} has no column {name!r}; its columns are {names_text(table.columns)}")


GUESSES = (
    (("depth", "indent", "shear", "position", "dist", "height", "radius", "disp", "edge"), "mm"),
    (("force", "load"), "N"),
    (("torque", "moment"), "Nmm"),
    (("angle", "tilt", "twist", "yaw", "roll", "pitch", "rot", "theta"), "deg"),
    (("mass", "weight"), "g"),
    (("pressure", "modulus", "stiffness"), "kPa"),
    (("time", "stamp"), "s"),
)
"""Parts of names, and the unit that such a quantity mostly is in."""
_LETTERS = {
    "x": "mm",
    "y": "mm",
    "z": "mm",
    "fx": "N",
    "fy": "N",
    "fz": "N",
    "tx": "Nmm",
    "ty": "Nmm",
    "tz": "Nmm",
}


def guessed_unit(name: str) -> str | None:
    """Unit that a column of this name mostly is in; None where the name tells nothing."""
    plain = name.lower()
    if plain in _LETTERS:
        return _LETTERS[plain]
    return next((symbol for parts, symbol in GUESSES if any(part in plain for part in parts)), None)


@dataclass(frozen=True, slots=True)
class UsualSize:
    """Sizes that touch has of a quantity: the largest magnitude of a column usually lies between."""

    smallest: float
    largest: float
    why: str


_DEEP = ("depth", "indent", "shear", "approach")
_TOUCH_DEEP = UsualSize(2e-5, 0.05, "50 mm, further than a skin yields")
USUAL: dict[str, UsualSize] = {
    "m": UsualSize(2e-5, 2.0, "2 m, the reach of an arm"),
    "N": UsualSize(2e-3, 500.0, "500 N, more than a soft skin bears"),
    "Nm": UsualSize(1e-5, 20.0, "20 Nm, more than a touch makes"),
    "rad": UsualSize(math.radians(0.2), math.radians(370.0), "a full turn"),
    "kg": UsualSize(1e-5, 50.0, "50 kg, more than a soft skin bears"),
    "m2": UsualSize(1e-9, 0.1, "a tenth of a square metre"),
    "m2_per_N": UsualSize(1e-10, 1e-2, "a hundredth of a square metre per newton"),
    "Pa": UsualSize(1.0, 1e12, "that of diamond"),
    "N_per_m": UsualSize(1e-2, 1e8, "that of a machine's frame"),
    "ratio": UsualSize(0.0, math.inf, ""),
    "px": UsualSize(0.0, 1e5, "the size of any picture"),
    "s": UsualSize(0.0, math.inf, ""),
}
_HALF_TURNS = (math.pi / 2, math.pi, 2 * math.pi)


def unit_doubts(table: pd.DataFrame) -> tuple[str, ...]:
    """Sentences on columns whose numbers do not look like the unit in their name."""
    doubts = []
    for name, kind in label_kinds(table).items():
        if not has_unit(name):
            continue
        if kind == "number":
            doubts += [text for text in [_doubt(name, table[name].to_numpy(np.float64))] if text]
        elif kind == "text":
            odd = [i for i, cell in enumerate(table[name]) if not _is_number(str(cell))]
            cell = str(table[name].iloc[(odd or [0])[0]])[:40]
            remove = f"; fill in or remove {rows_text(odd)}" if 0 < len(odd) < len(table) else ""
            doubts.append(
                f"column {name} names a unit and holds text, e.g. {cell!r} in {rows_text((odd or [0])[:1])}: "
                f"it cannot be a target{remove}"
            )
    return tuple(doubts)


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _doubt(name: str, values: np.ndarray) -> str:
    quantity, named = split_column(name)
    size = float(np.abs(values).max())
    usual = _TOUCH_DEEP if named.si == "m" and quantity.lower().startswith(_DEEP) else USUAL[named.si]
    if size == 0 or not np.isfinite(size):
        return ""
    if text := _missing(name, values, named.to_si(size) > usual.largest):
        return text
    span = f"column {name} runs from {values.min():.4g} to {values.max():.4g} {named.symbol}"
    if named.to_si(size) > usual.largest:
        return f"{span}, beyond {usual.why}{_instead(name, quantity, named, size, usual)}"
    if named.symbol == "deg" and _ends_as_radians(size, len(values)):
        return f"{span}, which looks like radians; if so, say --rename {name}={quantity}_rad"
    if named.to_si(size) < usual.smallest:
        return f"{span}, less than touch usually has{_instead(name, quantity, named, size, usual)}"
    return ""


MISSING = frozenset(sign * (10**digits - 1) for sign in (-1, 1) for digits in range(2, 7))
"""Numbers such as -999 that stand, by custom, where nothing was measured."""
MAX_MISSING = 0.1
"""Share of rows that may be such; more, and the numbers may be meant."""
FAR = 10
"""How far from the middle three fifths of the rows, over their span."""


def _missing(name: str, values: np.ndarray, unusual: bool) -> str:
    """A sentence where a few rows lie far outside the rest, as codes of missing values do; else nothing."""
    low, high = np.quantile(values, [0.2, 0.8])
    rows = np.flatnonzero((values < low - FAR * (high - low)) | (values > high + FAR * (high - low)))
    codes = MISSING.issuperset(values[rows].tolist())
    if not (high > low and 0 < len(rows) <= MAX_MISSING * len(values) and (unusual or codes)):
        return ""
    kept = np.delete(values, rows)
    held = ", ".join(f"{value:g}" for value in np.unique(values[rows])[:3])
    return (
        f"column {name} runs from {kept.min():.4g} to {kept.max():.4g} {split_column(name)[1].symbol}, and "
        f"{len(rows)} {'row holds' if len(rows) == 1 else 'rows hold'} {held}, as where nothing was measured "
        f"({rows_text(rows)}); remove {'it' if len(rows) == 1 else 'them'}"
    )


def _ends_as_radians(size: float, rows: int) -> bool:
    """True where the largest angle lies just below a quarter, a half or a whole turn in radians."""
    reach = min(5 / rows, 0.03)
    return any(turn * (1 - reach) <= size <= turn * 1.001 for turn in _HALF_TURNS)


def _instead(name: str, quantity: str, named: Unit, size: float, usual: UsualSize) -> str:
    """Units in which the numbers would be usual, nearest in size first."""
    fitting = [
        one
        for one in UNITS.values()
        if one.si == named.si and one != named and usual.smallest <= one.to_si(size) <= usual.largest
    ]
    if not fitting:
        return "; check the unit and the numbers"
    likely = min(fitting, key=lambda one: abs(math.log(one.factor / named.factor)))
    return f"; it may be in {likely.symbol}: if so, say --rename {name}={quantity}_{likely.symbol}"


def mending_options(bare: Sequence[str]) -> list[str]:
    """Options of the import that give columns without a unit one, guessed from the name where that tells."""
    return [f"{name}={guessed_unit(name) or 'UNIT'}" for name in bare]
