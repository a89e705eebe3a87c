"""Process of a first session: ``python -m palpate.studio.live.start_process FOLDER --camera C ...``.

It goes from the chosen camera through settings, untouched sensor and presses to a calibration, from wherever
the folder's session is. Each step, each press and now and then a picture are said as a line of JSON; weights
that are typed are read as lines of JSON from the standard input.
"""

from __future__ import annotations

import argparse
import base64
import json
import queue
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.core import PalpateError
from palpate.core.failure_log import contained
from palpate.rig.real.scale import NEWTONS
from palpate.studio.library.job_process import JobVoice
from palpate.studio.library.workspace import jpeg_bytes

if TYPE_CHECKING:
    from palpate.workflows.start_session import StartSession

PICTURE_S = 0.35  # between two pictures that are told
PICTURE_PX = 480
SILENT_S = 60.0  # without a press, after which the process ends; the session stays as it is
STOPPED = 3  # status of a process that was told to end
RESTS = ("settings", "untouched", "collect")


class WatchedFeed:
    """A feed of presses that tells of its pictures as they are taken; all else is the feed's own."""

    def __init__(self, feed: Any, voice: JobVoice) -> None:
        self._feed, self._voice, self._told_s = feed, voice, 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._feed, name)

    def grab(self) -> Any:
        """The next frame; its picture is told, if the last was told a while ago."""
        frame = self._feed.grab()
        if time.monotonic() - self._told_s > PICTURE_S:
            self._told_s = time.monotonic()
            jpeg = base64.b64encode(jpeg_bytes(frame.image, PICTURE_PX)).decode()
            height, width = frame.image.shape[:2]
            self._voice.say({"picture": jpeg, "size_px": [width, height]})
        return frame


def typed_weights() -> Iterator[queue.SimpleQueue[float]]:
    """Weights that are typed on the page, as they come [N]."""
    weights: queue.SimpleQueue[float] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            try:
                weights.put(float(json.loads(line)["force_N"]))
            except (ValueError, KeyError, TypeError):
                continue

    threading.Thread(target=read, name="palpate-typed-weights", daemon=True).start()
    yield weights


def collect_presses(session: Any, feed: Any, voice: JobVoice) -> None:
    """Collect until there are as many presses as were asked for; each that counts, or does not, is told."""
    weights = next(typed_weights())
    with session.collector(feed) as collector:
        feed.press(go_on=True)
        told, heard_s = None, time.monotonic()
        while len(collector.presses) < collector.asked:
            frame = feed.grab()
            if feed.force is not None:
                collector.on_force(feed.force.drain())
            collector.on_frame(frame)
            while not weights.empty():
                state_weight(collector, weights.get(), voice)
            status = collector.status
            news = (
                status["presses"],
                status["refused"],
                status["holding"],
                status["touched"],
                status["advice"],
            )
            if news != told:
                if told is None or news[:2] != told[:2]:
                    heard_s = time.monotonic()
                told = news
                voice.say({"collect": status})
                voice.progress("presses", status["presses"], status["asked"])
            if time.monotonic() - heard_s > SILENT_S:
                voice.say(
                    {"error": f"no press came for {SILENT_S:g} s; {status['text']}. Go on when you are ready"}
                )
                raise SystemExit(2)
        feed.press(go_on=False)
        session.note_collected(collector)


def state_weight(collector: Any, force_n: float, voice: JobVoice) -> None:
    """State a weight that was typed; what speaks against it is told."""
    try:
        collector.label(force_n)
    except PalpateError as e:
        voice.say({"said": str(e)})


def run_session(words: argparse.Namespace, voice: JobVoice) -> dict[str, Any]:
    """Go through all steps that are not done yet."""
    from palpate.workflows.start_session import StartSession

    session = StartSession(words.folder)
    with session.held():
        try:
            return _through_steps(session, words, voice)
        except PalpateError:
            with suppress(PalpateError):  # a choice that was refused is not shown as made
                voice.say({"session": StartSession(words.folder).to_dict()})
            raise


def _through_steps(session: StartSession, words: argparse.Namespace, voice: JobVoice) -> dict[str, Any]:
    _choose(session, words, voice)
    voice.say({"session": session.to_dict()})
    if session.step in RESTS:
        voice.progress("opening camera and scale", 0, 1)
        feed = WatchedFeed(session.feed(real_time=words.real_time), voice)
        try:
            voice.say({"at": "settings"})
            session.check_settings(feed)
            voice.say({"session": session.to_dict(), "at": "untouched"})
            session.take_untouched(feed)
            voice.say({"session": session.to_dict(), "at": "collect"})
            collect_presses(session, feed, voice)
            voice.say({"session": session.to_dict()})
        finally:
            feed.close()
    if session.step == "train":
        voice.say({"at": "train"})
        session.train(voice.progress)
    return {"session": session.to_dict()}


def _choose(session: StartSession, words: argparse.Namespace, voice: JobVoice) -> None:
    """Choose camera, scale and how many presses; what changes nothing is said."""
    if not words.more and session.has_nothing_left_by(words.camera, words.scale, words.presses):
        voice.say({"said": session.nothing_left_text})
        return
    unit = words.unit or None
    session.choose_if_other(words.camera, words.scale, asked=words.presses, seed=words.seed, unit=unit)
    if words.more:
        session.ask_more(words.more)
    elif said := session.ask_for(words.presses):
        voice.say({"said": said})


def main() -> int:
    """Do what can be done; 2 where something was refused, and said why."""
    parser = argparse.ArgumentParser(description="Go through the steps of a first session.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--camera", required=True)
    parser.add_argument("--scale", required=True)
    parser.add_argument("--presses", type=int, default=40)
    parser.add_argument("--more", type=int, default=0, help="presses beside those that are there")
    parser.add_argument("--unit", default="", choices=["", *NEWTONS], help="of the scale's bare numbers")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--real-time", action="store_true")
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: sys.exit(STOPPED))  # what is being recorded is closed whole
    voice = JobVoice()
    with contained("the first session", voice.report):
        try:
            found = run_session(parser.parse_args(), voice)
        except PalpateError as e:
            voice.say({"error": " ".join(str(e).split())})
            return 2
    voice.say({"done": found})
    return 0


if __name__ == "__main__":
    sys.exit(main())
