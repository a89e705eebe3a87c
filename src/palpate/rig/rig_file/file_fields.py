"""Fields that the tables of a rig's file share: millimetres there, metres behind it."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from palpate.core import Position

MM = 1e-3
Three = tuple[float, float, float]


class Part(BaseModel):
    """A table of a rig's file: nothing in it changes, and no field is unknown."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def check_below(ceilings: dict[str, float], part: BaseModel) -> None:
    """Refuse a field above its ceiling, with both numbers; fields that were left out are not compared."""
    for name, ceiling in ceilings.items():
        value = getattr(part, name, None)
        if value is not None and value > ceiling:
            raise ValueError(
                f"{name} is {value:g}, and {ceiling:g} is the greatest allowed; give {ceiling:g} or less"
            )


def check_above(floors: dict[str, float], part: BaseModel) -> None:
    """Refuse a field below its floor, with both numbers; fields that were left out are not compared."""
    for name, floor in floors.items():
        value = getattr(part, name, None)
        if value is not None and value < floor:
            raise ValueError(
                f"{name} is {value:g}, and {floor:g} is the least allowed; give {floor:g} or more"
            )


def metres(mm: Three) -> Position:
    """Metres of three millimetres."""
    x, y, z = (MM * value for value in mm)
    return x, y, z
