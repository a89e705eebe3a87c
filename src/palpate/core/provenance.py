"""Provenance of data: measured by a sensor, simulated, or derived from other data."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

from palpate.core.errors import InputError

EARLIER_MARK = "virtual, not measured"
"""Part of the origin of each simulated run that palpate wrote before manifests stated a provenance."""


class Provenance(StrEnum):
    """Provenance of a run, a rig, or the data of a calibration."""

    MEASURED = "measured"
    SIMULATED = "simulated"  # all of it, or a part
    DERIVED = "derived"


def provenance_of(text: str) -> Provenance:
    """Return the provenance that a user names."""
    try:
        return Provenance(text)
    except ValueError:
        raise InputError(f"the provenance {text!r} is unknown; give one of {', '.join(Provenance)}") from None


def joint_provenance(parts: Iterable[Provenance]) -> Provenance:
    """Return the provenance of data that are joined: simulated, or derived, where any part is.

    Example:
        >>> joint_provenance([Provenance.MEASURED, Provenance.SIMULATED]).value
        'simulated'
    """
    found = set(parts)
    return next(
        (one for one in (Provenance.SIMULATED, Provenance.DERIVED) if one in found), Provenance.MEASURED
    )


def earlier_provenance(origin: str) -> Provenance:
    """Return the provenance of a run or card that states none, from the marks that palpate then wrote."""
    return Provenance.SIMULATED if EARLIER_MARK in origin else Provenance.MEASURED
