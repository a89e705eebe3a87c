"""Guided setup: a rig's file from what is connected, a gentle touch and a known weight, ended by the check.

Nothing moves before the operator says that it may. The file is written once, after all that was asked, and
never over another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from palpate.core import NS_PER_S, Clock, DeviceError, InputError, MonotonicClock, PalpateError, RangeError
from palpate.core.files import new_file, refuse_existing
from palpate.devices import Mounting
from palpate.devices.check.check_result import CheckResult
from palpate.rig.commissioning.bench import frame_times
from palpate.rig.commissioning.first_touch import Say, first_touch
from palpate.rig.commissioning.force_touch import WeighingResult, weigh
from palpate.rig.commissioning.found_parts import BAUD, FoundStage, find_stage, serial_ports, video_devices
from palpate.rig.commissioning.hand_motion import mean_force
from palpate.rig.commissioning.scale_setup import ask_scale
from palpate.rig.commissioning.setup_answers import (
    Answers,
    Three,
    confirm,
    number,
    text,
    three,
    until_good,
)
from palpate.rig.commissioning.toml_text import toml_text
from palpate.rig.rig_check import check_rig
from palpate.rig.rig_file import MAX_LIMITS, LimitsPart, PositionFrom, RigFile, open_part, open_rig

MM = 1e3
RANGE_SHARE = 0.5  # of the sensor's range, proposed as the limit of force
PROPOSED_N = 20.0
PRESS_MM_S = 2.0  # at which plans press where they say nothing else
BRAKES_MM_S2 = 50.0  # a slow stage's acceleration
CAMERA_S = 2.0  # for a camera's rate
CAMERA_SLOW = 0.8  # of the rate that it states


@dataclass(slots=True)
class SetUp:
    """What a setup found.

    Attributes:
        fields: of the file that was written.
        checks: of the rig; empty where nothing was allowed to move.
        unchecked: what could not be checked, in words.
    """

    fields: dict[str, Any]
    checks: list[CheckResult] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)


def set_up(out: Path, answers: Answers, say: Say) -> SetUp:
    """Ask, try, touch, weigh, write and check.

    Args:
        out: the rig's file to make; must not exist.
        answers: of a person or a file.
        say: takes a line about each thing that is found or done.

    Raises:
        ExistsError: `out` exists.
        InputError: an answer that is missing, or is not one.
        RangeError: a limit beyond what the devices can do.
        DeviceError: a device does not answer.
        Tripped: a touch or a motion that was not as it has to be; the stage stands, nothing is written.
    """
    refuse_existing(out)
    clock = MonotonicClock()
    made = SetUp({})
    made.fields |= {
        "name": text(answers, "name", "Name of the rig"),
        "sensor": text(answers, "sensor", "What is calibrated, such as its serial number", ""),
        "design": text(answers, "design", "Design of the sensor, such as palm", "palm"),
        "origin_mm": [0.0, 0.0, 0.0],
    }
    found = _stage(made, answers, say, clock)
    for part in (_force, _label, _camera):
        until_good(answers, partial(part, made, answers, say, clock))
    _limits(made, answers, found)
    file = _validated(made.fields)
    may_move = confirm(
        answers,
        "may_move",
        "May the stage move now? A hand lies on the switch that cuts its power, the probe hangs free",
    )
    if may_move:
        touched = first_touch(file, found.homing, answers, say, clock)
        made.fields["origin_mm"] = touched["origin_mm"]
        made.fields["force"]["axes"] = touched["axes"]
        if not found.homing:
            made.fields["stage"]["reference"] = touched["reference"]
        if not touched["motors_hold"]:
            made.unchecked.append(
                "the stage's position at each opening: its motors are released at rest; home it, or give "
                "--position touch-off or --position reference"
            )
    else:
        made.unchecked += [
            "axis and sign of the force",
            "the expected surface",
        ]
    _weight(made, answers, say, clock)
    file = _validated(made.fields)
    refuse_existing(out)
    with new_file(out) as path:
        path.write_text(toml_text(made.fields), encoding="utf-8")
    say(f"{out} is written")
    if may_move:
        _check(out, made, answers, say, known=found.homing and touched["motors_hold"])
    else:
        made.unchecked.append("the rig's check: run palpate rig check once it may move")
    made.unchecked += [
        "x and y of the force sensor: they are in its own order and signs; push it sideways and look",
        "the stop on this firmware: palpate stopped nothing but simulated devices so far; try yours in air",
        *(f"the answer {name!r} was never asked for" for name in answers.unused()),
    ]
    return made


def _find_stage(answers: Answers, say: Say, clock: Clock) -> tuple[FoundStage, tuple[str, str, str]]:
    """The one stage that answers, and the machine axes that it was asked for."""
    listed = serial_ports()
    say(f"serial ports: {', '.join(listed) or 'none is listed'}")
    wanted = answers.ask(
        "stage_ports", "Ports to ask for a stage (opening one may reset its board), as a list", listed or None
    )
    ports = [wanted] if isinstance(wanted, str) else list(wanted)
    axes_asked = answers.ask(
        "stage_axes",
        "Machine axes that are x (right), y (towards you), z (into the skin)",
        ["+X", "-Y", "-Z"],
    )
    axes = _three_words("stage_axes", axes_asked)
    boot_s = number(answers, "boot_s", "Seconds that the board takes to start once opened", 0.0, 30.0, 2.5)
    baud = int(number(answers, "stage_baud", "Baud rate of the stage's board", 1200, 4_000_000, BAUD))
    answered: list[FoundStage] = []
    for port in ports:
        one = find_stage(str(port), axes, boot_s, clock, baud)
        if isinstance(one, FoundStage):
            answered.append(one)
            say(f"{port}: {one.kind}, {one.says}, {'homes on switches' if one.homing else 'has no switches'}")
        else:
            say(f"{port}: {one}")
    if len(answered) != 1:
        raise DeviceError(
            f"{len(answered)} stages answer at {', '.join(map(str, ports)) or 'no port'}; one is needed. "
            "Name its port alone as stage_ports, see to power and cable, and try another stage_baud"
        )
    return answered[0], axes


def _stage(made: SetUp, answers: Answers, say: Say, clock: Clock) -> FoundStage:
    found, axes = until_good(answers, lambda: _find_stage(answers, say, clock))
    part: dict[str, Any] = {"kind": found.kind, **found.fields, "axes": list(axes)}
    part["latency_s"] = number(
        answers, "latency_s", "Seconds from asking for a stop to its slowing down", 1e-3, 1.0, 0.05
    )
    if not found.tells_jerk:
        part["sudden_mm_s"] = number(
            answers,
            "sudden_mm_s",
            "Fastest speed from which it stops dead without losing steps [mm/s]",
            0.1,
            50,
        )
    if found.homing and part.get("dtr"):  # opening its port may reset it, and it forgets its place then
        part["home"] = True
        made.unchecked.append("whether its board keeps its place when its port is opened: it homes each time")
    elif found.homing:
        part["reference"] = "counts"
    else:
        if found.kind == "grbl":
            part["require_homed"] = False
        part["reference"] = list(
            three(
                answers,
                "stands_mm",
                "Where the stage stands now, without switches",
            )
        )
    made.fields["stage"] = part
    return found


def _force(made: SetUp, answers: Answers, say: Say, clock: Clock) -> None:
    kind = text(
        answers,
        "force_kind",
        "Force sensor that guards: netft, serial-scale, or module:Class of your own",
        "netft",
    )
    part: dict[str, Any] = {"kind": kind, "axes": ["x", "y", "z"]}
    if kind == "serial-scale":
        _guarding_scale(made, answers, say, clock)
        return
    if kind == "netft":
        part["host"] = text(answers, "force_host", "Its address in the network", "192.168.1.1")
        part["rdt_port"] = int(number(answers, "force_rdt_port", "Its port of records", 1, 65535, 49152))
        part["http_port"] = int(number(answers, "force_http_port", "Its port of pages", 1, 65535, 80))
        part["silence_s"] = number(
            answers, "force_silence_s", "Seconds without a record that count as gone", 0.02, 0.5, 0.1
        )
    else:
        part |= _options(answers, "force_options")
    made.fields["force"] = part
    with ExitStack() as opened:
        sensor = open_part("force", _part("force", part), clock)
        opened.callback(sensor.close)
        air = mean_force(sensor, Mounting(), clock)
        made.fields["_range_n"] = min(sensor.range_n)
        say(
            f"force: {air.rate_hz:.0f} samples/s of {sensor.rate_hz:g} stated, range "
            f"{', '.join(f'{r:g}' for r in sensor.range_n)} N, noise {air.noise_n:.4f} N"
        )


def _guarding_scale(made: SetUp, answers: Answers, say: Say, clock: Clock) -> None:
    """A load cell that guards, which only a fast one may: its newest sample is never older than the limit."""
    part, words = ask_scale(answers, "force", _free_ports(made), _opener(clock), clock)
    say(words)
    known_s = 1.0 / part["rate_hz"] + part["delay_s"]
    most_s = MAX_LIMITS["force_latency_s"]
    if known_s > most_s:
        raise InputError(
            f"with {part['rate_hz']:g} lines a second and a delay of {part['delay_s']:g} s this scale "
            "tells of a "
            f"force {known_s:.3g} s late, and {most_s:g} s are allowed of a sensor that guards: it may label "
            "beside a faster one (label_kind = serial-scale)",
            code="force-delay",
        )
    made.fields["force"] = part
    made.fields["_range_n"] = part["range_N"]
    made.fields["_latency_s"] = math.ceil(known_s * 1e3) / 1e3


def _label(made: SetUp, answers: Answers, say: Say, clock: Clock) -> None:
    """A second sensor, which labels and guards nothing."""
    kind = text(
        answers, "label_kind", "Second force sensor, which only labels: serial-scale, or none", "none"
    )
    if kind == "none":
        return
    if kind != "serial-scale":
        raise InputError(f"label_kind is {kind!r}; give serial-scale or none")
    part, words = ask_scale(answers, "label", _free_ports(made), _opener(clock), clock)
    say(words)
    made.fields["label_force"] = part


def _opener(clock: Clock) -> Callable[[dict[str, Any]], Any]:
    return lambda part: open_part("force", _part("force", part), clock)


def _free_ports(made: SetUp) -> list[str]:
    taken = made.fields["stage"]["port"]
    return [port for port in serial_ports() if port != taken]


def _camera(made: SetUp, answers: Answers, say: Say, clock: Clock) -> None:
    kind = text(answers, "camera_kind", "Camera: uvc, or module:Class of your own", "uvc")
    if kind != "uvc":
        part = {"kind": kind, **_options(answers, "camera_options")}
        say(_tried(part, clock))
    else:
        listed = video_devices()
        wanted = answers.ask("camera_address", "Cameras to try, by path or number, as a list", listed or [0])
        addresses = list(wanted) if isinstance(wanted, list) else [wanted]
        rate_hz = number(answers, "camera_rate_hz", "Frames a second", 0.1, 1000.0, 30.0)
        working = []
        for address in addresses:
            part = {"kind": "uvc", "address": address, "rate_hz": rate_hz}
            try:
                say(_tried(part, clock))
                working.append(part)
            except PalpateError as e:
                say(f"camera {address}: {e}")
        if len(working) != 1:
            raise DeviceError(
                f"{len(working)} cameras gave frames of {len(addresses)} that were tried; one is needed. "
                "Name it alone as camera_address"
            )
        (part,) = working
    made.fields["camera"] = part


def _tried(part: dict[str, Any], clock: Clock) -> str:
    camera = open_part("camera", _part("camera", part), clock)
    try:
        times_ns = frame_times(camera, clock, CAMERA_S)
        rate_hz = (len(times_ns) - 1) * NS_PER_S / max(times_ns[-1] - times_ns[0], 1)
        named = part.get("address", part["kind"])
        said = f"camera {named}: {rate_hz:.1f} frames/s of {camera.rate_hz:g} stated"
        if rate_hz < CAMERA_SLOW * camera.rate_hz:
            said += f": too slow; state rate_hz = {rate_hz:.0f}, or give it more light and a free port"
        return said
    finally:
        camera.close()


def _limits(made: SetUp, answers: Answers, found: FoundStage) -> None:
    boxes: tuple[Three | None, Three | None] = (None, None)
    if found.homing and found.travel_m is not None:
        low, high = found.travel_m
        boxes = (_mm(low), _mm(high))
    words = ("Soft limits of the stage, least, in its frame", "Soft limits, greatest; z is the deepest")

    def least_mm() -> Three:
        least = three(answers, "least_mm", words[0], boxes[0])
        return _inside(least, boxes)

    def greatest_mm() -> Three:
        greatest = _inside(three(answers, "greatest_mm", words[1], boxes[1]), boxes)
        _check_above(least, greatest)
        return greatest

    least = until_good(answers, least_mm)
    greatest = until_good(answers, greatest_mm)
    if not found.homing:
        made.fields["stage"] |= {"least_mm": list(least), "greatest_mm": list(greatest)}
    range_n = made.fields.pop("_range_n")
    most_n = min(MAX_LIMITS["force_N"], range_n)
    force_n = number(
        answers, "force_N", "Greatest force [N]", 0.1, most_n, min(PROPOSED_N, RANGE_SHARE * range_n)
    )
    made.fields["limits"] = {"least_mm": list(least), "greatest_mm": list(greatest), "force_N": force_n}
    if (latency_s := made.fields.pop("_latency_s", None)) is not None:
        made.fields["limits"] |= {"force_latency_s": latency_s, "age_s": max(0.1, 2 * latency_s)}
    defaults = LimitsPart(**made.fields["limits"])
    delay_s = made.fields["stage"]["latency_s"] + defaults.force_latency_s
    runs_on_mm = PRESS_MM_S * delay_s + PRESS_MM_S**2 / (2 * BRAKES_MM_S2)
    if runs_on_mm > defaults.overshoot_mm:
        allowed_mm = math.ceil(50 * runs_on_mm) / 50
        made.fields["limits"]["overshoot_mm"] = min(allowed_mm, MAX_LIMITS["overshoot_mm"])


def _inside(corner: Three, boxes: tuple[Three | None, Three | None]) -> Three:
    for axis, at, low, high in zip("xyz", corner, *(box or corner for box in boxes), strict=True):
        if not low - 1e-6 <= at <= high + 1e-6:
            raise RangeError(
                f"a soft limit of {axis} at {at:g} mm lies outside the {low:g} to {high:g} mm of travel that "
                "the firmware states"
            )
    return corner


def _check_above(least: Three, greatest: Three) -> None:
    for axis, low, high in zip("xyz", least, greatest, strict=True):
        if not low < high:
            raise RangeError(
                f"soft limits of {axis} from {low:g} to {high:g} mm; the greatest has to be more",
                code="soft-limits",
            )


def _weight(made: SetUp, answers: Answers, say: Say, clock: Clock) -> None:
    if (
        made.fields["force"]["kind"] == "serial-scale"
    ):  # its count was found by a weight, or its unit compared
        return
    mass_g = number(answers, "mass_g", "Known weight for the force sensor [g]; 0 for none", 0.0, 5000.0)
    if mass_g == 0:
        made.unchecked.append("the scale of the force: no known weight was laid on")
        return
    tolerance_g = number(answers, "mass_tolerance_g", "How well it is known [g]", 0.0, mass_g, 0.01 * mass_g)
    part = made.fields["force"]

    def lay() -> None:
        if not confirm(answers, "weight_lies", f"Lay or hang {mass_g:g} g on the sensor; does it rest"):
            raise InputError("the weight was not laid on; begin anew, or answer mass_g = 0")

    sensor = open_part("force", _part("force", part), clock)
    try:
        axes = tuple(part["axes"])
        found = weigh(sensor, (axes[0], axes[1], axes[2]), clock, mass_g, tolerance_g, lay)
    finally:
        sensor.close()
    _take_scale(part, found, answers, say)
    today = datetime.now(UTC).date().isoformat()
    made.fields["known_weight"] = {"measured_on": today, "mass_g": mass_g, "factor": round(found.factor, 5)}
    if not confirm(answers, "weight_off", "Take the weight off again; is it off", True):
        raise InputError("the weight has to be off before anything moves; begin anew")


def _take_scale(part: dict[str, Any], found: WeighingResult, answers: Answers, say: Say) -> None:
    words = (
        f"the weight is {found.expected_n:.3f} N, and {found.read_n:.3f} N were read: a factor of "
        f"{found.factor:.4f} +- {found.uncertainty:.4f} (95 %)"
    )
    say(words)
    if found.agrees:
        return
    if not 0.1 <= found.factor <= 10.0:
        raise InputError(f"{words}; factors from 0.1 to 10 are written: see to the sensor's unit and wiring")
    if not confirm(answers, "write_scale", f"{words}. Write it as the sensor's scale", False):
        raise InputError(f"{words}; it was not accepted, and nothing is written: see to the sensor")
    part["scale"] = round(found.factor, 5)
    part["scale_uncertainty"] = round(found.uncertainty, 5)


def _check(out: Path, made: SetUp, answers: Answers, say: Say, *, known: bool) -> None:
    position: PositionFrom = "stored"
    if not (known or made.fields["stage"].get("home")):
        if not confirm(answers, "still_there", "Is the stage where the touch left it, not pushed since"):
            made.unchecked.append("the rig's check: the stage's position was not confirmed")
            return
        position = "reference"
    say("checking the rig; the stage moves by 2 mm")
    try:
        rig = open_rig(str(out), supervised=False, position=position)
    except PalpateError as e:
        raise DeviceError(
            f"{out} is written, and could not be opened for its check ({e}). Where the board resets as its "
            "port is opened, set home = true in [stage]; then palpate rig check"
        ) from e
    made.checks = check_rig(rig)


def _part(role: str, fields: dict[str, Any]) -> Any:
    return getattr(_validated({"name": "setup", role: fields}), role)


def _validated(fields: dict[str, Any]) -> RigFile:
    try:
        return RigFile.model_validate({name: value for name, value in fields.items() if name[0] != "_"})
    except ValidationError as e:
        problems = "; ".join(f"{'.'.join(map(str, d['loc']))}: {d['msg']}" for d in e.errors())
        raise InputError(f"what was answered makes no rig's file: {problems}") from e


def _options(answers: Answers, name: str) -> dict[str, Any]:
    options = answers.ask(name, 'Its options, as {"port": "/dev/ttyUSB1"}', {})
    if not isinstance(options, dict):
        raise InputError(f"{name} is {options!r}; give a table of names and values, or {{}}")
    return options


def _three_words(name: str, answer: Any) -> tuple[str, str, str]:
    if isinstance(answer, str):  # as a person types them
        answer = [word.strip() for word in answer.strip("[]").replace('"', "").split(",")]
    if not isinstance(answer, list | tuple) or len(answer) != len("xyz"):
        raise InputError(f'{name} is {answer!r}; give three, as in ["+X", "-Y", "-Z"]')
    x, y, z = (str(one) for one in answer)
    return x, y, z


def _mm(at: Three) -> Three:
    x, y, z = (round(d * MM, 4) + 0.0 for d in at)  # + 0.0: no minus zero
    return x, y, z
