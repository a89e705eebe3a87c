"""Which sensor a source states that its frames are of, and whether a calibration is of another."""

from __future__ import annotations

import re
from typing import Any

from palpate.core import InputError
from palpate.core.sensor import SENSORS
from palpate.sensing.live_sources import HandFrames, LiveSource
from palpate.sensors.owned import preset_names

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
