"""Kind of a calibration, by what its file or folder says of itself."""

from __future__ import annotations

import json
from pathlib import Path

from palpate.cli.command_kinds import Chosen, by_option, word_after
from palpate.core.errors import InputError

UNIT_FORMATS = {"palm": "palm-unit", "tip": "tip-unit"}
ARRAY_KINDS = {"compliance": "compliance", "shear force": "shear-force"}
HINTS = {"--force": "compliance", "--sensor": "shear-force", "--skin": "shear-force"}
"""Options that choose a kind where no calibration is given."""


def by_calibration(words: list[str]) -> Chosen:
    """Choose the kind of the calibration after ``--with``; without one, by `HINTS`.

    Raises:
        InputError: no calibration and no hint is given, or the calibration is of no known kind.
    """
    kind, words = by_option("--kind", "")(words)
    if kind or not words:
        return kind, words or ["--help"]
    if given := word_after("--with", words):
        return kind_of(Path(given)), words
    if "--help" in words:
        return "", words
    for option, hinted in HINTS.items():
        if word_after(option, words) is not None:
            return hinted, words
    raise InputError(
        "give the calibration: --with PATH. Without one, --force TABLE reads a press in relative numbers, "
        "and --sensor NAME reads a patterned skin",
        code="calibration-missing",
    )


def kind_of(path: Path) -> str:
    """Return the kind of a calibration.

    Raises:
        InputError: the file is of no known kind; whether a folder is sound is for its reader to say.
        StorageError: it cannot be read.
    """
    if path.is_dir():
        return "tip-pose" if (path / "reader.json").is_file() else "image"
    if not path.exists():
        raise InputError(f"there is no calibration {path}", code="calibration-missing")
    kind = _array_kind(path) if path.suffix == ".npz" else _unit_kind(path)
    if not kind:
        raise InputError(
            f"{path} is no calibration: a folder, a unit's JSON, or an .npz made by `palpate calibrate`",
            code="calibration-unknown",
        )
    return kind


def _array_kind(path: Path) -> str:
    from palpate.calibration.flat_record import kind_in

    return ARRAY_KINDS.get(kind_in(path), "")


def _unit_kind(path: Path) -> str:
    """Kind by the format's name, ``palpate palm copy 3``."""
    from palpate.core.files import storage_errors

    try:
        with storage_errors(path):
            name = str(json.loads(path.read_bytes())["format"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return ""
    return next((kind for word, kind in UNIT_FORMATS.items() if name.startswith(f"palpate {word} copy")), "")
