"""Sources of frames as they come: cameras, files that are played or still written, pipes, virtual sensors.

A file waits for whoever reads it, and so loses nothing; a camera does not, and what is not taken in time is
gone. `open_live_source` finds out which it is from an address.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from palpate.core import (
    Closing,
    DeviceError,
    ForceSensor,
    Frame,
    FrameSource,
    ImageError,
    InputError,
)

VIRTUAL = "virtual:"
STDIN = "-"
PICAMERA2 = "picamera2"
LOOK_S = 0.002  # between two looks for a frame of a camera

FIRST_S = 60.0
BEHIND_S = 0.5  # by which a virtual frame that is drawn may lag behind its time


class NoFrameYetError(DeviceError):
    """No frame came within the time given, and the source has not ended."""


@runtime_checkable
class LiveSource(Protocol):
    """Source of frames that never keeps its caller waiting longer than asked."""

    @property
    def name(self) -> str:
        """Name of it: "virtual:palm", "camera 4B2D", a path."""

    @property
    def waits(self) -> bool:
        """Whether it loses nothing by waiting: a file does not, a camera does."""

    @property
    def force(self) -> ForceSensor | None:
        """Force sensor beside the camera; None where there is none."""

    def grab(self, timeout_s: float) -> Frame | None:
        """The next frame; None once it has ended."""

    def close(self) -> None:
        """Let go of it. Closing again does nothing."""


def is_simulated(source: LiveSource) -> bool:
    """Whether frames are those of a virtual sensor, or of a run that was recorded on one."""
    manifest = getattr(source, "manifest", None)
    return source.name.startswith(VIRTUAL) or (manifest is not None and manifest.is_simulated)


class CameraFrames(Closing):
    """Every frame of a real or virtual camera, in order; frames not fetched are lost in the camera.

    Frames come from `drain`: `grab` waits for an exposure after the call and would skip every other one.
    """

    waits = False

    def __init__(
        self,
        camera: FrameSource,
        name: str,
        *,
        force: ForceSensor | None = None,
        behind_ns: int | None = None,
        let_go: Callable[[], None] | None = None,
    ) -> None:
        """Take over an open camera.

        Args:
            behind_ns: Delay from a frame's stamp to its arrival by the camera's settings; None for the time
                of fetching, as for virtual frames [ns].
            let_go: Closes camera and force sensor; by default one after the other.
        """
        self.name, self.force = name, force
        self._camera, self._behind_ns, self._let_go = camera, behind_ns, let_go
        self._waiting: deque[tuple[int, Frame]] = deque()
        self._number = self._lost_before = 0

    def grab(self, timeout_s: float) -> Frame:
        """The next frame."""
        end_s = time.monotonic() + timeout_s
        while not self._waiting:
            self._waiting.extend(self._arrived())
            if not self._waiting:
                if time.monotonic() >= end_s:
                    raise NoFrameYetError(
                        f"{self.name} gave no frame within {timeout_s:g} s; is it still plugged in?"
                    )
                time.sleep(LOOK_S)
        stamp_ns, frame = self._waiting.popleft()
        now_ns = time.monotonic_ns()
        arrived_ns = now_ns if self._behind_ns is None else min(stamp_ns + self._behind_ns, now_ns)
        number, self._number = self._number, self._number + 1
        return frame.arrived(number, arrived_ns, self._newly_lost())

    def _arrived(self) -> list[tuple[int, Frame]]:
        return self._camera.drain()

    def close(self) -> None:
        """Let go of camera and force sensor."""
        if self._let_go is not None:
            self._let_go()
            return
        self._camera.close()
        if self.force is not None:
            self.force.close()

    def _newly_lost(self) -> int:
        """Frames that the camera's own counts say were lost since the last one; 0 where it counts none."""
        counts: Any = getattr(self._camera, "counts", None)
        lost = getattr(counts, "dropped", 0)
        newly, self._lost_before = max(lost - self._lost_before, 0), lost
        return newly


class HandFrames(CameraFrames):
    """Frames of a virtual sensor under a virtual hand, which releases it during a zero."""

    def __init__(self, hand: Any, name: str) -> None:
        super().__init__(hand.camera, name, force=hand.force, let_go=hand.close)
        self.hand = hand
        hand.draw_ahead()
        hand.camera.grab(FIRST_S)  # the first picture of all may take seconds to draw
        self._last_s = self._skipped_to_now().time_s

    def grab(self, timeout_s: float) -> Frame:
        """The next frame; where drawing has fallen behind, those in between are lost, as in a camera.

        The first is one from now on: none is lost before anybody asks for any.
        """
        late_s = self.hand.world.now_s - self._last_s
        if self._waiting or (self._number and late_s < max(BEHIND_S, 2 / self.hand.camera.rate_hz)):
            frame = super().grab(timeout_s)
            self._last_s = frame.time_s
            return frame
        self._waiting.clear()
        frame = self._skipped_to_now()
        between = round((frame.time_s - self._last_s) * self.hand.camera.rate_hz) - 1
        lost = max(between, 0) if self._number else 0
        number, self._number, self._last_s = self._number, self._number + 1, frame.time_s
        return frame.arrived(number, lost=lost)

    def _arrived(self) -> list[tuple[int, Frame]]:
        """One frame at a time, so that none waits until those after it are drawn."""
        found: list[tuple[int, Frame]] = self.hand.camera.drain(at_most=1)
        return found

    def _skipped_to_now(self) -> Frame:
        return self.hand.camera.grab(FIRST_S)[1]

    def let_rest(self, rest: bool) -> None:
        """Let the hand wait in the air, or press again."""
        (self.hand.rest if rest else self.hand.press)()

    @property
    def touched(self) -> bool:
        """Whether a press is under way, or ended so lately that a frame of it may be on its way."""
        world = self.hand.world
        return any(press.begins_s <= world.now_s < press.ends_s + BEHIND_S for press in world.presses)


class PacedFrames(Closing):
    """File played at its own rate, as a camera would give it; late frames are dropped."""

    waits = False
    force: ForceSensor | None = None

    def __init__(
        self, reopened: Callable[[], LiveSource], *, rate_hz: float = 0.0, repeat: bool = False
    ) -> None:
        """Play a file.

        Args:
            rate_hz: frames a second where their times tell none, as those of images in a folder [Hz].
        """
        self._reopened, self._repeat = reopened, repeat
        self._period_s = 1.0 / rate_hz if rate_hz > 0 else None
        self._source = reopened()
        self.name, self.manifest = self._source.name, getattr(self._source, "manifest", None)
        self._next: Frame | None = None
        self._number, self._due_s = 0, time.monotonic()
        self._at_s = self._step_s = 0.0  # of the last frame, and from it to the next
        self._shift_s = 0.0  # by which a round's times are later than the file's own

    def grab(self, timeout_s: float) -> Frame | None:
        """The next frame, when its time has come; None at the end."""
        end_s = time.monotonic() + timeout_s
        if self._next is None and not self._fetch(timeout_s):
            return None
        assert self._next is not None
        if self._due_s > end_s:
            time.sleep(max(end_s - time.monotonic(), 0.0))
            raise NoFrameYetError(f"{self.name}: the next frame is not due within {timeout_s:g} s")
        time.sleep(max(self._due_s - time.monotonic(), 0.0))
        frame, self._next = self._next, None
        return frame

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    def _fetch(self, timeout_s: float) -> bool:
        """Read the next frame and say when it is due; False at the end."""
        item, again = self._source.grab(timeout_s), False
        if item is None and self._repeat and self._number:
            self._source.close()
            self._source, again = self._reopened(), True
            item = self._source.grab(timeout_s)
        if item is None:
            return False
        if again:
            self._shift_s = self._at_s + (self._period_s or self._step_s) - item.time_s
        at_s = item.time_s + self._shift_s
        if self._number:
            self._step_s = self._period_s or max(at_s - self._at_s, 0.0)
            self._due_s += self._step_s
        else:
            self._due_s = time.monotonic()
        self._next = replace(item, time_s=at_s, arrived_ns=round(self._due_s * 1e9), index=self._number)
        self._number, self._at_s = self._number + 1, at_s
        return True


def open_live_source(
    address: str | int | Path,
    *,
    settings: Any = None,
    paced: bool = False,
    repeat: bool = False,
    rate_hz: float = 0.0,
    idle_s: float = 2.0,
    seed: int | None = None,
) -> LiveSource:
    """Open a source of frames.

    Args:
        address: Camera number, path (``/dev/video2``), or USB serial number; image, folder, run, or video
            (folder and run also while they grow); ``-`` for images on standard input; ``virtual:NAME`` or
            ``virtual:NAME/INDENTER``, such as ``virtual:tactip/S1=7.6``; ``picamera2``.
        settings: Settings of a camera, `palpate.rig.real.uvc_camera.UvcSettings`; 640 × 480 px at 30 Hz by
            default.
        paced: Play a file at its own rate and drop late frames.
        repeat: Restart a paced file at its end.
        rate_hz: Rate of a paced folder, whose images have no times [Hz].
        idle_s: Time without frames after which a growing folder or run has ended [s].
        seed: Seed of a virtual hand; None for a different one each time.
    """
    text = str(address)
    if not text.strip():
        raise InputError("the address of a camera is empty; `palpate cameras` lists what there is")
    if (paced or repeat) and _is_device(text):
        raise InputError(f"{text} is no file, and has a pace of its own; leave paced and repeat out")
    if repeat and not paced:
        raise InputError("repeat plays a file for ever, which has a meaning only when paced; give paced, too")
    if text.startswith(VIRTUAL):
        return _virtual(text, seed)
    if text == PICAMERA2:
        return _pi_camera(settings)
    if not _is_device(text) and Path(text).exists():
        return _file(Path(text), paced, repeat, rate_hz, idle_s)
    if text == STDIN:
        from palpate.sensing.streaming.replayed_frames import PipedFrames

        return PipedFrames()
    if not _is_device(text) and ("/" in text or Path(text).suffix):
        raise ImageError(
            f"{text} is not there; give a camera, an image, a folder, a run or a video", code="source-missing"
        )
    return _usb_camera(address if isinstance(address, int) else text, settings)


def _is_device(text: str) -> bool:
    return text.startswith((VIRTUAL, "/dev/")) or text in (STDIN, PICAMERA2) or text.isdecimal()


def _file(path: Path, paced: bool, repeat: bool, rate_hz: float, idle_s: float) -> LiveSource:
    from palpate.sensing.streaming.replayed_frames import open_file_frames

    if not paced:
        return open_file_frames(path, idle_s)
    return PacedFrames(lambda: open_file_frames(path, idle_s), rate_hz=rate_hz, repeat=repeat)


def _usb_camera(address: str | int, settings: Any) -> LiveSource:
    from palpate.rig.real.uvc_camera import UvcCamera, UvcSettings

    chosen = settings or UvcSettings()
    where = int(address) if isinstance(address, str) and address.isdecimal() and len(address) < 3 else address
    camera = UvcCamera(where, chosen)
    delay_s = 1 / chosen.rate_hz if chosen.delay_s is None else chosen.delay_s
    return CameraFrames(camera, f"camera {address}", behind_ns=round(delay_s * 1e9))


def _pi_camera(settings: Any) -> LiveSource:
    from palpate.rig.real.pi_camera import PiCamera

    return CameraFrames(PiCamera(settings), "camera picamera2", behind_ns=0)


def _virtual(address: str, seed: int | None) -> LiveSource:
    from palpate.rig.virtual.virtual_hand import FIRST_S as REST_S, VirtualHand, another_hand

    name, _, indenter = address.removeprefix(VIRTUAL).partition("/")
    seed = another_hand() if seed is None else seed
    frames = HandFrames(VirtualHand(name, seed=seed, indenter=indenter, pressing=False), address)
    frames.hand.press(REST_S)
    return frames
