"""Guided setup: a rig's file from what is connected, a gentle touch and a known weight, ended by the check.

Nothing moves before the operator says that it may. The file is written once, after all that was asked, and
never over another.
"""

from __future__ import annotations

import math
import statistics
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from palpate.core import (
    NS_PER_S,
    Clock,
    DeviceError,
    ForceSensor,
    InputError,
    MonotonicClock,
    PalpateError,
    RangeError,
)
from palpate.core.files import new_file, refuse_existing
from palpate.devices import Mounting
from palpate.devices.check.interface_check import CheckResult, Role
from palpate.rig.commissioning.bench import frame_times
from palpate.rig.commissioning.first_touch import (
    ALLOWED_SHARE,
    G_M_S2,
    LOCAL_G_SHARE,
    Say,
    WeighingResult,
    first_touch,
    weigh,
)
from palpate.rig.commissioning.setup_answers import (
    BAUD,
    Answers,
    FoundStage,
    Three,
    find_stage,
    serial_ports,
    toml_text,
    video_devices,
)
from palpate.rig.mean_force import discard, mean_force
from palpate.rig.rig_check import check_rig
from palpate.rig.rig_file import MAX_LIMITS, LimitsPart, PositionFrom, RigFile, open_part, open_rig

MM = 1e3
RANGE_SHARE = 0.5  # of the sensor's range, proposed as the limit of force
PROPOSED_N = 20.0
PRESS_MM_S = 2.0  # at which plans press where they say nothing else
BRAKES_MM_S2 = 50.0  # a slow stage's acceleration
CAMERA_S = 2.0  # for a camera's rate
CAMERA_SLOW = 0.8  # of the rate that it states
LINES = 12  # of a scale, that a mean is taken of
SETTLE_DELAYS = 3.0  # of its own delay, after a weight was laid on
MIN_SIGMAS = 20.0  # of the noise of a mean that a weight has to stand out by
ALL_COUNTS = float(2**23 - 1)  # of 24 bits (HX711 data sheet)


@dataclass(slots=True)
class SetUp:
    """A setup under way, and what it found.

    Attributes:
        answers, say, clock: of whoever is asked and told; of the devices.
        fields: of the file that was written.
        checks: of the rig; empty where nothing was allowed to move.
        unchecked: what could not be checked, in words.
    """

    answers: Answers
    say: Say
    clock: Clock = field(default_factory=MonotonicClock)
    fields: dict[str, Any] = field(default_factory=dict)
    checks: list[CheckResult] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)

    def open(self, role: Role, part: dict[str, Any]) -> Any:
        """Open a device of these fields."""
        return open_part(role, getattr(_validated({"name": "setup", role: part}), role), self.clock)


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
    made = SetUp(answers, say)
    made.fields |= {
        "name": answers.text("name", "Name of the rig"),
        "sensor": answers.text("sensor", "What is calibrated, such as its serial number", ""),
        "design": answers.text("design", "Design of the sensor, such as palm", "palm"),
        "origin_mm": [0.0, 0.0, 0.0],
    }
    found = _stage(made)
    for part in (_force, _label, _camera):
        answers.until_good(partial(part, made))
    _limits(made, found)
    file = _validated(made.fields)
    may_move = answers.confirm(
        "may_move",
        "May the stage move now? A hand lies on the switch that cuts its power, the probe hangs free",
    )
    if may_move:
        touched = first_touch(file, found.homing, answers, say, made.clock)
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
        made.unchecked += ["axis and sign of the force", "the expected surface"]
    _weight(made)
    _validated(made.fields)
    refuse_existing(out)
    with new_file(out) as path:
        path.write_text(toml_text(made.fields), encoding="utf-8")
    say(f"{out} is written")
    if may_move:
        _check(out, made, known=found.homing and touched["motors_hold"])
    else:
        made.unchecked.append("the rig's check: run palpate rig check once it may move")
    made.unchecked += [
        "x and y of the force sensor: they are in its own order and signs; push it sideways and look",
        "the stop on this firmware: palpate stopped nothing but simulated devices so far; try yours in air",
        *(f"the answer {name!r} was never asked for" for name in answers.unused()),
    ]
    return made


def _find_stage(made: SetUp) -> tuple[FoundStage, tuple[str, str, str]]:
    """The one stage that answers, and the machine axes that it was asked for."""
    listed = serial_ports()
    made.say(f"serial ports: {', '.join(listed) or 'none is listed'}")
    wanted = made.answers.ask(
        "stage_ports", "Ports to ask for a stage (opening one may reset its board), as a list", listed or None
    )
    ports = [wanted] if isinstance(wanted, str) else list(wanted)
    words = "Machine axes that are x (right), y (towards you), z (into the skin)"
    axes = _three_words("stage_axes", made.answers.ask("stage_axes", words, ["+X", "-Y", "-Z"]))
    boot_s = made.answers.number(
        "boot_s", "Seconds that the board takes to start once opened", 0.0, 30.0, 2.5
    )
    baud = int(made.answers.number("stage_baud", "Baud rate of the stage's board", 1200, 4_000_000, BAUD))
    answered: list[FoundStage] = []
    for port in ports:
        one: Any = find_stage(str(port), axes, boot_s, made.clock, baud)
        if isinstance(one, FoundStage):
            answered.append(one)
            one = f"{one.kind}, {one.says}, {'homes on switches' if one.homing else 'has no switches'}"
        made.say(f"{port}: {one}")
    if len(answered) != 1:
        raise DeviceError(
            f"{len(answered)} stages answer at {', '.join(map(str, ports)) or 'no port'}; one is needed. "
            "Name its port alone as stage_ports, see to power and cable, and try another stage_baud"
        )
    return answered[0], axes


def _stage(made: SetUp) -> FoundStage:
    found, axes = made.answers.until_good(lambda: _find_stage(made))
    part: dict[str, Any] = {"kind": found.kind, **found.fields, "axes": list(axes)}
    part["latency_s"] = made.answers.number(
        "latency_s", "Seconds from asking for a stop to its slowing down", 1e-3, 1.0, 0.05
    )
    if not found.tells_jerk:
        part["sudden_mm_s"] = made.answers.number(
            "sudden_mm_s", "Fastest speed from which it stops dead without losing steps [mm/s]", 0.1, 50
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
            made.answers.three("stands_mm", "Where the stage stands now, without switches")
        )
    made.fields["stage"] = part
    return found


def _force(made: SetUp) -> None:
    kind = made.answers.text(
        "force_kind", "Force sensor that guards: netft, serial-scale, or module:Class of your own", "netft"
    )
    if kind == "serial-scale":
        _guarding_scale(made)
        return
    part: dict[str, Any] = {"kind": kind, "axes": ["x", "y", "z"]}
    if kind == "netft":
        part["host"] = made.answers.text("force_host", "Its address in the network", "192.168.1.1")
        part["rdt_port"] = int(made.answers.number("force_rdt_port", "Its port of records", 1, 65535, 49152))
        part["http_port"] = int(made.answers.number("force_http_port", "Its port of pages", 1, 65535, 80))
        part["silence_s"] = made.answers.number(
            "force_silence_s", "Seconds without a record that count as gone", 0.02, 0.5, 0.1
        )
    else:
        part |= _options(made, "force_options")
    made.fields["force"] = part
    with closing(made.open("force", part)) as sensor:
        air = mean_force(sensor, Mounting(), made.clock)
        made.fields["_range_n"] = min(sensor.range_n)
        made.say(
            f"force: {air.rate_hz:.0f} samples/s of {sensor.rate_hz:g} stated, range "
            f"{', '.join(f'{r:g}' for r in sensor.range_n)} N, noise {air.noise_n:.4f} N"
        )


def _guarding_scale(made: SetUp) -> None:
    """A load cell that guards, which only a fast one may: its newest sample is never older than the limit."""
    part = _ask_scale(made, "force")
    known_s = 1.0 / part["rate_hz"] + part["delay_s"]
    most_s = MAX_LIMITS["force_latency_s"]
    if known_s > most_s:
        raise InputError(
            f"with {part['rate_hz']:g} lines a second and a delay of {part['delay_s']:g} s this scale "
            f"reports a force {known_s:.3g} s late, and {most_s:g} s are allowed of a sensor that guards: it "
            "may label next to a faster one (label_kind = serial-scale)",
            code="force-delay",
        )
    made.fields["force"] = part
    made.fields["_range_n"] = part["range_N"]
    made.fields["_latency_s"] = math.ceil(known_s * 1e3) / 1e3


def _ask_scale(made: SetUp, name: str) -> dict[str, Any]:
    """Fields of a serial scale, which is tried, and the force of one count where it prints counts."""
    ask, ports = made.answers, [port for port in serial_ports() if port != made.fields["stage"]["port"]]
    part: dict[str, Any] = {"kind": "serial-scale", "axes": ["x", "y", "z"]}
    part["port"] = ask.text(f"{name}_port", "Port of the scale", ports[0] if ports else None)
    part["baud"] = int(ask.number(f"{name}_baud", "Its baud rate", 300, 4_000_000, 9600))
    part["unit"] = ask.text(f"{name}_unit", "Unit of lines without one: g, N, or counts", "g")
    part["ask"] = ask.text(f"{name}_ask", "What asks it for a line, such as SI; empty if it sends", "")
    part["rate_hz"] = ask.number(f"{name}_rate_hz", "Lines a second", 0.1, 1000.0, 10.0)
    part["delay_s"] = ask.number(
        f"{name}_delay_s", "Seconds from a change of force until it is printed in full", 0.0, 30.0, 0.4
    )
    find = _count if part["unit"] == "counts" else _compared
    made.say(f"scale at {part['port']}: {find(made, name, part)}")
    return part


def _count(made: SetUp, name: str, part: dict[str, Any]) -> str:
    """Find the force of one count, by a known weight."""
    mass_g = made.answers.number(f"{name}_mass_g", "Known weight for the scale [g]", 0.1, 50_000.0)
    counted = {**part, "count_N": 1.0, "range_N": ALL_COUNTS}
    counts, share = _weight_change(made, name, counted, mass_g)
    expected_n = mass_g * 1e-3 * G_M_S2
    part["count_N"] = count_n = float(f"{expected_n / counts:.6g}")
    part["range_N"] = made.answers.number(
        f"{name}_range_N", "Greatest force that the cell bears [N]", 0.01, abs(count_n) * ALL_COUNTS
    )
    return (
        f"{counts:.0f} counts of {expected_n:.3f} N, so {count_n:.6g} N a count +- {100 * share:.2g} % (95 %)"
    )


def _compared(made: SetUp, name: str, part: dict[str, Any]) -> str:
    """Compare a printed unit with a known weight, where there is one."""
    ask = made.answers
    part["range_N"] = ask.number(f"{name}_range_N", "Greatest force that it measures [N]", 0.01, 1e4, 50.0)
    mass_g = ask.number(f"{name}_mass_g", "Known weight for the scale [g]; 0 for none", 0.0, 50_000.0, 0.0)
    if mass_g == 0:
        made.open("force", part).close()
        return "it prints lines that can be read; its scale was not compared with a weight"
    read_n, share = _weight_change(made, name, part, mass_g)
    expected_n = mass_g * 1e-3 * G_M_S2
    words = f"it printed {read_n:.4g} N for {expected_n:.4g} N"
    if abs(read_n / expected_n - 1.0) > max(ALLOWED_SHARE, share):
        raise InputError(f"{words}: calibrate it, or correct its unit", code="weight-differs")
    return f"{words}, within {100 * max(ALLOWED_SHARE, share):.2g} %"


def _weight_change(made: SetUp, name: str, part: dict[str, Any], mass_g: float) -> tuple[float, float]:
    """Change that a known weight makes, and the half-width of its share, for 95 %."""
    if part["unit"] != "counts" and mass_g * 1e-3 * G_M_S2 > part["range_N"]:
        raise RangeError(f"{mass_g:g} g weigh more than the {part['range_N']:g} N of its range")
    with closing(made.open("force", part)) as sensor:
        before, noise = _mean_of_lines(sensor, made.clock, part)
        if not made.answers.confirm(f"{name}_weight_lies", f"Lay {mass_g:g} g on the scale; does it rest"):
            raise InputError("the weight was not laid on the scale; begin anew")
        made.clock.sleep(SETTLE_DELAYS * part["delay_s"])
        after, noise_after = _mean_of_lines(sensor, made.clock, part)
    spread = 2.0 * math.hypot(noise, noise_after)
    if abs(after - before) <= MIN_SIGMAS / 2.0 * spread or after == before:
        raise InputError(
            f"the weight changed the scale's reading by {after - before:.4g}, under a noise of {spread:.2g}: "
            "it is not felt; see to the cell's wires, or take a heavier weight"
        )
    return after - before, math.hypot(spread / abs(after - before), LOCAL_G_SHARE)


def _mean_of_lines(sensor: ForceSensor, clock: Clock, part: dict[str, Any]) -> tuple[float, float]:
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


def _label(made: SetUp) -> None:
    """A second sensor, which labels and guards nothing."""
    kind = made.answers.text(
        "label_kind", "Second force sensor, which only labels: serial-scale, or none", "none"
    )
    if kind == "none":
        return
    if kind != "serial-scale":
        raise InputError(f"label_kind is {kind!r}; give serial-scale or none")
    made.fields["label_force"] = _ask_scale(made, "label")


def _camera(made: SetUp) -> None:
    kind = made.answers.text("camera_kind", "Camera: uvc, or module:Class of your own", "uvc")
    if kind != "uvc":
        part = {"kind": kind, **_options(made, "camera_options")}
        made.say(_tried(made, part))
    else:
        listed = video_devices()
        wanted = made.answers.ask(
            "camera_address", "Cameras to try, by path or number, as a list", listed or [0]
        )
        addresses = list(wanted) if isinstance(wanted, list) else [wanted]
        rate_hz = made.answers.number("camera_rate_hz", "Frames a second", 0.1, 1000.0, 30.0)
        working = []
        for address in addresses:
            part = {"kind": "uvc", "address": address, "rate_hz": rate_hz}
            try:
                made.say(_tried(made, part))
                working.append(part)
            except PalpateError as e:
                made.say(f"camera {address}: {e}")
        if len(working) != 1:
            raise DeviceError(
                f"{len(working)} cameras gave frames of {len(addresses)} that were tried; one is needed. "
                "Name it alone as camera_address"
            )
        (part,) = working
    made.fields["camera"] = part


def _tried(made: SetUp, part: dict[str, Any]) -> str:
    with closing(made.open("camera", part)) as camera:
        times_ns = frame_times(camera, made.clock, CAMERA_S)
        rate_hz = (len(times_ns) - 1) * NS_PER_S / max(times_ns[-1] - times_ns[0], 1)
        named = part.get("address", part["kind"])
        said = f"camera {named}: {rate_hz:.1f} frames/s of {camera.rate_hz:g} stated"
        if rate_hz < CAMERA_SLOW * camera.rate_hz:
            said += f": too slow; state rate_hz = {rate_hz:.0f}, or give it more light and a free port"
        return said


def _limits(made: SetUp, found: FoundStage) -> None:
    boxes: tuple[Three | None, Three | None] = (None, None)
    if found.homing and found.travel_m is not None:
        low, high = found.travel_m
        boxes = (_mm(low), _mm(high))
    words = ("Soft limits of the stage, least, in its frame", "Soft limits, greatest; z is the deepest")

    def least_mm() -> Three:
        least = made.answers.three("least_mm", words[0], boxes[0])
        return _inside(least, boxes)

    def greatest_mm() -> Three:
        greatest = _inside(made.answers.three("greatest_mm", words[1], boxes[1]), boxes)
        _check_above(least, greatest)
        return greatest

    least = made.answers.until_good(least_mm)
    greatest = made.answers.until_good(greatest_mm)
    if not found.homing:
        made.fields["stage"] |= {"least_mm": list(least), "greatest_mm": list(greatest)}
    range_n = made.fields.pop("_range_n")
    most_n = min(MAX_LIMITS["force_N"], range_n)
    force_n = made.answers.number(
        "force_N", "Greatest force [N]", 0.1, most_n, min(PROPOSED_N, RANGE_SHARE * range_n)
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


def _weight(made: SetUp) -> None:
    if (
        made.fields["force"]["kind"] == "serial-scale"
    ):  # its count was found by a weight, or its unit compared
        return
    mass_g = made.answers.number("mass_g", "Known weight for the force sensor [g]; 0 for none", 0.0, 5000.0)
    if mass_g == 0:
        made.unchecked.append("the scale of the force: no known weight was laid on")
        return
    tolerance_g = made.answers.number(
        "mass_tolerance_g", "How well it is known [g]", 0.0, mass_g, 0.01 * mass_g
    )
    part = made.fields["force"]

    def lay() -> None:
        if not made.answers.confirm("weight_lies", f"Lay or hang {mass_g:g} g on the sensor; does it rest"):
            raise InputError("the weight was not laid on; begin anew, or answer mass_g = 0")

    with closing(made.open("force", part)) as sensor:
        found = weigh(sensor, part["axes"][2], made.clock, mass_g, tolerance_g, lay)
    _take_scale(made, part, found)
    today = datetime.now(UTC).date().isoformat()
    made.fields["known_weight"] = {"measured_on": today, "mass_g": mass_g, "factor": round(found.factor, 5)}
    if not made.answers.confirm("weight_off", "Take the weight off again; is it off", True):
        raise InputError("the weight has to be off before anything moves; begin anew")


def _take_scale(made: SetUp, part: dict[str, Any], found: WeighingResult) -> None:
    words = (
        f"the weight is {found.expected_n:.3f} N, and {found.read_n:.3f} N were read: a factor of "
        f"{found.factor:.4f} +- {found.uncertainty:.4f} (95 %)"
    )
    made.say(words)
    if found.agrees:
        return
    if not 0.1 <= found.factor <= 10.0:
        raise InputError(f"{words}; factors from 0.1 to 10 are written: see to the sensor's unit and wiring")
    if not made.answers.confirm("write_scale", f"{words}. Write it as the sensor's scale", False):
        raise InputError(f"{words}; it was not accepted, and nothing is written: see to the sensor")
    part["scale"] = round(found.factor, 5)
    part["scale_uncertainty"] = round(found.uncertainty, 5)


def _check(out: Path, made: SetUp, *, known: bool) -> None:
    position: PositionFrom = "stored"
    if not (known or made.fields["stage"].get("home")):
        if not made.answers.confirm("still_there", "Is the stage where the touch left it, not pushed since"):
            made.unchecked.append("the rig's check: the stage's position was not confirmed")
            return
        position = "reference"
    made.say("checking the rig; the stage moves by 2 mm")
    try:
        rig = open_rig(str(out), supervised=False, position=position)
    except PalpateError as e:
        raise DeviceError(
            f"{out} is written, and could not be opened for its check ({e}). Where the board resets as its "
            "port is opened, set home = true in [stage]; then palpate rig check"
        ) from e
    made.checks = check_rig(rig)


def _validated(fields: dict[str, Any]) -> RigFile:
    try:
        return RigFile.model_validate({name: value for name, value in fields.items() if name[0] != "_"})
    except ValidationError as e:
        problems = "; ".join(f"{'.'.join(map(str, d['loc']))}: {d['msg']}" for d in e.errors())
        raise InputError(f"what was answered makes no rig's file: {problems}") from e


def _options(made: SetUp, name: str) -> dict[str, Any]:
    options = made.answers.ask(name, 'Its options, as {"port": "/dev/ttyUSB1"}', {})
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
