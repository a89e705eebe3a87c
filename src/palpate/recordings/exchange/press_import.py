"""Press as a multi-page TIFF or a video, with a table of force, turned into a run.

Frames carry force, position and the contact's area at their own time as labels, as far as the table has them;
its samples go into the run's own streams at their own rate, force as z of the wrench and position as z of the
stage.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from palpate.core import NS_PER_S, ProgressCount, refuse_existing
from palpate.core.provenance import Provenance
from palpate.recordings.exchange.frame_sequences import FrameSequence, open_sequence
from palpate.recordings.exchange.image_import import ImportReport, whole_run
from palpate.recordings.exchange.press_table import PressTable, read_press_table
from palpate.recordings.manifest import Manifest
from palpate.recordings.run_writer import RunWriter


def import_press(
    frames: Path,
    run: Path,
    *,
    force: Path,
    force_column: str | None = None,
    position_column: str | None = None,
    rate_hz: float | None = None,
    sensor: str = "",
    licence: str = "",
    origin: str = "",
    provenance: Provenance | None = None,
    progress: ProgressCount | None = None,
) -> ImportReport:
    """Turn one press into a run, which appears whole or not at all.

    Args:
        run: the run to make; must not exist.
        force: the table; see `read_press_table` for it and its columns.
    """
    refuse_existing(run)
    with open_sequence(frames) as sequence:
        table = read_press_table(
            force, len(sequence), force_column=force_column, position_column=position_column, rate_hz=rate_hz
        )
        names = _label_names(table)
        manifest = Manifest.new(
            sensor=sensor,
            licence=licence,
            origin=origin,
            provenance=provenance or Provenance.MEASURED,
            labels=dict.fromkeys(names, "number"),
        )
        with whole_run(run, manifest) as writer:
            _samples(writer, table)
            _frames(writer, table, sequence, progress)
    units = {name: name.rpartition("_")[2] for name in names}
    return ImportReport(len(table.frame_sample), names, units, ())


def _label_names(table: PressTable) -> tuple[str, ...]:
    position = () if table.position_m is None else ("position_mm",)
    area = () if table.area_column is None else (table.area_column,)
    return ("force_N", *position, *area)


def _samples(writer: RunWriter, table: PressTable) -> None:
    for i, (seconds, newtons) in enumerate(zip(table.time_s, table.force_n, strict=True)):
        time_ns = round(seconds * NS_PER_S)
        writer.force((0.0, 0.0, float(newtons), 0.0, 0.0, 0.0), time_ns=time_ns)
        if table.position_m is not None:
            writer.stage((0.0, 0.0, float(table.position_m[i])), time_ns=time_ns)


def _frames(
    writer: RunWriter, table: PressTable, sequence: FrameSequence, progress: ProgressCount | None
) -> None:
    for k, (image, sample) in enumerate(zip(sequence, table.frame_sample, strict=True)):
        labels = {"force_N": float(table.force_n[sample])}
        if table.position_m is not None:
            labels["position_mm"] = 1e3 * float(table.position_m[sample])
        if table.area_m2 is not None and table.area_column and np.isfinite(table.area_m2[sample]):
            labels[table.area_column] = 1e6 * float(table.area_m2[sample])
        writer.frame(image, time_ns=round(table.time_s[sample] * NS_PER_S), labels=labels)
        if progress is not None:
            progress(k + 1, len(table.frame_sample))
