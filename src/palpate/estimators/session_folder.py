"""Folder of a first session where a calibration is asked for: the newest that was made there is meant."""

from __future__ import annotations

import json
from pathlib import Path

from palpate.core import InputError, PathText, plain_name
from palpate.core.parsing import parser

SESSION_FILE = "start.json"
"""File in which a session keeps its state, with the name of its newest calibration's folder."""


@parser("session folder", InputError)
def calibration_in(folder: PathText) -> Path:
    """The calibration that a folder means: of a session's folder its newest, of any other itself.

    A session makes a calibration beside the former ones whenever presses were added, so that `calibration`
    alone may be an older one. Whether there is a calibration is for whoever opens it to say.
    """
    folder = Path(folder)
    try:
        kept = json.loads((folder / SESSION_FILE).read_bytes())
        newest = folder / plain_name(kept["trained"]["folder"], "a calibration")
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, InputError):
        return folder
    return newest if newest.is_dir() else folder
