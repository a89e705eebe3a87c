"""Homing under the force sensor's watch: switches may be broken, or lie towards the skin."""

from __future__ import annotations

import math
import threading
from contextlib import suppress

from palpate.core import NS_PER_S, Clock, DeviceError, ForceSensor
from palpate.devices import Mounting, Reason, Tripped
from palpate.devices.device_proxies import PlainForceSource
from palpate.devices.force_bias import Force
from palpate.rig.commissioning.hand_motion import POLL_S, STALE_S, Homing, mean_force

HOMING_N = 1.0  # change of force that ends homing


def home_watched(stage: Homing, force: ForceSensor, clock: Clock) -> None:
    """Home a stage, and stop it where the force changes by `HOMING_N` in any direction.

    Raises:
        Tripped: the force changed, or could not be believed; the stage stands, and its place is not known.
        DeviceError: the stage fails.
    """
    air_n = mean_force(force, Mounting(), clock).force_n
    ended = threading.Event()
    doubts: list[Tripped] = []

    def watch() -> None:
        newest_ns = clock.now_ns()
        while not (doubts or ended.wait(POLL_S)):
            newest_ns, doubt = _look(force, air_n, newest_ns, clock.now_ns())
            if doubt is not None:
                doubts.append(doubt)
                with suppress(DeviceError):  # its place is lost, which the caller is told
                    stage.stop()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        stage.home()
    except DeviceError as e:
        if doubts:
            raise doubts[0] from e
        raise
    finally:
        ended.set()
        watcher.join()
    if doubts:
        raise doubts[0]


def _look(force: ForceSensor, air_n: Force, newest_ns: int, now_ns: int) -> tuple[int, Tripped | None]:
    """Time of the newest sample, and what is wrong with the samples since the last look."""
    try:
        samples = PlainForceSource(force).drain()
    except DeviceError as e:
        return newest_ns, Tripped(Reason.FORCE_SENSOR, str(e))
    for one in samples:
        if one.fault:
            return newest_ns, Tripped(Reason.FORCE_FAULT, f"the force sensor reports: {one.fault}")
        if math.dist(one.force_n, air_n) > HOMING_N:
            return newest_ns, Tripped(
                Reason.FORCE_LIMIT,
                f"the force changed by more than {HOMING_N:g} N in homing: the probe met something. Look "
                "where the switches are, and lift the probe by hand",
            )
    newest_ns = samples[-1].time_ns if samples else newest_ns
    if now_ns - newest_ns > STALE_S * NS_PER_S:
        return newest_ns, Tripped(
            Reason.FORCE_STALE, f"no force came for {STALE_S:g} s while the stage homed"
        )
    return newest_ns, None
