"""Session from a camera that was just plugged in to live newtons: steps that can be left and gone on with.

Camera, settings, untouched sensor, presses, training, live reading: each step leaves what it found in a file
of the session's folder, written whole or not at all, and its frames in an ordinary run. Whatever was done can
be done by commands, which the session lists.
"""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np

from palpate.core import (
    InputError,
    PathText,
    Progress,
    RecordingError,
    lock,
    new_file,
    plain_name,
    silent,
    storage_errors,
)
from palpate.estimators.session_folder import SESSION_FILE
from palpate.sensing.collection.press_collector import REST, PressCollector
from palpate.workflows.press_feeds import PressFeed, open_feed

if TYPE_CHECKING:
    import pandas as pd

    from palpate.calibration.calibration_plan import CalibrationPlan
    from palpate.estimators.model_card import Card
    from palpate.recordings import Run

STEPS = ("camera", "settings", "untouched", "collect", "train", "live")
STATE, RUN, CALIBRATION, UNTOUCHED = SESSION_FILE, "presses", "calibration", "untouched.png"
LOCK, MANIFEST = ".start.lock", "manifest.json"
PRESSES = 40
MIN_TO_LEARN = 10
"""Presses that a calibration takes at least: fewer promise no interval of 90 % for the next one."""
STILL_FRAMES = 16  # of the untouched sensor
MODEL, TARGET, SPLIT = "kernel-ridge", "force_N", "group:press"
FOLDS = 20
"""Parts of the presses at most, each held out in turn. Forty presses are few: models that have seen 32 of
them err half as much again as the one that has seen all, and intervals by their errors are too wide."""
RATE = 0.9  # of intervals
GIVE_UP_S = 60.0  # without a press of any kind

Watch = Callable[[dict[str, Any]], None]


@dataclass
class StartState:
    """State of a session, as kept in its file.

    Attributes:
        camera: address of it; empty before one was chosen.
        scale: serial port, "typed" or "virtual".
        sensor: name of the sensor, which its run has.
        asked: presses that shall be collected.
        seed: of a virtual hand, and of all that is random in training.
        unit: of the scale's lines that carry none.
        scale_lag_s: time constant of the scale's filter; None where presses shall tell it [s].
        done: steps that are done.
        settings, collected, trained: what these steps found.
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


class StartSession:
    r"""Session of one sensor, in a folder.

    Args:
        folder: of it; made where it is not there, gone on with where it is.

    Raises:
        RecordingError: its file is not a session's.
        InputError: a file has the folder's name.

    Example:
        session = StartSession("my-sensor")
        session.choose("virtual:palm", "virtual")
        with session.feed() as feed:
            session.check_settings(feed)
            session.take_untouched(feed)
            session.collect(feed)
        session.train()
        print(session.sentence, *session.commands(), sep="\n")
    """

    def __init__(self, folder: PathText) -> None:
        self.folder = Path(folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(
                f"{self.folder} is a file, and a session is a folder: give the name of one, such as "
                f"{self.folder.with_suffix('') if self.folder.suffix else 'my-sensor'}"
            )
        self.state = self._read()

    @property
    def step(self) -> str:
        """The first step that is not done; "live" where all before it are."""
        return next((one for one in STEPS if one not in self.state.done), STEPS[-1])

    @property
    def run(self) -> Path:
        """Run of the presses."""
        return self.folder / RUN

    @property
    def calibration(self) -> Path:
        """Folder of the calibration that is or will be made of them."""
        return self.folder / self.state.trained.get("folder", CALIBRATION)

    @property
    def untouched(self) -> Path:
        """Image of the untouched sensor."""
        return self.folder / UNTOUCHED

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other processes from going through the steps of this session meanwhile.

        Raises:
            RecordingError: another goes through them.
            StorageError: the folder cannot be written.
        """
        path = self.folder / LOCK
        with storage_errors(path):
            self.folder.mkdir(parents=True, exist_ok=True)
            path.touch()
        with lock(path):
            self.state = self._read()  # what another has done since it was read
            yield

    def choose(
        self,
        camera: str,
        scale: str,
        *,
        sensor: str = "",
        asked: int = PRESSES,
        seed: int = 0,
        unit: str | None = None,
        scale_lag_s: float | None = None,
    ) -> None:
        """Choose camera and scale. Others than before leave all later steps to be done anew, once `feed` has
        opened them; until then the session's file is as it was.

        Args:
            camera, scale: as `open_feed` takes them.
            sensor: what it is called; by default by its camera.
            asked: presses that shall be collected.
            seed: of a virtual hand, and of all that is random in training.
            unit: of the scale's lines that carry none, "" for none; None leaves that of the same scale.
            scale_lag_s: time constant of the scale's filter; None leaves that of the same scale [s].

        Raises:
            InputError: presses of another sensor were collected here, or weighed in another unit, or fewer
                presses than can be learnt from.
        """
        _refuse_few(asked)
        if camera != self.state.camera and (self.run / MANIFEST).is_file():
            raise InputError(
                f"{self.folder} holds presses of {self.state.camera}; begin a session of {camera} in another "
                "folder"
            )
        same = (camera, scale) == (self.state.camera, self.state.scale)
        before, kept = self.state.done, self.state.done if same else []
        if same:
            unit = self.state.unit if unit is None else unit
            scale_lag_s = self.state.scale_lag_s if scale_lag_s is None else scale_lag_s
            self._refuse_other_unit(unit)
        self.state = StartState(
            camera,
            scale,
            sensor,
            asked,
            seed,
            unit or "",
            scale_lag_s,
            [*kept],
            self.state.settings,
            self.state.collected,
            self.state.trained,
        )
        self._mark("camera")
        if set(before) <= set(self.state.done):
            self._write()

    @property
    def unopened(self) -> bool:
        """Whether its camera has given no frame yet, so that everything may still be chosen."""
        return not (self.state.settings or self.state.collected or self._frames())

    def has_nothing_left_by(self, camera: str, scale: str, asked: int | None) -> bool:
        """Whether another scale would have nothing to weigh, since as many presses as asked for are there.

        Args:
            camera, scale: as `choose_if_other` takes them.
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
            "collect, and what is there stays; ask for more presses, which are collected beside them"
        )

    def choose_if_other(
        self,
        camera: str,
        scale: str,
        *,
        asked: int | None = None,
        seed: int = 0,
        unit: str | None = None,
        scale_lag_s: float | None = None,
    ) -> None:
        """Choose as `choose` does, but keep the presses asked for where camera and scale are chosen already.

        Args:
            camera, scale, seed, unit, scale_lag_s: as `choose` takes them.
            asked: presses that shall be collected, with those there are; None leaves what the session was
                begun for, whichever scale weighs the others. Once the camera has given a frame, other presses
                by the same scale are asked for by `ask_more` or `ask_for` alone.

        Raises:
            InputError: as `choose`.
        """
        s = self.state
        if asked is None:
            asked = s.asked if camera == s.camera else PRESSES
        same = self.step != "camera" and (camera, scale) == (s.camera, s.scale)
        if same and not self.unopened:
            asked, seed = s.asked, s.seed
        if same and asked == s.asked and unit in (None, s.unit) and scale_lag_s in (None, s.scale_lag_s):
            return
        sensor = s.sensor if same else ""
        self.choose(camera, scale, sensor=sensor, asked=asked, seed=seed, unit=unit, scale_lag_s=scale_lag_s)

    def ask_more(self, more: int) -> None:
        """Ask for more presses beside those that are there, which stay; a calibration of all follows.

        The session's file is as it was until `feed` has opened camera and scale.

        Raises:
            InputError: fewer than one, or nothing was chosen yet.
        """
        self._needs("camera")
        if more < 1:
            raise InputError(f"{more} more presses; ask for 1 or more")
        have = self.presses_held
        self.state.asked = more if self.presses_gone else (have or self.state.asked) + more
        self.state.done = [one for one in self.state.done if one not in ("collect", "train")]

    def ask_for(self, asked: int) -> str:
        """Ask for so many presses in all, with those that are there; what is said where that changes nothing.

        The session's file is as it was until `feed` has opened camera and scale.

        Raises:
            InputError: fewer than can be learnt from, or nothing was chosen yet.
        """
        self._needs("camera")
        _refuse_few(asked)
        have = self.presses_held
        if asked == self.state.asked or self.presses_gone:
            return ""
        if asked <= have:
            return (
                f"{self.folder} holds {have} presses, and all are learnt from: {asked} asks for none beside "
                "them"
            )
        self.state.asked = asked
        self.state.done = [one for one in self.state.done if one not in ("collect", "train")]
        return ""

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
        return (
            f"{self.folder} holds {have} presses of {self.state.asked}; "
            f"{max(self.state.asked - have, 0)} are still to be collected"
        )

    def feed(self, *, real_time: bool = False) -> PressFeed:
        """Open the camera and the scale that were chosen, and keep that they were."""
        self._needs("camera")
        s = self.state
        opened = open_feed(
            s.camera,
            s.scale,
            seed=self._hand_seed(),
            real_time=real_time,
            unit=s.unit,
            lag_s=s.scale_lag_s,
        )
        self._write()
        return opened

    def check_settings(self, feed: PressFeed) -> dict[str, Any]:
        """Look at a still picture: focus, noise, flicker, exposure, and what to do about them."""
        from palpate.sensing.image_health import image_health

        self._needs("camera")
        frames = [feed.grab() for _ in range(STILL_FRAMES)]
        lasted_s = (frames[-1].arrived_ns - frames[0].arrived_ns) / 1e9
        rate_hz = (len(frames) - 1) / lasted_s if lasted_s > 0 else 1.0
        health = image_health([one.frame.image for one in frames], rate_hz, region=feed.region)
        height, width = frames[0].frame.image.shape[:2]
        found = {"rate_hz": rate_hz, "size_px": [width, height], "health": health.to_dict()}
        self.state.settings = json.loads(json.dumps(found))  # as its file gives it back
        self._done("settings")
        return self.state.settings

    def take_untouched(self, feed: PressFeed) -> Path:
        """Keep the mean of some frames of the untouched sensor."""
        self._needs("settings")
        feed.press(go_on=False)
        frames = np.stack([feed.grab().frame.image for _ in range(STILL_FRAMES)])
        mean = np.rint(frames.mean(axis=0)).astype(np.uint8)
        coded = cv2.imencode(".png", mean if mean.ndim == 2 else mean[..., ::-1])[1]
        self.untouched.unlink(missing_ok=True)
        with new_file(self.untouched) as path:
            path.write_bytes(coded.tobytes())
        self._done("untouched")
        return self.untouched

    def collector(self, feed: PressFeed) -> PressCollector:
        """The collector of this session's presses on a feed; a run that is there goes on."""
        self.folder.mkdir(parents=True, exist_ok=True)
        return PressCollector(
            self.run,
            self.state.sensor or feed.sensor,
            feed.weighing,
            asked=self.state.asked,
            region=feed.region,
            force_range_n=feed.force_range_n and (0.0, feed.force_range_n[1]),
            frame_late_s=feed.frame_late_s,
            truth=feed.truth,
            truths=feed.truths,
            origin=feed.origin,
            regions=feed.regions,
            dark_field=getattr(feed, "dark_field", None),
            clock=feed.clock,
        )

    def collect(
        self,
        feed: PressFeed,
        progress: Progress = silent,
        watch: Watch = lambda _: None,
        beside: Callable[[PressCollector], None] = lambda _: None,
    ) -> dict[str, Any]:
        """Collect presses until there are as many as were asked for.

        Args:
            feed: camera and scale.
            progress: called with how far it is.
            watch: called with the collector's status whenever a press counts, or is refused.
            beside: called with the collector after each frame, such as to state a weight that was typed.

        Raises:
            DeviceError: camera or scale is gone; what was collected stays, and the same call goes on.
            InputError: nobody presses.
        """
        self._needs("untouched")
        with self.collector(feed) as collector:
            feed.press(go_on=True)
            seen, last_ns = -1, feed.clock.now_ns()
            while len(collector.presses) < self.state.asked:
                frame = feed.grab()
                if feed.force is not None:
                    collector.on_force(feed.force.drain())
                collector.on_frame(frame)
                beside(collector)
                count = len(collector.presses) + collector.refusals
                if count != seen:
                    seen, last_ns = count, frame.arrived_ns
                    progress("presses", len(collector.presses), self.state.asked)
                    watch(collector.status)
                if frame.arrived_ns - last_ns > GIVE_UP_S * 1e9:
                    raise InputError(
                        f"no press came for {GIVE_UP_S:g} s; {collector.coverage.text}. "
                        "The same command goes on"
                    )
            feed.press(go_on=False)
            self.note_collected(collector)
        return self.state.collected

    def note_collected(self, collector: PressCollector) -> None:
        """Take what a collector holds, of this process or another, for the presses of this session."""
        status = collector.status
        self.state.collected = {
            k: status[k] for k in ("presses", "asked", "missing", "text", "refused", "map")
        }
        self._done("collect")

    def plan(self) -> CalibrationPlan:
        """Plan of the calibration: whole presses held out, colour learnt from where there is any."""
        from palpate.calibration.calibration_plan import CalibrationPlan

        channels: Literal[1, 3] = 3 if self._in_colour() else 1
        return CalibrationPlan(
            (TARGET,), model=MODEL, split=SPLIT, folds=self._folds(), seed=self.state.seed, channels=channels
        )

    def train(self, progress: Progress = silent, *, curve: bool = True) -> Card:
        """Calibrate on the presses, and certify.

        Args:
            progress: called with how far it is.
            curve: whether to say what ten more presses would bring.

        Raises:
            InputError: fewer presses than can be learnt from.
        """
        from palpate.calibration.certificate import read_predictions
        from palpate.sensing.collection.learning_curve import MIN_PRESSES, learning_curve
        from palpate.sensing.collection.press_collector import presses_in
        from palpate.workflows.certification import certify

        self._needs("untouched")
        whole = self._kept_presses()
        run = whole.labelled()
        count = len(presses_in(run)) if len(run) else 0
        if count < MIN_TO_LEARN:
            raise InputError(
                f"{self.run} holds {count} presses; collect {MIN_TO_LEARN} or more, best {PRESSES}"
            )
        out = self._next_calibration()
        card = certify(run, self.plan(), out, progress)
        told = (
            learning_curve(run, self.plan(), progress).to_dict() if curve and count >= MIN_PRESSES else None
        )
        self.state.trained = {
            "folder": out.name,
            "id": card.id,
            "presses": count,
            "sentence": honest_sentence(card, read_predictions(out, card), count),
            "left_out": left_out_text(len(whole) - len(run)),
            "curve": told,
        }
        self._done("train")
        return card

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
        stay = f", the newest; {older} beside it stays as it was" if older else ""
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
        """Run of the presses that were collected.

        Raises:
            RecordingError: it was deleted or moved away, with what can be done.
        """
        from palpate.recordings import Run

        if not (self.run / MANIFEST).is_file():
            raise RecordingError(self.gone_text)
        return Run.open(self.run)

    def _folds(self) -> int:
        table = self._kept_presses().labelled().labels
        return max(2, min(FOLDS, len(table[["session", "press"]].drop_duplicates())))

    def _refuse_other_unit(self, unit: str) -> None:
        """Refuse to call bare numbers by another unit than those that presses were weighed in."""
        if self.state.unit not in ("", unit) and self._frames():
            raise InputError(
                f"{self.folder} holds presses whose scale was read in {self.state.unit}; in "
                f"{unit or 'what it prints'}, begin a session in another folder"
            )

    def _frames(self) -> int:
        """Frames that its run holds."""
        from palpate.recordings import Run

        return len(Run.open(self.run)) if (self.run / MANIFEST).is_file() else 0

    def _hand_seed(self) -> int:
        """Seed of a virtual hand: another one where it goes on, so that it does not press the same again."""
        have = self._frames()
        return (
            self.state.seed
            if not have
            else int(np.random.default_rng([self.state.seed, have]).integers(2**31))
        )

    def _in_colour(self) -> bool:
        image = self._kept_presses().frame(0).image
        return image.ndim == 3 and bool((image != image[..., :1]).any())

    def _needs(self, step: str) -> None:
        if step not in self.state.done:
            raise InputError(f"the step {step!r} of {self.folder} is not done yet; it is at {self.step!r}")

    def _done(self, step: str) -> None:
        """Note that a step is done, and keep it."""
        self._mark(step)
        self._write()

    def _mark(self, step: str) -> None:
        """Note that a step is done, and that the later ones that follow from it are not."""
        before = STEPS[: STEPS.index(step)]
        if step == "collect":  # more presses: the calibration that is there is of fewer
            self.state.done = [one for one in self.state.done if one != "train"]
        self.state.done = [one for one in STEPS if one in self.state.done or one == step or one in before]

    def _next_calibration(self) -> Path:
        """A folder that is not there yet: a calibration is never overwritten."""
        k, out = 1, self.folder / CALIBRATION
        while out.exists():
            k += 1
            out = self.folder / f"{CALIBRATION}-{k}"
        return out

    def _read(self) -> StartState:
        path = self.folder / STATE
        if not path.is_file():
            return StartState()
        try:
            return checked_state(StartState(**json.loads(path.read_bytes())))
        except (ValueError, TypeError, RecursionError, InputError) as e:
            raise RecordingError(
                f"{path} is no session's file ({e}); move it away, and the runs beside it stay"
            ) from e

    def _write(self) -> None:
        path = self.folder / STATE
        with storage_errors(path):
            self.folder.mkdir(parents=True, exist_ok=True)
            partial = path.with_name(f".{path.name}.partial")
            partial.write_text(json.dumps(asdict(self.state), indent=1, sort_keys=True) + "\n")
            partial.replace(path)


def checked_state(state: StartState) -> StartState:
    """A state as it was read, if each of its values is one that a session could have kept.

    Raises:
        ValueError, InputError: one is none, such as a calibration that lies outside of the session's folder.
    """
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


def _refuse_few(asked: int) -> None:
    """Refuse to ask for fewer presses than can be learnt from."""
    if asked < MIN_TO_LEARN:
        raise InputError(f"{asked} presses; {MIN_TO_LEARN} or more make a calibration, {PRESSES} a good one")


def left_out_text(frames: int) -> str:
    """What is said of frames whose labels a kill has lost; empty where there are none."""
    if not frames:
        return ""
    lost = "1 frame has" if frames == 1 else f"{frames} frames have"
    return f"{lost} no label, as a writer that was killed leaves them, and nothing was learnt from that."


def honest_sentence(card: Card, predictions: pd.DataFrame, presses: int) -> str:
    """What a certificate of hand presses promises, and what it does not.

    Args:
        card: the certificate.
        predictions: its held-out ones.
        presses: that were learnt from.
    """
    score = card.targets[0].score
    if score.says_nothing or not beats_the_mean(predictions):
        return (
            f"Useless: on presses that it had not seen it errs by {score.mae:.3g} N on average, not surely "
            f"less than always saying the mean does ({score.mean_mae:.3g} N). Look whether each label "
            "belongs to its press, and whether the image changes where the sensor is pressed."
        )
    held, low, high = (100 * rate for rate in rate_beyond(predictions))
    sittings = predictions["session"].nunique() if "session" in predictions else 1
    when = "on one day" if sittings < 2 else f"in {sittings} sittings that were all learnt from"
    return (
        f"On presses that it had not seen it errs by {score.mae:.2g} N on average, and 90 % intervals by the "
        f"errors of other presses held {held:.0f} % of frames ({low:.0f} to {high:.0f} %, from {presses} "
        f"presses): by one hand, {when}, with one probe; what another day brings is not tested."
    )


def rate_beyond(predictions: pd.DataFrame) -> tuple[float, float, float]:
    """Share of frames that 90 % intervals hold which their own press had no part in, and its 95 % interval.

    The certificate's own intervals are made of all held-out errors, and so hold them at their rate by
    construction: of forty presses 94 % where of new ones they hold 90 %.
    """
    from palpate.calibration.coverage.conformal import fit_intervals
    from palpate.calibration.coverage.grouped_rates import grouped_coverage_interval

    predictions = predictions[predictions["press"] != REST]
    true, told = (predictions[[name]].to_numpy(float) for name in (TARGET, f"estimate:{TARGET}"))
    _, press = np.unique(predictions["press"].astype(str).to_numpy(), return_inverse=True)
    inside = np.zeros(len(true), bool)
    for k in range(min(FOLDS, int(press.max()) + 1)):
        held = press % FOLDS == k
        others = fit_intervals(told[~held], true[~held], press[~held], RATE)
        inside[held] = others.hold(told[held], true[held])[:, 0]
    return float(inside.mean()), *grouped_coverage_interval(inside, press)


def beats_the_mean(predictions: pd.DataFrame) -> bool:
    """Whether held-out estimates surely err less than the other presses' mean: by 95 %, over presses."""
    from palpate.calibration.coverage.grouped_rates import grouped_mean_interval

    predictions = predictions[predictions["press"] != REST]
    true, told = predictions[TARGET].to_numpy(float), predictions[f"estimate:{TARGET}"].to_numpy(float)
    press = predictions["press"].astype(str).to_numpy()
    of_press = predictions.groupby("press")[TARGET].mean()
    others = (of_press.sum() - of_press) / (len(of_press) - 1)
    mean = others.to_dict()
    by_mean = predictions["press"].map(mean).to_numpy(float)
    found = grouped_mean_interval(np.abs(by_mean - true) - np.abs(told - true), press)
    return found is not None and found[0] > 0
