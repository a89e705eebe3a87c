"""Probes without an axis that have a finite-strain table for a palm's membrane."""

from __future__ import annotations

from palpate.core import Probe, RangeError
from palpate.mechanics.probe_table import ProbeTable, probe_table_for, probe_tables
from palpate.sensors.palm.palm_spec import PalmSpec


def has_probe_table(spec: PalmSpec, probe: Probe) -> bool:
    """Tell whether there is a table for the spec's membrane under a probe without an axis."""
    return _probe_table(spec, probe) is not None


def _probe_table(spec: PalmSpec, probe: Probe) -> ProbeTable | None:
    return probe_table_for(probe, spec.thickness_m, spec.radius_m, spec.friction, spec.poisson_ratio)


def probe_table_of(spec: PalmSpec, probe: Probe) -> ProbeTable:
    """The table of a probe without an axis.

    Raises:
        RangeError: there is none for this membrane.
    """
    if (table := _probe_table(spec, probe)) is None:
        raise RangeError(
            f"no table for a {probe.shape} on a membrane {spec.thickness_m * 1e3:g} mm thick; there are "
            f"those of {probes_with_table(spec)}, upright"
        )
    return table


def probes_with_table(spec: PalmSpec) -> str:
    """Words of the probes without an axis that have tables for the spec's membrane."""
    mm = 1e3 * spec.thickness_m
    sizes = (
        (t.shape, *(f"{round(size * mm, 6):g}" for size in (2 * t.radius, t.length) if size))
        for t in probe_tables()
    )
    return ", ".join(":".join(words) for words in sizes)
