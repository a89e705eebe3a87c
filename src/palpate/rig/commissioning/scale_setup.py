"""A serial scale in a guided setup: how it is reached, and the force of one count by a known weight."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from typing import Any

from palpate.core import Clock, DeviceError, ForceSensor, InputError, RangeError
from palpate.rig.commissioning.force_touch import ALLOWED_SHARE, G_M_S2, LOCAL_G_SHARE
from palpate.rig.commissioning.hand_motion import discard
from palpate.rig.commissioning.setup_answers import Answers, confirm, number, text

LINES = 12  # that a mean is taken of
SETTLE_DELAYS = 3.0  # of its own delay, after a weight was laid on
MIN_SIGMAS = 20.0  # of the noise of a mean that a weight has to stand out by
ALL_COUNTS = float(2**23 - 1)  # of 24 bits (HX711 data sheet)

OpenScale = Callable[[dict[str, Any]], ForceSensor]


def ask_scale(
    answers: Answers, name: str, ports: list[str], open_scale: OpenScale, clock: Clock
) -> tuple[dict[str, Any], str]:
    """Ask for a serial scale, try it, and find the force of one count where it prints counts.

    Args:
        answers: of a person or a file.
        name: begins the names of its answers, "force" or "label".
        ports: proposed; the first that is not taken.
        open_scale: opens the fields of a part.
        clock: of the waiting.

    Returns:
        The fields of its part, and what was found, in words.

    Raises:
        InputError: an answer that is not one, or a weight that was not felt.
        DeviceError: no scale answers.
    """
    part: dict[str, Any] = {"kind": "serial-scale", "axes": ["x", "y", "z"]}
    part["port"] = text(answers, f"{name}_port", "Port of the scale", ports[0] if ports else None)
    part["baud"] = int(number(answers, f"{name}_baud", "Its baud rate", 300, 4_000_000, 9600))
    part["unit"] = text(answers, f"{name}_unit", "Unit of lines without one: g, N, or counts", "g")
    part["ask"] = text(answers, f"{name}_ask", "What asks it for a line, such as SI; empty if it sends", "")
    part["rate_hz"] = number(answers, f"{name}_rate_hz", "Lines a second", 0.1, 1000.0, 10.0)
    part["delay_s"] = number(
        answers,
        f"{name}_delay_s",
        "Seconds from a change of force until it is printed in full",
        0.0,
        30.0,
        0.4,
    )
    if part["unit"] == "counts":
        found = _count(answers, name, part, open_scale, clock)
    else:
        found = _weighed(answers, name, part, open_scale, clock)
    return part, f"scale at {part['port']}: {found}"


def _count(answers: Answers, name: str, part: dict[str, Any], open_scale: OpenScale, clock: Clock) -> str:
    """Find the force of one count, by a known weight."""
    mass_g = number(answers, f"{name}_mass_g", "Known weight for the scale [g]", 0.1, 50_000.0)
    counts, share = _change(
        answers, name, {**part, "count_N": 1.0, "range_N": ALL_COUNTS}, open_scale, clock, mass_g
    )
    expected_n = mass_g * 1e-3 * G_M_S2
    part["count_N"] = float(f"{expected_n / counts:.6g}")
    part["range_N"] = number(
        answers,
        f"{name}_range_N",
        "Greatest force that the cell bears [N]",
        0.01,
        abs(part["count_N"]) * ALL_COUNTS,
    )
    count_n, percent = part["count_N"], 100 * share
    return f"{counts:.0f} counts of {expected_n:.3f} N, so {count_n:.6g} N a count +- {percent:.2g} % (95 %)"


def _weighed(answers: Answers, name: str, part: dict[str, Any], open_scale: OpenScale, clock: Clock) -> str:
    """Compare a printed unit with a known weight, where there is one."""
    part["range_N"] = number(
        answers, f"{name}_range_N", "Greatest force that it measures [N]", 0.01, 1e4, 50.0
    )
    mass_g = number(
        answers, f"{name}_mass_g", "Known weight for the scale [g]; 0 for none", 0.0, 50_000.0, 0.0
    )
    if mass_g == 0:
        sensor = open_scale(part)
        sensor.close()
        return "it prints lines that can be read; its scale was not compared with a weight"
    read_n, share = _change(answers, name, part, open_scale, clock, mass_g)
    expected_n = mass_g * 1e-3 * G_M_S2
    words = f"it printed {read_n:.4g} N for {expected_n:.4g} N"
    if abs(read_n / expected_n - 1.0) > max(ALLOWED_SHARE, share):
        raise InputError(f"{words}: calibrate it, or correct its unit", code="weight-differs")
    return f"{words}, within {100 * max(ALLOWED_SHARE, share):.2g} %"


def _change(
    answers: Answers, name: str, part: dict[str, Any], open_scale: OpenScale, clock: Clock, mass_g: float
) -> tuple[float, float]:
    """Change that a known weight makes, and the half-width of its share, for 95 %."""
    if part["unit"] != "counts" and mass_g * 1e-3 * G_M_S2 > part["range_N"]:
        raise RangeError(f"{mass_g:g} g weigh more than the {part['range_N']:g} N of its range")
    sensor = open_scale(part)
    try:
        before, noise = _mean(sensor, clock, part)
        if not confirm(answers, f"{name}_weight_lies", f"Lay {mass_g:g} g on the scale; does it rest"):
            raise InputError("the weight was not laid on the scale; begin anew")
        clock.sleep(SETTLE_DELAYS * part["delay_s"])
        after, noise_after = _mean(sensor, clock, part)
    finally:
        sensor.close()
    spread = 2.0 * math.hypot(noise, noise_after)
    if abs(after - before) <= MIN_SIGMAS / 2.0 * spread or after == before:
        raise InputError(
            f"the weight changed the scale's reading by {after - before:.4g}, under a noise of "
            f"{spread:.2g}: it is "
            "not felt; see to the cell's wires, or take a heavier weight"
        )
    return after - before, math.hypot(spread / abs(after - before), LOCAL_G_SHARE)


def _mean(sensor: ForceSensor, clock: Clock, part: dict[str, Any]) -> tuple[float, float]:
    """Mean of some lines along z, and its standard error."""
    discard(sensor)
    clock.sleep(LINES / part["rate_hz"])
    values = [one.force_n[2] for one in sensor.drain() if not one.fault]
    if len(values) < LINES // 2:
        raise DeviceError(
            f"the scale printed {len(values)} good lines in {LINES / part['rate_hz']:.1f} s, and "
            f"{part['rate_hz']:g} a second are stated; state the true rate_hz, or see to its load",
            code="sample-rate",
        )
    return statistics.fmean(values), statistics.stdev(values) / math.sqrt(len(values))
