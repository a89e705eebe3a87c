"""State of a first session and its file: choices, finished steps, and their results. The file is read only if
a session could have written each of its values.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from palpate.core import InputError, RecordingError, plain_name, storage_errors
from palpate.core.parsing import parser
from palpate.estimators.session_folder import SESSION_FILE

STEPS = ("camera", "settings", "untouched", "collect", "train", "live")
STATE, CALIBRATION = SESSION_FILE, "calibration"
PRESSES = 40


@dataclass
class StartState:
    """State of a session, as kept in its file.

    Attributes:
        camera: address; empty before one was chosen.
        scale: serial port, "typed", or "virtual".
        asked: number of presses to collect.
        unit: of the scale's lines that carry none.
        scale_lag_s: time constant of the scale's filter; None to fit it to presses [s].
        settings, collected, trained: results of these steps.
    """

    camera: str = ""
    scale: str = ""
    sensor: str = ""
    asked: int = PRESSES
    seed: int = 0
    unit: str = ""
    scale_lag_s: float | None = None
    done: list[str] = field(default_factory=list)
    settings: dict[str, Any] = field(default_factory=dict)
    collected: dict[str, Any] = field(default_factory=dict)
    trained: dict[str, Any] = field(default_factory=dict)


@parser("session state", InputError)
def read_state(folder: Path) -> StartState:
    """Read the state in a session's folder; that of a new session where there is none."""
    path = folder / STATE
    if not path.is_file():
        return StartState()
    try:
        return checked_state(StartState(**json.loads(path.read_bytes())))
    except (ValueError, TypeError, RecursionError, InputError) as e:
        raise RecordingError(
            f"{path} is no session's file ({e}); move it away, and the runs beside it stay",
            code="session-damaged",
        ) from e


def write_state(folder: Path, state: StartState) -> None:
    """Keep a session's state in its folder, which is made if needed."""
    path = folder / STATE
    with storage_errors(path):
        folder.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.partial")
        partial.write_text(json.dumps(asdict(state), indent=1, sort_keys=True) + "\n")
        partial.replace(path)


def checked_state(state: StartState) -> StartState:
    """Return a state as read, if each of its values is one that a session could have kept."""
    for one in fields(StartState):
        value, usual = getattr(state, one.name), getattr(StartState(), one.name)
        if one.name == "scale_lag_s":
            if not (value is None or (type(value) in (int, float) and 0 <= value < math.inf)):
                raise ValueError(f"{one.name} is {value!r}")
            continue
        if type(value) is not type(usual):
            raise ValueError(f"{one.name} is {value!r}")
    if not set(state.done) <= set(STEPS) or state.asked < 1 or state.seed < 0:
        raise ValueError(f"done {state.done}, asked {state.asked}, seed {state.seed}")
    found = [state.trained.get(name, "") for name in ("folder", "sentence")]
    if not all(isinstance(one, str) for one in found):
        raise ValueError(f"trained is {state.trained}")
    plain_name(found[0] or CALIBRATION, "a calibration")
    _check_found(state.settings, state.collected)
    if not isinstance(state.trained.get("curve") or {}, dict):
        raise TypeError(f"curve is {state.trained['curve']!r}")
    return state


def _check_found(settings: dict[str, Any], collected: dict[str, Any]) -> None:
    """Refuse what the steps cannot have found, as a file that was edited by hand may say."""
    presses, size = collected.get("presses", 0), settings.get("size_px", [0, 0])
    if type(presses) is not int or presses < 0 or not isinstance(collected.get("map", {}), dict):
        raise ValueError(f"collected is {collected}")
    told = isinstance(size, list) and [type(one) for one in size] == [int, int]
    rate, health = settings.get("rate_hz", 0.0), settings.get("health", {})
    if not (told and type(rate) in (int, float) and isinstance(health, dict)):
        raise ValueError(f"settings is {settings}")
    if settings and not {"size_px", "rate_hz"} <= set(settings):
        raise ValueError(f"settings is {settings}")
