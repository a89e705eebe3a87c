"""Homing, after a lift and under the watch of the force sensor: switches may lie on the skin's side."""

from __future__ import annotations

import math
import threading
from contextlib import suppress
from dataclasses import replace

from palpate.core import Clock, DeviceError, ForceSensor, Stage
from palpate.devices import Mounting, Reason, Tripped
from palpate.devices.force_bias import Force
from palpate.rig.commissioning.hand_motion import LIFT_SPEED_M_S, RISE_N, Homing, lift_clear, retreat
from palpate.rig.mean_force import POLL_S, AirForce, Hand, LiveSamples, discard, mean_force

HOMING_LIFT_M = 8e-3  # at least, before homing, whatever the force says: a numb sensor reads as air does
HOMING_N = 1.0  # change of force that ends homing


def home_clear(
    stage: Stage, force: ForceSensor | None, mounting: Mounting, clock: Clock, *, lifted: bool = False
) -> AirForce | None:
    """Home a stage, never from within the skin: the probe is first lifted by force.

    A stage that an alarm has locked is unlocked for the lift. Flat force does not prove air, since a numb
    sensor gives it in the skin as well: the probe is lifted by `HOMING_LIFT_M` at least.

    Args:
        lifted: take the caller's word that the probe hangs free, and do not lift.

    Raises:
        Tripped: the lift found no air, or the force changed in homing.
        DeviceError: there are no switches, no force sensor and no word, or the stage fails.
    """
    hand = None if force is None else Hand(stage, force, mounting, clock)
    if not isinstance(stage, Homing):
        raise DeviceError("this stage has no homing; state where it stands by reference in the rig's file")
    found = None
    if not lifted:
        how = "lift the probe by hand and home with --lifted, your word that it hangs free"
        if hand is None:
            raise DeviceError(
                f"no force sensor can tell whether the probe is free, so it was not homed; {how}"
            )
        try:
            found = _lift_well_clear(hand)
        except DeviceError:
            stage.unlock()
            try:
                found = _lift_well_clear(hand)
            except DeviceError as e:
                raise DeviceError(
                    f"the probe could not be lifted, so the stage was not homed ({e}); its lock was taken "
                    f"off: believe no place of it until it is homed; {how}"
                ) from e
    if force is None:
        stage.home()
    else:
        home_watched(stage, force, clock)
    return found


def _lift_well_clear(hand: Hand) -> AirForce:
    """Lift until the force is flat, and by `HOMING_LIFT_M` at least: a flat force alone proves no air."""
    found = lift_clear(hand)
    more_m = HOMING_LIFT_M - found.lifted_mm * 1e-3
    if more_m <= 0:
        return found
    retreat(hand, more_m, LIFT_SPEED_M_S, start=found, lifted_m=found.lifted_mm * 1e-3, most_n=RISE_N)
    return replace(found, lifted_mm=HOMING_LIFT_M * 1e3)


def home_watched(stage: Homing, force: ForceSensor, clock: Clock) -> None:
    """Home a stage, and stop it where the force changes by `HOMING_N` in any direction.

    Raises:
        Tripped: the force changed, or could not be believed; the stage stands, and its place is not known.
        DeviceError: the stage fails.
    """
    air_n = mean_force(force, Mounting(), clock).force_n
    discard(force)
    live = LiveSamples(force, clock)
    ended = threading.Event()
    doubts: list[Tripped] = []

    def watch() -> None:
        while not (doubts or ended.wait(POLL_S)):
            try:
                _look(live, air_n)
            except DeviceError as e:
                doubts.append(Tripped(Reason.FORCE_SENSOR, str(e)))
            except Tripped as e:
                doubts.append(e)
        if doubts:
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


def _look(live: LiveSamples, air_n: Force) -> None:
    if any(math.dist(one.force_n, air_n) > HOMING_N for one in live.take()):
        raise Tripped(
            Reason.FORCE_LIMIT,
            f"the force changed by more than {HOMING_N:g} N in homing: the probe met something. Look where "
            "the switches are, and lift the probe by hand",
        )
