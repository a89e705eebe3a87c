"""Provenance is stated and never read from free text, except in runs from before it was stated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from palpate.core import InputError, ManualClock, RecordingError
from palpate.core.provenance import Provenance, joint_provenance, provenance_of
from palpate.recordings import Manifest, Run, RunWriter
from palpate.recordings.joined_runs import joined


def run_with(path: Path, **about: object) -> Path:
    manifest = Manifest.new(sensor="s", labels={"force_N": "number"}, **about)  # type: ignore[arg-type]
    with RunWriter.create(path, manifest, clock=ManualClock(), overflow="wait") as writer:
        for force_n in range(3):
            writer.frame(np.full((8, 8), 40 * force_n, np.uint8), labels={"force_N": float(force_n)})
    return path


@pytest.mark.parametrize("origin", ["shear was not measured", "rendered by our simulator"])
@pytest.mark.parametrize("provenance", list(Provenance))
def test_the_origin_s_text_does_not_change_the_provenance(
    tmp_path: Path, origin: str, provenance: Provenance
) -> None:
    about = Run.open(run_with(tmp_path / "run", origin=origin, provenance=provenance)).manifest
    assert about.provenance is provenance
    assert about.is_simulated == (provenance is Provenance.SIMULATED)


@pytest.mark.parametrize(
    ("origin", "provenance"),
    [
        ("shear was not measured", Provenance.MEASURED),
        ("pressed by a virtual hand; virtual, not measured", Provenance.SIMULATED),
        ("a bench; force virtual, not measured; camera virtual, not measured", Provenance.SIMULATED),
    ],
)
def test_a_run_from_before_provenance_was_stated_is_told_by_its_mark(
    origin: str, provenance: Provenance
) -> None:
    fields = json.loads(Manifest.new(sensor="s", origin=origin).model_dump_json())
    del fields["provenance"]
    assert Manifest.model_validate(fields).provenance is provenance


def test_an_unknown_provenance_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refusal:
        provenance_of("synthetic")
    assert all(one.value in str(refusal.value) for one in Provenance)
    path = run_with(tmp_path / "run") / "manifest.json"
    path.write_text(path.read_text().replace('"measured"', '"synthetic"'))
    with pytest.raises(RecordingError):
        Manifest.read(tmp_path / "run")


def test_a_joined_recording_is_simulated_where_a_part_is(tmp_path: Path) -> None:
    parts = [run_with(tmp_path / one, provenance=one) for one in (Provenance.MEASURED, Provenance.SIMULATED)]
    assert joined([Run.open(part) for part in parts]).manifest.provenance is Provenance.SIMULATED
    assert joint_provenance([Provenance.MEASURED, Provenance.DERIVED]) is Provenance.DERIVED
    assert joint_provenance([Provenance.MEASURED]) is Provenance.MEASURED
