"""Non-axisymmetric probes that have a finite-strain table for a palm's membrane."""

from __future__ import annotations

from palpate.core import Probe, RangeError
from palpate.mechanics.probe_table import ProbeTable, probe_table_for, probe_tables
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.probe_shapes import parse_probe


def has_probe_table(spec: PalmSpec, probe: Probe) -> bool:
    """Return whether a table exists for the spec's membrane under a non-axisymmetric probe."""
    return _probe_table(spec, probe) is not None


def _probe_table(spec: PalmSpec, probe: Probe) -> ProbeTable | None:
    return probe_table_for(probe, spec.thickness_m, spec.radius_m, spec.friction, spec.poisson_ratio)


def probe_table_of(spec: PalmSpec, probe: Probe) -> ProbeTable:
    """Return the table of a non-axisymmetric probe."""
    if (table := _probe_table(spec, probe)) is None:
        raise RangeError(
            f"no table for a {probe.shape} on a membrane {spec.thickness_m * 1e3:g} mm thick; upright there "
            f"are those of: {probes_with_table(spec) or 'none'}"
        )
    return table


def probes_with_table(spec: PalmSpec) -> str:
    """Return the comma-separated probes that have tables for the spec's membrane."""
    mm, found = 1e3 * spec.thickness_m, []
    for t in probe_tables():
        sizes = [round(size * mm, 6) for size in (2 * t.radius, t.length) if size]
        words = ":".join([t.shape, *(f"{size:g}" for size in sizes)])
        if has_probe_table(spec, parse_probe(words)):
            found.append(words)
    return ", ".join(found)
