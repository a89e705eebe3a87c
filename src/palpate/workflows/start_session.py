"""Session from a newly connected camera to live newtons: resumable steps.

Each step (camera, settings, no-contact frames, presses, training, live reading) keeps its result in the
session's file (`stored_session`) and its frames in a run; `StoredSession.commands` lists the commands.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from palpate.core import InputError, Progress, lock, new_file, silent, storage_errors
from palpate.sensing.collection.press_collector import PressCollector
from palpate.workflows.certification import honest_sentence, left_out_text
from palpate.workflows.press_feeds import PressFeed, collector_of, open_feed
from palpate.workflows.stored_session import (
    CALIBRATION,
    MANIFEST,
    PRESSES,
    STATE,
    STEPS,
    StartState,
    StoredSession,
    read_state,
    write_state,
)

if TYPE_CHECKING:
    from palpate.estimators.model_card import Card

LOCK = ".start.lock"
MIN_TO_LEARN = 10  # fewer presses promise no 90 % interval for the next one
STILL_FRAMES = 16  # of the untouched sensor
GIVE_UP_S = 60.0  # without a press of any kind

Watch = Callable[[dict[str, Any]], None]


class StartSession(StoredSession):
    r"""Session of one sensor, in a folder that is made or resumed.

    Raises:
        RecordingError, InputError: its file is not a session's; a file has the folder's name.

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

    @contextmanager
    def held(self, *, keep_choice: bool = True) -> Iterator[None]:
        """Lock the session against other processes; folders made for it are removed if nothing was kept.

        Args:
            keep_choice: keep the choice in a folder that is made here, even if its camera gives no frame.
        """
        path, refused = self.folder / LOCK, True
        with storage_errors(path):
            made = _folders_made(self.folder)
            path.touch()
        with lock(path):
            self.state = read_state(self.folder)  # what another has done since it was read
            try:
                yield
                refused = False
            finally:
                if self.folder in made:
                    forgets = refused and not keep_choice and self.unopened
                    self._remove_empty(made, {LOCK, STATE} if forgets else {LOCK})

    def _remove_empty(self, made: list[Path], names: set[str]) -> None:
        with suppress(OSError):  # as where an open file cannot be removed, or somebody removed it
            if {path.name for path in self.folder.iterdir()} <= names:
                for name in names:
                    (self.folder / name).unlink(missing_ok=True)
                for folder in reversed(made):
                    folder.rmdir()

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
        """Choose camera and scale. A change resets all later steps, once `feed` has opened them.

        Args:
            camera, scale: see `open_feed`.
            sensor: its name; by default by its camera.
            asked: number of presses to collect.
            seed: of a virtual hand, and of training.
            unit: of the scale's lines that carry none, "" for none; None keeps that of the same scale.
            scale_lag_s: time constant of the scale's filter; None keeps that of the same scale [s].

        Raises:
            InputError: presses of another sensor or unit were collected here, or `asked` is too small.
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
        """Choose as `choose` does, but keep the requested presses for the same camera and scale.

        Args:
            asked: number of presses, including those there are; None keeps it. After the camera's first
                frame, use `ask_more` or `ask_for` for the same scale.
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
        """Request more presses; the file changes once `feed` has opened."""
        self._needs("camera")
        if more < 1:
            raise InputError(f"{more} more presses; ask for 1 or more", code="press-count")
        have = self.presses_held
        self.state.asked = more if self.presses_gone else (have or self.state.asked) + more
        self.state.done = [one for one in self.state.done if one not in ("collect", "train")]

    def ask_for(self, asked: int) -> str:
        """Request so many presses in all, and return a note where that changes nothing."""
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

    def feed(self, *, real_time: bool = False) -> PressFeed:
        """Open the camera and the scale that were chosen, and keep that they were."""
        self._needs("camera")
        s = self.state
        opened = open_feed(
            s.camera, s.scale, seed=self._hand_seed(), real_time=real_time, unit=s.unit, lag_s=s.scale_lag_s
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
        health = image_health([one.image for one in frames], region=feed.region)
        height, width = frames[0].image.shape[:2]
        found = {"rate_hz": rate_hz, "size_px": [width, height], "health": health.to_dict()}
        self.state.settings = json.loads(json.dumps(found))  # as its file gives it back
        self._done("settings")
        return self.state.settings

    def take_untouched(self, feed: PressFeed) -> Path:
        """Keep the mean of some frames of the untouched sensor."""
        self._needs("settings")
        feed.press(go_on=False)
        frames = np.stack([feed.grab().image for _ in range(STILL_FRAMES)])
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
        return collector_of(feed, self.run, self.state.asked, self.state.sensor)

    def collect(
        self,
        feed: PressFeed,
        progress: Progress = silent,
        watch: Watch = lambda _: None,
        beside: Callable[[PressCollector], None] = lambda _: None,
    ) -> dict[str, Any]:
        """Collect presses until there are as many as requested.

        Args:
            watch: called with the collector's status whenever a press counts, or is rejected.
            beside: called with the collector after each frame, e.g. to state a typed weight.

        Raises:
            DeviceError: camera or scale is gone; what was collected stays, and the same call goes on.
            InputError: no presses come.
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

    def train(self, progress: Progress = silent, *, curve: bool = True) -> Card:
        """Calibrate on the presses, and certify.

        Args:
            curve: estimate the gain of ten more presses.
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

    def _refuse_other_unit(self, unit: str) -> None:
        if self.state.unit not in ("", unit) and self._frames():
            raise InputError(
                f"{self.folder} holds presses whose scale was read in {self.state.unit}; in "
                f"{unit or 'what it prints'}, begin a session in another folder",
                code="unit-differs",
            )

    def _hand_seed(self) -> int:
        """Seed of a virtual hand: another one where it goes on, so that it does not press the same again."""
        have = self._frames()
        return (
            self.state.seed
            if not have
            else int(np.random.default_rng([self.state.seed, have]).integers(2**31))
        )

    def _needs(self, step: str) -> None:
        if step not in self.state.done:
            raise InputError(f"the step {step!r} of {self.folder} is not done yet; it is at {self.step!r}")

    def _done(self, step: str) -> None:
        self._mark(step)
        self._write()

    def _mark(self, step: str) -> None:
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

    def _write(self) -> None:
        write_state(self.folder, self.state)


def _folders_made(folder: Path) -> list[Path]:
    """Make a folder and those it lies in; those that were not there, from the outermost."""
    made = []
    for one in reversed([folder, *folder.parents]):
        try:
            one.mkdir()
        except OSError:  # it is there, also where another made it just now
            if not one.is_dir():
                raise
        else:
            made.append(one)
    return made


def _refuse_few(asked: int) -> None:
    if asked < MIN_TO_LEARN:
        raise InputError(
            f"{asked} presses; {MIN_TO_LEARN} or more make a calibration, {PRESSES} a good one",
            code="too-few-presses",
        )
