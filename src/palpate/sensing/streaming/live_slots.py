"""Hand-overs between the threads of a live loop: a place for the newest item, and lines to subscribers.

Which sensor a source states that its frames are of, and whether a calibration is of another.
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from palpate.core import Frame, InputError, Readings, Wrench
from palpate.core.sensor import SENSORS
from palpate.sensing.live_sources import HandFrames, LiveSource
from palpate.sensors.owned import preset_names

Item = TypeVar("Item")


class NewestSlot(Generic[Item]):
    """One place, in which a newer item takes that of an older one, or waits until it is taken."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._item: Item | None = None
        self._ended = self._closed = False

    def put(self, item: Item, *, wait: bool) -> bool:
        """Lay an item down; True where one was replaced, which is lost.

        Args:
            wait: until the place is free, or nobody takes anything any more.
        """
        with self._changed:
            if wait:
                self._changed.wait_for(lambda: self._item is None or self._closed)
            replaced, self._item = self._item is not None, item
            self._changed.notify_all()
            return replaced and not self._closed

    def take(self, timeout_s: float) -> Item | None:
        """The item; None where none came in time, or the last was taken."""
        with self._changed:
            self._changed.wait_for(lambda: self._item is not None or self._ended or self._closed, timeout_s)
            item, self._item = self._item, None
            self._changed.notify_all()
            return item

    def end(self) -> None:
        """Nothing comes any more; what lies there can still be taken."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def close(self) -> None:
        """Nothing is taken any more, and nobody waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def over(self) -> bool:
        """Whether nothing lies there and nothing comes, or nobody takes."""
        with self._changed:
            return self._closed or (self._ended and self._item is None)


@runtime_checkable
class Subscriber(Protocol):
    """Whoever is told of frames, readings and forces, in their order."""

    def on_frame(self, frame: Frame, readings: Readings | None) -> None:
        """Take in a frame and its readings; None without a calibration."""

    def on_force(self, samples: Sequence[Wrench]) -> None:
        """Take in samples of the force sensor beside the camera."""


MAX_LINE = 32  # frames, and as many groups of force samples, that wait for a subscriber
BLOCKED_S = 3.0  # in one call, after which a subscriber is dropped


class SubscriberLine:
    """Queue to one subscriber, called from its own thread.

    A full queue makes a file wait and drops (and counts) frames of a camera. A subscriber that raises, or
    does not return for three seconds while its queue is full, is removed; `why` names it.
    """

    def __init__(
        self, subscriber: Subscriber, *, waits: Callable[[], bool], fault: Callable[[str], None]
    ) -> None:
        """Begin to call a subscriber.

        Args:
            waits: whether whoever brings something waits where the line is full.
        """
        self.subscriber = subscriber
        self.name = type(subscriber).__name__
        self.missed = 0
        self.why = ""
        self._waits, self._fault = waits, fault
        self._line: deque[tuple[str, tuple[Any, ...]]] = deque()
        self._changed = threading.Condition()
        self._busy_since_s: float | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._call_all, name=f"palpate-live-{self.name}", daemon=True)
        self._thread.start()

    def frame(self, frame: Frame, readings: Readings | None) -> None:
        """Bring a frame."""
        self._bring("on_frame", (frame, readings))

    def force(self, samples: Sequence[Wrench]) -> None:
        """Bring samples of force."""
        self._bring("on_force", (samples,))

    def close(self) -> None:
        """Let it have what waits, for as long as it takes calls."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        while self._thread.is_alive() and not self._is_blocked():
            self._thread.join(0.05)

    def _bring(self, method: str, arguments: tuple[Any, ...]) -> None:
        with self._changed:
            while len(self._line) >= MAX_LINE and not self.why:
                if self._is_blocked():
                    self._drop(f"did not come back from a call for {BLOCKED_S:g} s")
                elif not self._waits():
                    self.missed += 1
                    return
                else:
                    self._changed.wait(0.05)
            if not self.why:
                self._line.append((method, arguments))
                self._changed.notify_all()

    def _call_all(self) -> None:
        while (call := self._next()) is not None:
            method, arguments = call
            try:
                getattr(self.subscriber, method)(*arguments)
            except Exception as e:  # whatever it raises, the loop goes on
                with self._changed:
                    self._drop(f"raised {type(e).__name__}: {e}")
            finally:
                self._busy_since_s = None

    def _next(self) -> tuple[str, tuple[Any, ...]] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._line or self._ended or self.why)
            if self.why or not self._line:
                return None
            call = self._line.popleft()
            self._busy_since_s = time.monotonic()
            self._changed.notify_all()
            return call

    def _is_blocked(self) -> bool:
        since_s = self._busy_since_s
        return since_s is not None and time.monotonic() - since_s > BLOCKED_S

    def _drop(self, why: str) -> None:
        self.why = f"{self.name} {why}; it was dropped, and the rest goes on"
        self._line.clear()
        self._changed.notify_all()
        self._fault(self.why)


OWN = "own"  # a preset that is of no sensor in particular
_VIRTUAL = re.compile("^virtual[: ]")  # as addresses and recordings of them begin


def stated_sensor(source: LiveSource) -> str:
    """Name of the sensor whose frames a source gives: of a virtual one its design's, of a run its manifest's.

    A camera, a video and images state none: "".
    """
    if isinstance(source, HandFrames):
        return str(source.hand.design.name)
    manifest: Any = getattr(source, "manifest", None)
    return "" if manifest is None else str(manifest.sensor)


def sensor_family(name: str) -> str:
    """Kind of sensor that a name surely means, as "palm" for "palm-rig" and "virtual palm"; "" for any other.

    Example:
        >>> sensor_family("virtual tactip/S1=7.6"), sensor_family("digit"), sensor_family("my-sensor")
        ('tactip', 'digit', '')
    """
    bare = _VIRTUAL.sub("", name).partition("/")[0]
    family = bare.partition("-")[0]
    if family in SENSORS.names():
        return family
    return bare if bare in preset_names() and bare != OWN else ""


def refuse_other_sensor(calibrated: str, source: LiveSource) -> str:
    """Refuse a source that is surely of another kind of sensor than a calibration.

    Args:
        calibrated: name of the calibration's sensor; "" where it has none.

    Returns:
        What is to be minded where the names differ, but may mean one sensor; "" where there is nothing.
    """
    stated = stated_sensor(source)
    if not stated or not calibrated or stated == calibrated:
        return ""
    kinds = sensor_family(stated), sensor_family(calibrated)
    told = f"{source.name} gives frames of {stated} and the calibration is of {calibrated}"
    if all(kinds) and kinds[0] != kinds[1]:
        raise InputError(f"{told}: give a calibration of {stated}", code="sensor-differs")
    return "" if all(kinds) else f"{told}: what is read holds only where both are one sensor"
