"""What a path that is given as a calibration stands for: the newest of a session, and its kind."""

from __future__ import annotations

import json
from pathlib import Path
from zipfile import BadZipFile, ZipFile

from palpate.core import InputError, PathText, plain_name, storage_errors
from palpate.core.parsing import parser

# file in which a session keeps its state, with the name of its newest calibration's folder
SESSION_FILE = "start.json"


@parser("session folder", InputError)
def calibration_in(folder: PathText) -> Path:
    """Return the newest calibration of a session's folder, or any other folder itself (unchecked)."""
    folder = Path(folder)
    try:
        kept = json.loads((folder / SESSION_FILE).read_bytes())
        newest = folder / plain_name(kept["trained"]["folder"], "a calibration")
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, InputError):
        return folder
    return newest if newest.is_dir() else folder


# beginning of the format in a unit's JSON file, and its kind
UNIT_FORMATS = {"palpate palm copy": "palm-unit", "palpate tip copy": "tip-unit"}
# an array that only the ``.npz`` files of one kind hold
ARRAYS = {"layout_px.npy": "compliance", "lens_json.npy": "shear-force"}


@parser("calibration kind", InputError)
def calibration_kind(path: Path) -> str:
    """Return the kind: image, palm-unit, tip-unit, tip-pose, shear-force, or compliance."""
    if path.is_dir():
        return "tip-pose" if (path / "reader.json").is_file() else "image"
    if not path.exists():
        raise InputError(f"there is no calibration {path}", code="calibration-missing")
    kind = _array_kind(path) if path.suffix == ".npz" else _unit_kind(path)
    if not kind:
        raise InputError(
            f"{path} is no calibration of `palpate calibrate`: a folder, JSON, or .npz",
            code="calibration-unknown",
        )
    return kind


def _array_kind(path: Path) -> str:
    with storage_errors(path), path.open("rb") as file:
        try:
            names = set(ZipFile(file).namelist())
        except BadZipFile:
            names = set()
    return next((kind for name, kind in ARRAYS.items() if name in names), "")


def _unit_kind(path: Path) -> str:
    with storage_errors(path):
        content = path.read_bytes()
    try:
        form = str(json.loads(content)["format"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return ""
    return next((kind for start, kind in UNIT_FORMATS.items() if form.startswith(start)), "")
