"""Checks of a camera against `core.Camera`: size, stamps, rate, exposure, refusals."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from palpate.core import NS_PER_S, Camera, Clock, DeviceError, Float, Frame, RangeError, ndarray
from palpate.devices.check.interface_check import (
    CheckResult,
    Part,
    at_most,
    camera_interface,
    check_closing,
    describe,
    gather,
    judge,
    refusal,
    seconds,
    verdict,
)

FROZEN = 5  # frames in a row that are the same to the last bit, as in the rig
LAG_S = 0.5  # from the end of an exposure until its frame is here
EARLY_S = 1e-3  # rounding
RATE_WITHIN = 0.05  # of what is stated
JITTER = 0.1  # of a period, standard deviation
MIN_FRAMES = 20
GRAB_PERIODS = 10.0  # to wait for one frame, and a second
MAX_PAUSE_PERIODS = 4.0  # between two grabs; random, so that only the true rate beats with all stamps
SIDE = 8.0  # rates are looked for from an eighth of what is stated to twice
FINE = 0.1  # of the width of a peak
AS_HIGH = 0.9  # as the highest peak, for a lower rate to be the true one


@dataclass(frozen=True, slots=True)
class GrabbedFrame:
    """One frame, when it was asked for, when it came and when its exposure ended [s]."""

    call_s: float
    arrival_s: float
    end_s: float
    frame: Frame


def check_camera(camera: object, *, clock: Clock, frames: int = 40, close: bool = True) -> list[CheckResult]:
    """Check a driver of a camera. It should see something that lives; noise is enough.

    Args:
        camera: the driver's, a `core.Camera`.
        clock: that it stamps on: `MonotonicClock` for a real one.
        frames: how many to grab, with pauses of up to four frames between.
        close: close it at the end, and check that.

    Raises:
        RangeError: fewer than 20 frames.

    Example:
        >>> from palpate.rig.virtual import virtual_rig
        >>> rig = virtual_rig()
        >>> all(one.ok for one in check_camera(rig.camera, clock=rig.clock))
        True
    """
    if frames < MIN_FRAMES:
        raise RangeError(
            f"{frames} frames say too little about a rate; grab {MIN_FRAMES} or more", code="too-few-frames"
        )
    findings = [*gather("protocol", camera_interface(camera))]
    if isinstance(camera, Camera) and all(one.ok for one in findings):
        findings += gather("grabbing", _grabbing(camera, clock, frames))
    if close and isinstance(camera, Camera):
        findings += gather("close", check_closing(camera, camera.grab, "grab()"))
    return findings


def _grabbing(camera: Camera, clock: Clock, count: int) -> Part:
    wait_s = 1.0 + GRAB_PERIODS / camera.rate_hz
    grabs: list[GrabbedFrame] = []
    rng = np.random.default_rng(0)
    for _ in range(count):
        call_s = seconds(clock)
        ended_ns, frame = camera.grab(wait_s)
        grabs.append(GrabbedFrame(call_s, seconds(clock), ended_ns / NS_PER_S, frame))
        clock.sleep(float(rng.uniform(0, MAX_PAUSE_PERIODS)) / camera.rate_hz)
    yield from _pictures(camera, grabs)
    yield from _times(grabs)
    yield from _rate(camera, np.array([one.end_s for one in grabs]))
    short_s = 1e-3 / camera.rate_hz
    error = refusal(lambda: camera.grab(short_s))
    yield verdict(
        "frame-timeout", isinstance(error, DeviceError),
        f"grab({short_s:.1g}), which no frame can keep, {describe(error)}; raise DeviceError",
    )  # fmt: skip


def _pictures(camera: Camera, grabs: list[GrabbedFrame]) -> Part:
    width, height = camera.size_px
    shapes = {one.frame.image.shape for one in grabs}
    yield verdict(
        "frame-size", len(shapes) == 1 and next(iter(shapes))[:2] == (height, width),
        f"{width} x {height} px are stated, and rows, columns and colours of {sorted(shapes)} came",
    )  # fmt: skip
    same = [
        np.array_equal(a.frame.image, b.frame.image)
        for a, b in itertools.pairwise(grabs)
    ]  # fmt: skip
    longest = max((len(list(run)) for alike, run in itertools.groupby(same) if alike), default=0)
    yield at_most(
        "not-frozen", longest, FROZEN - 1, "",
        f"{longest + 1} frames in a row are the same to the last bit; is the camera running?",
    )  # fmt: skip
    exposures = [one.frame.exposure_s for one in grabs]
    finite = [one for one in exposures if one is not None and 0 < one < math.inf]
    yield verdict(
        "exposure-stated", len(finite) == len(exposures),
        "frame.exposure_s is missing; force is averaged over it, so give it in s",
    )  # fmt: skip
    if finite:
        yield at_most(
            "exposure-length", max(finite), 1 / camera.rate_hz, "s",
            "the exposure is longer than the stated rate leaves room for; is it in seconds?",
        )  # fmt: skip


def _times(grabs: list[GrabbedFrame]) -> Part:
    ends = np.array([one.end_s for one in grabs])
    back = int(np.count_nonzero(np.diff(ends) <= 0))
    yield at_most(
        "time-order", back, 0, "",
        f"{back} frames were not later than the one before; grab() returns the next frame, not the last",
    )  # fmt: skip
    early = max(one.call_s - (one.end_s - (one.frame.exposure_s or 0.0)) for one in grabs)
    yield at_most(
        "exposed-after-call", early, EARLY_S, "s",
        "a frame was begun before it was asked for: an old one from a queue; throw those away",
    )  # fmt: skip
    lags = [one.arrival_s - one.end_s for one in grabs]
    lag = min(lags)
    ok = lag >= -EARLY_S and max(lags) <= LAG_S
    yield judge(
        "host-clock", ok, lag, LAG_S, "s",
        f"frames came {lag:g} to {max(lags):g} s after their stamps; stamp the end of the exposure, with the "
        "clock that was given, in ns",
    )  # fmt: skip


def _rate(camera: Camera, ends_s: Float[ndarray, " n"]) -> Part:
    """The lowest rate whose beat all stamps keep: pauses of any length lie between them."""
    stated = camera.rate_hz
    span_s = float(ends_s[-1] - ends_s[0])
    if not span_s > 0:
        yield verdict("frame-rate", False, "all frames have one time")
        return
    rates = np.arange(stated / SIDE, 2 * stated, FINE / span_s)
    beat = np.abs(np.exp(2j * np.pi * np.outer(rates, ends_s - ends_s[0])).mean(axis=1))
    rate = float(rates[np.flatnonzero(beat >= AS_HIGH * beat.max())[0]])
    peak = np.abs(rates - rate) < 1 / span_s
    best = int(np.argmax(np.where(peak, beat, 0.0)))
    rate = float(rates[best])
    yield judge(
        "frame-rate", abs(rate / stated - 1) <= RATE_WITHIN, rate, stated, "Hz",
        f"stamps keep the beat of {rate:.4g} Hz, and {stated:g} Hz are stated: are frames lost?",
    )  # fmt: skip
    # Of a normal jitter, the mean of exp(i phase) is exp(-variance / 2).
    jitter_s = math.sqrt(max(0.0, -2 * math.log(max(float(beat[best]), 1e-12)))) / (2 * math.pi * rate)
    yield at_most(
        "frame-interval", jitter_s, JITTER / stated, "s",
        "stamps jitter too much to tell when a frame was exposed; use the driver's stamps, or stamp sooner",
    )  # fmt: skip
