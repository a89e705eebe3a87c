"""First session as its folder keeps it: choices, finished steps, their results, and equivalent commands.

The file is read only if a session could have written each of its values.
"""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from palpate.core import InputError, PathText, RecordingError, plain_name, storage_errors
from palpate.core.parsing import parser
from palpate.estimators.session_folder import SESSION_FILE
from palpate.workflows.certification import FOLDS, TARGET

if TYPE_CHECKING:
    from palpate.calibration.calibration_plan import CalibrationPlan
    from palpate.recordings import Run

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


RUN, UNTOUCHED, MANIFEST = "presses", "untouched.png", "manifest.json"
MODEL, SPLIT = "kernel-ridge", "group:press"


class StoredSession:
    """Session of one sensor in a folder; a new session where there is none."""

    def __init__(self, folder: PathText) -> None:
        self.folder = Path(folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(
                f"{self.folder} is a file, and a session is a folder: give the name of one, such as "
                f"{self.folder.with_suffix('') if self.folder.suffix else 'my-sensor'}",
                code="not-a-folder",
            )
        self.state = read_state(self.folder)

    @property
    def step(self) -> str:
        """The first step that is not done; "live" where all before it are."""
        return next((one for one in STEPS if one not in self.state.done), STEPS[-1])

    @property
    def run(self) -> Path:
        return self.folder / RUN

    @property
    def calibration(self) -> Path:
        """Folder of the calibration that is or will be made of them."""
        return self.folder / self.state.trained.get("folder", CALIBRATION)

    @property
    def untouched(self) -> Path:
        return self.folder / UNTOUCHED

    @property
    def unopened(self) -> bool:
        """Whether its camera has given no frame yet, so that everything may still be chosen."""
        return not (self.state.settings or self.state.collected or self._frames())

    def has_nothing_left_by(self, camera: str, scale: str, asked: int | None) -> bool:
        """Whether another scale would have nothing to weigh, since as many presses as requested are there.

        Args:
            asked: presses that shall be there; None for as many as the session was begun for.
        """
        s = self.state
        other = camera == s.camera and scale != s.scale and "collect" in s.done
        return other and self.presses_held >= max(asked or s.asked, 1)

    @property
    def nothing_left_text(self) -> str:
        """What is said where nothing is left to collect."""
        return (
            f"{self.folder} holds {self.presses_held} presses of {self.state.asked}: nothing is left to "
            "collect, and what is there stays; --more N, or a larger number of presses on the page, collects "
            "others beside them"
        )

    @property
    def presses_held(self) -> int:
        """Presses that its run holds with their labels, by whichever scale."""
        from palpate.recordings import Run
        from palpate.sensing.collection.press_collector import presses_in

        return len(presses_in(Run.open(self.run).labelled())) if (self.run / MANIFEST).is_file() else 0

    @property
    def presses_gone(self) -> bool:
        """Whether presses were collected whose run is there no more: all are pressed anew then."""
        return bool(self.state.collected.get("presses")) and not (self.run / MANIFEST).is_file()

    @property
    def remaining(self) -> str:
        """Presses still to be collected beside those that are there, in words; empty where none are there."""
        if not (have := self.presses_held):
            return ""
        left = max(self.state.asked - have, 0)
        are = {0: "nothing is", 1: "1 is"}.get(left, f"{left} are")
        return f"{self.folder} holds {have} presses of {self.state.asked}; {are} still to be collected"

    def plan(self) -> CalibrationPlan:
        """Plan of the calibration: whole presses held out, colour learnt from where there is any."""
        from palpate.calibration.calibration_plan import CalibrationPlan

        channels: Literal[1, 3] = 3 if self._in_colour() else 1
        return CalibrationPlan(
            (TARGET,), model=MODEL, split=SPLIT, folds=self._folds(), seed=self.state.seed, channels=channels
        )

    @property
    def sentence(self) -> str:
        """The certificate in one sentence; empty before there is one."""
        return str(self.state.trained.get("sentence", ""))

    def commands(self) -> list[str]:
        """Commands that do what was done here, in order."""
        s, done = self.state, self.state.done
        found = []
        if "collect" in done or self.run.exists():
            args = ["palpate", "collect", "--camera", s.camera, "--scale", s.scale, "--presses", str(s.asked)]
            args += ["--sensor", s.sensor] if s.sensor else []
            args += ["--seed", str(s.seed)] if s.seed else []
            args += ["--unit", s.unit] if s.unit else []
            args += ["--scale-lag-s", f"{s.scale_lag_s:g}"] if s.scale_lag_s is not None else []
            found.append(shlex.join([*args, "--out", str(self.run)]))
        if "train" in done:
            args = ["palpate", "calibrate", str(self.run), "--targets", TARGET, "--model", MODEL]
            args += ["--split", SPLIT, "--folds", str(self._folds())]
            args += ["--seed", str(s.seed)] if s.seed else []
            args += ["--rgb"] if self._in_colour() else []
            found.append(shlex.join([*args, "--out", str(self.calibration)]))
            found.append(shlex.join(["palpate", "live", str(self.calibration), "--camera", s.camera]))
        return found

    @property
    def newest_text(self) -> str:
        """Which calibration the sentence is of, and the older ones beside it; empty before there is one."""
        if "train" not in self.state.done:
            return ""
        beside = {path.name for path in self.folder.glob(f"{CALIBRATION}*") if path.is_dir()}
        older = ", ".join(sorted(beside - {self.calibration.name}))
        stay = f", the newest; beside it, as before: {older}" if older else ""
        read = shlex.join(["palpate", "live", str(self.folder), "--camera", self.state.camera])
        return f"Calibration: {self.calibration}{stay}. `{read}` reads by the newest."

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain values, for the page and for ``--json``."""
        return asdict(self.state) | {
            "folder": str(self.folder),
            "step": self.step,
            "unopened": self.unopened,
            "run": str(self.run),
            "calibration": str(self.calibration),
            "newest": self.newest_text,
            "commands": self.commands(),
        }

    @property
    def gone_text(self) -> str:
        """What can be done about presses whose run was deleted or moved away."""
        s, words = self.state, ["palpate", "start", "--terminal", "--folder", str(self.folder)]
        words += ["--camera", s.camera, "--scale", s.scale, "--more", str(s.asked)]
        reads = f"; {self.calibration} still reads, by `palpate live`" if self.calibration.exists() else ""
        return (
            f"{self.run}, which held the presses of this session, is gone: put it back, press anew by "
            f"`{shlex.join(words)}`, or begin a session in another folder{reads}"
        )

    def _kept_presses(self) -> Run:
        from palpate.recordings import Run

        if not (self.run / MANIFEST).is_file():
            raise RecordingError(self.gone_text, code="run-missing")
        return Run.open(self.run)

    def _folds(self) -> int:
        table = self._kept_presses().labelled().labels
        return max(2, min(FOLDS, len(table[["session", "press"]].drop_duplicates())))

    def _frames(self) -> int:
        from palpate.recordings import Run

        return len(Run.open(self.run)) if (self.run / MANIFEST).is_file() else 0

    def _in_colour(self) -> bool:
        image = self._kept_presses().frame(0).image
        return image.ndim == 3 and bool((image != image[..., :1]).any())
