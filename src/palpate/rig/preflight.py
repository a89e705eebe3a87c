"""Tests of a real rig before its first motion: do its devices give what they and its file state?

A second of listening at a stand. What is wrong is named with both numbers, and nothing has moved yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.core import NS_PER_S, DeviceError, ForceSensor, Frame, RangeError, Wrench
from palpate.devices import Reason, Tripped
from palpate.devices.device_proxies import driver_errors
from palpate.rig.acquisition import check_size, drained
from palpate.rig.rig import Rig

MIN_S, MAX_S = 1.0, 5.0  # of listening
MIN_SAMPLES, MIN_FRAMES = 25, 20
POLL_S = 0.05
MIN_SHARE = 0.8  # of the stated rate of frames
MIN_FORCE_SHARE = 0.7  # and of samples


@dataclass
class Heard:
    """What came while the rig stood still.

    Attributes:
        seconds: for how long.
        force, second: samples of the guarding sensor and of the labelling one.
        stamps_ns: of the frames.
        repeats: frames that repeat the one before, to the last bit.
    """

    seconds: float = 0.0
    force: list[Wrench] = field(default_factory=list)
    second: list[Wrench] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    repeats: int = 0


def check_ready(rig: Rig) -> None:
    """Refuse a rig whose devices do not give what is stated, before anything moves.

    Raises:
        RangeError: its file promises more than its devices can do.
        Tripped: force samples or frames that are missing, faulty, stand still or come too seldom.
    """
    check_promises(rig)
    heard = _listen(rig)
    _check_force(rig, heard)
    _check_camera(rig, heard)
    if rig.label_force is not None:
        _check_samples("labelling force sensor", rig.label_force, heard.second, heard.seconds)


def check_promises(rig: Rig) -> None:
    """Refuse limits that the devices cannot keep.

    Raises:
        RangeError: names both numbers.
    """
    rig.limits.check_within(rig.stage.travel)
    rig.limits.check_range(rig.force.range_n[rig.mounting.normal])
    rate_hz, delay_s = rig.force.rate_hz, getattr(rig.force, "delay_s", 0.0)
    known_s = 1.0 / rate_hz + delay_s
    if known_s > rig.limits.force_latency_s * (1 + 1e-9):
        raise RangeError(
            f"the rig's limit force_latency_s is {rig.limits.force_latency_s:g} s, and its force sensor, "
            f"with {rate_hz:g} samples a second and a delay of {delay_s:g} s, tells of a force up to "
            f"{known_s:.3g} s late: the probe would run on further than is stated; give {known_s:.3g} or more"
        )


def notes_of(rig: Rig, indenters: Sequence[str] | None = None) -> list[str]:
    """Return what a rig does not protect against, and what to do; none for a virtual rig.

    Args:
        rig: to be recorded or checked.
        indenters: that are pressed; None for any.
    """
    if rig.seed is not None:
        return []
    notes = [rig.scheduling["remedy"] and f"no real-time scheduling: {rig.scheduling['remedy']}"]
    wanted = set(rig.stiffness if indenters is None else indenters)
    if not rig.stiffness or wanted - set(rig.stiffness):
        weighed = f"weighed on {rig.weighed_on}" if rig.weighed_on else "never weighed"
        notes.append(
            f"the gain of the force is not checked in the first press ({weighed}): weigh the sensor, record "
            "a run, and append what 'palpate rig fit RUN' prints to the rig's file"
        )
    return [one for one in notes if one]


def _listen(rig: Rig) -> Heard:
    """Let time pass at a stand, and keep what comes."""
    periods = [MIN_SAMPLES / rig.force.rate_hz, MIN_FRAMES / rig.camera.rate_hz]
    if rig.label_force is not None:
        periods.append(MIN_SAMPLES / 2 / rig.label_force.rate_hz)
    wanted_s = min(max(MIN_S, *periods), MAX_S)
    heard, before = Heard(), None
    for sensor in (rig.force, rig.label_force):
        if sensor is not None:
            _samples(sensor)
    drained(rig.camera)
    begun_ns = rig.clock.now_ns()
    while heard.seconds < wanted_s:
        rig.clock.sleep(POLL_S)
        for stamp_ns, frame in drained(rig.camera):
            before = _take_frame(rig, heard, stamp_ns, frame, before)
        heard.seconds = (rig.clock.now_ns() - begun_ns) / NS_PER_S
    heard.force = _samples(rig.force)
    heard.second = [] if rig.label_force is None else _samples(rig.label_force)
    return heard


def _samples(sensor: ForceSensor) -> list[Wrench]:
    try:
        with driver_errors("its driver raised"):
            return sensor.drain()
    except DeviceError as e:
        raise Tripped(Reason.FORCE_SENSOR, f"a force sensor failed before anything moved: {e}") from e


def _take_frame(rig: Rig, heard: Heard, stamp_ns: int, frame: Frame, before: Frame | None) -> Frame:
    check_size(rig.camera, frame)
    if heard.stamps_ns and stamp_ns <= heard.stamps_ns[-1]:
        raise Tripped(
            Reason.CAMERA,
            f"a frame is stamped {(heard.stamps_ns[-1] - stamp_ns) / 1e6:.1f} ms before the one that it "
            "follows: the camera's clock jumped or runs backwards",
        )
    heard.stamps_ns.append(stamp_ns)
    heard.repeats += before is not None and np.array_equal(before.image, frame.image)
    return frame


def _check_force(rig: Rig, heard: Heard) -> None:
    _check_samples("force sensor", rig.force, heard.force, heard.seconds)
    if len({(one.force_n, one.torque_nm) for one in heard.force}) == 1:
        raise Tripped(
            Reason.FORCE_STUCK,
            f"the force sensor gave {len(heard.force)} equal samples, in every channel: it does not measure; "
            "is its load cell plugged in? Push it by hand and look",
        )
    normal = rig.mounting.normal
    range_n = rig.force.range_n[normal]
    air_n = abs(float(np.mean([one.force_n[normal] for one in heard.force])))
    if air_n + rig.limits.force_n > range_n:
        raise Tripped(
            Reason.FORCE_FAULT,
            f"the force sensor reads {air_n:.2f} N before anything moved, and measures to {range_n:g} N: "
            f"with the limit force_N of {rig.limits.force_n:g} N it would saturate before anything stops. "
            "Take off what loads it, see whether its load cell is plugged in, or lower force_N",
        )


def _check_samples(name: str, sensor: ForceSensor, samples: list[Wrench], seconds: float) -> None:
    rate_hz = len(samples) / seconds
    if not samples:
        raise Tripped(Reason.FORCE_STALE, f"the {name} gave no sample for {seconds:.1f} s; is it on?")
    faulty = [one for one in samples if one.fault]
    if faulty:
        raise Tripped(
            Reason.FORCE_FAULT,
            f"the {name} says: {faulty[-1].fault}, in {len(faulty)} of {len(samples)} samples before "
            "anything moved; is its load cell plugged in, and nothing pressing on it?",
        )
    if rate_hz < MIN_FORCE_SHARE * sensor.rate_hz:
        raise Tripped(
            Reason.FORCE_SLOW,
            f"the {name} gave {rate_hz:.1f} samples/s, and {sensor.rate_hz:g} are stated; set the one or the "
            "other right",
        )


def _check_camera(rig: Rig, heard: Heard) -> None:
    camera, came = rig.camera, len(heard.stamps_ns)
    if came < 2:
        raise Tripped(
            Reason.CAMERA, f"the camera gave {came} frames in {heard.seconds:.1f} s; is it running?"
        )
    came_hz = (came - 1) * NS_PER_S / (heard.stamps_ns[-1] - heard.stamps_ns[0])
    rate_hz = came_hz * (came - heard.repeats) / came
    if rate_hz < MIN_SHARE * camera.rate_hz:
        repeats = f", since {heard.repeats} of {came} repeat the one before" if heard.repeats else ""
        health = getattr(camera, "health", "")
        raise Tripped(
            Reason.CAMERA,
            f"the camera gave {rate_hz:.1f} new frames/s{repeats}, and {camera.rate_hz:g} are stated; see to "
            f"its exposure, cable and light, or state the true rate_hz{f' ({health})' if health else ''}",
        )
