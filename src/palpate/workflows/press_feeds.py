"""Feeds of presses: a camera's frames beside a scale's samples, of real devices or of a virtual sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from palpate.core import (
    Clock,
    Closing,
    DeviceError,
    ForceSensor,
    Frame,
    InputError,
    ManualClock,
    MonotonicClock,
    RangeError,
)
from palpate.core.provenance import Provenance
from palpate.core.sensor import dark_field_of
from palpate.rig.real.scale import NEWTONS
from palpate.sensing.collection import PressCollector, Weighing
from palpate.sensing.collection.press_coverage import Box
from palpate.sensing.live_sources import NoFrameYetError, open_live_source

VIRTUAL = "virtual"
TYPED = "typed"
TRUTH_LABELS = ("true_depth_mm", "true_force_N", "true_x_mm", "true_y_mm")
FAST_HZ = 12.0  # frames a second of a virtual sensor that does not wait for the clock
TRANSPORT_S = 0.008  # of a virtual camera
WAIT_S = 2.0  # for a frame
LAID_S = (2.0, 2.5)  # that a virtual hand leaves a weight where it is [s]


@runtime_checkable
class PressFeed(Protocol):
    """Frames and forces of a sensor that a person presses."""

    sensor: str
    clock: Clock
    force: ForceSensor | None
    weighing: Weighing | None
    region: Box | None
    regions: dict[str, Box]
    force_range_n: tuple[float, float] | None
    frame_late_s: float
    truth: Callable[[int], dict[str, float]] | None
    truths: tuple[str, ...]
    origin: str
    provenance: Provenance

    def grab(self) -> Frame:
        """Return the next frame."""

    def press(self, go_on: bool) -> None:
        """Let a virtual hand press, or rest; a person is asked instead."""

    def close(self) -> None:
        """Let go of the devices."""


def collector_of(
    feed: PressFeed, run: Path, asked: int, sensor: str = "", session: str = ""
) -> PressCollector:  # fmt: skip
    """Return a collector of presses on a feed; a run that is there goes on."""
    return PressCollector(
        run, sensor or feed.sensor, feed.weighing, asked=asked, session=session, region=feed.region,
        force_range_n=feed.force_range_n and (0.0, feed.force_range_n[1]), frame_late_s=feed.frame_late_s,
        truth=feed.truth, truths=feed.truths, origin=feed.origin, provenance=feed.provenance,
        regions=feed.regions, dark_field=getattr(feed, "dark_field", None), clock=feed.clock,
    )  # fmt: skip


class VirtualFeed(Closing):
    """Virtual hand on a virtual sensor, on a scale.

    Args:
        seed: of the hand; None for a random one.
        real_time: a virtual second takes one.
        scale: serial port of a real scale instead; time is then real.
        unit, lag_s: of the scale; see `serial_scale`.
    """

    truths: tuple[str, ...] = TRUTH_LABELS
    origin = "pressed by palpate's virtual hand"
    provenance = Provenance.SIMULATED
    frame_late_s = TRANSPORT_S

    def __init__(
        self,
        name: str,
        *,
        seed: int | None = 0,
        real_time: bool = False,
        scale: str = VIRTUAL,
        unit: str = "",
        lag_s: float | None = None,
    ) -> None:
        from palpate.rig.virtual.virtual_hand import VirtualHand, another_hand

        self._fast = not real_time and scale in (VIRTUAL, TYPED)
        self.clock: Clock = ManualClock() if self._fast else MonotonicClock()
        seed = another_hand() if seed is None else seed
        self.hand = VirtualHand(name, seed=seed, clock=self.clock, pressing=False)
        self.sensor = self.hand.design.name
        self.force: ForceSensor | None = None
        self.weighing: Weighing | None = None
        if scale == VIRTUAL:
            self.force, self.weighing = self.hand.force, Weighing.by(self.hand.force, "the virtual scale")
        elif scale != TYPED:
            self.force, self.weighing = serial_scale(scale, self.clock, unit, lag_s)
        self.dark_field = dark_field_of(self.hand.design)
        self.regions: dict[str, Box] = dict(self.hand.design.regions())
        self.region: Box | None = self.regions[self.hand.design.axes.region]
        self.force_range_n: tuple[float, float] | None = self.hand.force_range_n
        self.truth: Callable[[int], dict[str, float]] | None = self.hand.truth

    def grab(self) -> Frame:
        """The next frame; in faster time not every one is drawn."""
        if self._fast:
            self.clock.sleep(max(1 / FAST_HZ - 1.5 / self.hand.camera.rate_hz, 0.0))
        at_ns, frame = self.hand.camera.grab()
        return replace(frame, arrived_ns=at_ns)

    def lay(self, force_n: float) -> None:
        """Let the hand place one weight, hold it still, and take it off [N]."""
        most = float(self.hand.world.known_n)
        if not 0 < force_n <= most:
            raise RangeError(
                f"a weight of {force_n:.3g} N on the virtual {self.sensor}, whose skin is known to "
                f"{most:.3g} N; type one from 1 to {most / NEWTONS['g']:.0f} g"
            )
        world = self.hand.world
        world.rest()
        world.habits = replace(world.habits, weights_n=(force_n,), hold_s=LAID_S)
        world.press()

    def lifted(self) -> None:
        """Let the hand take off what it has laid on, and wait in the air."""
        self.hand.rest()

    def press(self, go_on: bool) -> None:
        """Let the hand press, or rest; where weights are typed it rests until one is."""
        if self.weighing is None:
            go_on = False
        (self.hand.press if go_on else self.hand.rest)()

    def close(self) -> None:
        self.hand.close()
        if self.force is not None:
            self.force.close()


class CameraFeed(Closing):
    """Camera with a scale on a serial port, or with typed weights.

    Args:
        camera: address, see `palpate.sensing.live_sources.open_live_source`.
        scale: serial port of a scale, or "typed".
        unit, lag_s: of the scale; see `serial_scale`.
    """

    truth: Callable[[int], dict[str, float]] | None = None
    truths: tuple[str, ...] = ()
    origin = "pressed by hand"
    provenance = Provenance.MEASURED
    frame_late_s = 0.0
    region: Box | None = None
    force_range_n: tuple[float, float] | None = None

    def __init__(self, camera: str, scale: str, unit: str = "", lag_s: float | None = None) -> None:
        self.clock: Clock = MonotonicClock()
        self.sensor = camera
        self.regions: dict[str, Box] = {}
        self.force: ForceSensor | None = None
        self.weighing: Weighing | None = None
        if scale != TYPED:
            self.force, self.weighing = serial_scale(scale, self.clock, unit, lag_s)
        try:
            self._source = open_live_source(camera)
        except BaseException:
            self.close()
            raise

    def grab(self) -> Frame:
        try:
            got = self._source.grab(WAIT_S)
        except NoFrameYetError as e:
            raise DeviceError(
                f"{self.sensor} gave no frame for {WAIT_S:g} s; look whether it is plugged in, and whether "
                "another program reads it"
            ) from e
        if got is None:
            raise DeviceError(f"{self.sensor} has ended; presses are collected from a camera")
        return got

    def press(self, go_on: bool) -> None:
        """Do nothing: a person presses."""

    def close(self) -> None:
        if self.force is not None:
            self.force.close()
        source = getattr(self, "_source", None)
        if source is not None:
            source.close()


def serial_scale(
    port: str, clock: Clock, unit: str = "", lag_s: float | None = None
) -> tuple[ForceSensor, Weighing]:
    """Open a scale on a serial port: by default as a kitchen scale, 10 lines per second and 0.4 s late.

    Args:
        port: path, or USB serial number of its adapter.
        unit: of lines that carry none, such as "g"; "" refuses them. A unit in a line takes precedence.
        lag_s: time constant of its filter; None to fit it to presses [s].
    """
    from palpate.rig.real.scale import ScaleSpec, SerialScale

    opened = SerialScale.open(ScaleSpec(port, unit=unit), clock)
    return opened, Weighing.by(opened, f"the scale at {port}", lag_s)


def open_feed(
    camera: str,
    scale: str,
    *,
    seed: int | None = 0,
    real_time: bool = False,
    unit: str = "",
    lag_s: float | None = None,
) -> PressFeed:
    """Open a camera and the source of its labels.

    Args:
        camera: address, such as 0, a USB serial number, or ``virtual:palm``.
        scale: serial port, ``typed`` for known weights, ``virtual`` beneath a virtual sensor.
        seed: of a virtual hand; None for a random one.
        real_time: a virtual second takes one.
        unit, lag_s: of the scale; see `serial_scale`.

    Raises:
        InputError, DeviceError: a real camera on a virtual scale; a device is not there.
    """
    kind, _, name = camera.partition(":")
    if kind != VIRTUAL and scale == VIRTUAL:
        raise InputError(
            f"camera {camera} with scale {scale}: only a virtual sensor stands on a virtual scale; give the "
            "serial port of a scale, such as /dev/ttyUSB0, or 'typed' for known weights"
        )
    if kind == VIRTUAL:
        return VirtualFeed(
            name or "palm", seed=seed, real_time=real_time, scale=scale, unit=unit, lag_s=lag_s
        )
    return CameraFeed(camera, scale, unit, lag_s)
