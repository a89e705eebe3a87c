"""The manifest says what a run is of, and is written once."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.refusals import refused

from palpate.core import ExistsError, InputError, RecordingError
from palpate.recordings.manifest import MANIFEST, Manifest


def test_a_manifest_reads_back_as_written(tmp_path: Path) -> None:
    manifest = Manifest.new(sensor="tactip-3", rig="arm", licence="CC0-1.0", origin="here", seed=7)
    manifest.write(tmp_path)
    assert Manifest.read(tmp_path) == manifest


def test_units_come_from_the_names_of_number_columns_only() -> None:
    manifest = Manifest.new(
        sensor="s", labels={"depth_mm": "number", "object": "text", "note_mm": "text", "press": "number"}
    )
    assert manifest.units == {"depth_mm": "mm"}


def test_a_manifest_is_never_overwritten(tmp_path: Path) -> None:
    Manifest.new(sensor="a").write(tmp_path)
    before = (tmp_path / MANIFEST).read_bytes()
    with pytest.raises(ExistsError):
        Manifest.new(sensor="b").write(tmp_path)
    assert (tmp_path / MANIFEST).read_bytes() == before


def test_a_folder_without_a_manifest_is_no_run(tmp_path: Path) -> None:
    with refused("not-a-run", RecordingError, match=r"manifest\.json"):
        Manifest.read(tmp_path)


def test_a_run_names_its_targets_and_they_carry_units() -> None:
    labels = {"depth_mm": "number", "press": "number", "object": "text"}
    assert Manifest.new(sensor="s", labels=labels, targets=("depth_mm",)).targets == ("depth_mm",)
    for bad in ("press", "object", "force_N"):
        with pytest.raises(InputError, match=bad):
            Manifest.new(sensor="s", labels=labels, targets=(bad,))


def test_a_run_names_the_regions_of_its_picture(tmp_path: Path) -> None:
    Manifest.new(sensor="s", regions={"fringes": (1, 2, 30, 40)}).write(tmp_path)
    assert Manifest.read(tmp_path).regions == {"fringes": (1, 2, 30, 40)}
    with refused("manifest-field", InputError):
        Manifest.new(sensor="s", regions={"rim": (0, 0, 0, 5)})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("created_utc", "yesterday"),
        ("created_utc", "2026-01-01T00:00:00"),
        ("created_utc", "1969-01-01T00:00:00+00:00"),
        ("units", {"depth_mm": "furlong"}),
        ("units", {"force_N": "N"}),
        ("labels", {"depth_mm": "picture"}),
        ("surprise", 1),
    ],
)
def test_a_damaged_manifest_is_named_and_refused(tmp_path: Path, field: str, value: object) -> None:
    good = json.loads(Manifest.new(sensor="s", labels={"depth_mm": "number"}).model_dump_json())
    (tmp_path / MANIFEST).write_text(json.dumps({**good, field: value}))
    with refused("manifest-damaged", RecordingError, match=r"manifest\.json"):
        Manifest.read(tmp_path)


def test_a_manifest_of_absurd_size_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / MANIFEST).open("wb") as file:
        file.truncate(1 << 40)  # a hole: takes no room, and would take all memory
    with pytest.raises(RecordingError, match="larger than"):
        Manifest.read(tmp_path)
