"""Conformance checks of what a user brings: a sensor, a model, a device's driver, a whole rig.

`check_sensor` and its laws are here; the checks of the other kinds stand with what they check and load when
they are first used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from palpate.core import (
    Contact,
    Float,
    InputError,
    PalpateError,
    Pose,
    Probe,
    RangeError,
    Sensor,
    Specimen,
    ndarray,
)
from palpate.core.sensor import contract_faults, force_law, frame_faults, untouched
from palpate.devices.check.interface_check import CheckResult, at_most, describe, judge, refusal, verdict
from palpate.rig.plans.plan_files import plan_from

if TYPE_CHECKING:
    from palpate.calibration.model_check import check_model
    from palpate.devices.check import check_arm, check_camera, check_display, check_force_sensor, check_stage
    from palpate.rig.rig_check import check_rig

_NAMES = {
    "palpate.calibration.model_check": ("check_model",),
    "palpate.devices.check": (
        "check_arm",
        "check_camera",
        "check_display",
        "check_force_sensor",
        "check_stage",
    ),
    "palpate.rig.rig_check": ("check_rig",),
}

__all__ = [
    "LAWS",
    "CheckResult",
    "check_arm",
    "check_camera",
    "check_display",
    "check_force_sensor",
    "check_model",
    "check_rig",
    "check_sensor",
    "check_stage",
]

DEPTHS = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)  # of the known depth
HALF = 0.5
INTEGRAL = 0.03  # by which the pressure's integral may miss the force: a coarse grid's
SAME_LAW = 0.03  # by which a force law may miss a press, read between its knots
BEYOND_NOISE = 2.0  # times as different as two frames of one skin
MAX_M, MAX_N, MAX_PA = 0.5, 1e4, 1e10  # of anything that a sensor for touch may say
ASIDE = 0.25  # of the room that a probe has along an axis, by which it is moved to see the contact move
PLACES_TRIED = 401  # places along an axis at which the probe is tried for room
LIGHT = (0.05, 0.1, 0.2, HALF)  # of the known depth: presses that are tried to see a contact move
NOT_NOISE = 5.0  # times the noise, from which a pixel's change is counted
SAME_SCALE = 0.5  # by which the distance of a contact's motion may miss that of the axes
ALIGNED = 0.7  # cosine of the angle between where it moves and where the axes say, at least
FRAMES = 4  # whose mean is looked at, so that noise counts less
BEYOND = 1e-3  # of the known depth, by which a press asked for is deeper

Part = Iterator[CheckResult]


def check_sensor(sensor: Sensor) -> list[CheckResult]:
    """Check a sensor against every law.

    Args:
        sensor: see `core.sensor.Sensor`.

    Returns:
        One result for each law, in the same order every time; those that do not hold say what to do.

    Example:
        >>> import palpate
        >>> all(one.ok for one in check_sensor(palpate.sensor("palm-debug")))
        True
    """
    faults = contract_faults(sensor)
    contract = verdict("contract", not faults, "; ".join(faults))
    if faults:
        return [contract]
    return [contract, *(one for law in LAWS for one in _run(law, sensor))]


def _run(law: Callable[[Sensor], Part], sensor: Sensor) -> Part:
    """Run a law; what it raises is one more finding that does not hold."""
    try:
        yield from law(sensor)
    except Exception as e:  # whatever a stranger's sensor raises is reported
        code = law.__name__.replace("_", "-")
        yield verdict(code, False, f"{type(e).__name__}: {e}")


def _press(sensor: Sensor, share: float, x_m: float = 0.0, y_m: float = 0.0) -> Contact:
    """The sensor under its own probe, at a share of the depth that it knows."""
    probe, specimen = _own(sensor)
    depth_m = share * sensor.known_depth_m(probe, specimen)
    return sensor.press(probe, Pose(x_m, y_m, depth_m), specimen)


def _own(sensor: Sensor) -> tuple[Probe, Specimen | None]:
    return sensor.probe(sensor.default_probe), sensor.specimen(sensor.default_probe)


def _mean_image(sensor: Sensor, contact: Contact, seed: int = 0) -> Float[ndarray, "h w"]:
    """Mean of some frames, grey."""
    rng = np.random.default_rng(seed)
    frames = [sensor.render(contact, rng).image.astype(float) for _ in range(FRAMES)]
    mean = np.mean(frames, axis=0)
    return mean if mean.ndim == 2 else mean.mean(axis=2)


def at_rest(sensor: Sensor) -> Part:
    """A sensor at rest feels no force, and its frame is as stated."""
    faults = frame_faults(sensor)
    yield verdict("at-rest", not faults, "; ".join(faults))


def force_grows(sensor: Sensor) -> Part:
    """Force grows with depth as far as it is known."""
    force = [0.0, *(_press(sensor, share).force_n for share in DEPTHS)]
    least = float(np.diff(force).min())
    yield judge(
        "force-grows", least > 0, least, 0.0, "N",
        f"forces {force} N at {[0.0, *DEPTHS]} of the known depth; each is greater than the one before",
    )  # fmt: skip


def pressure_integral(sensor: Sensor) -> Part:
    """Pressure integrates to the force."""
    contact = _press(sensor, HALF)
    cell = (contact.x_m[1] - contact.x_m[0]) * (contact.y_m[1] - contact.y_m[0])
    whole = float(contact.pressure_pa.sum() * cell)
    off = abs(whole / contact.force_n - 1)
    yield at_most(
        "pressure-integral", off, INTEGRAL, "",
        f"its integral is {whole:g} N and the force {contact.force_n:g} N; are all in Pa, m and N?",
    )  # fmt: skip


def press_plausible(sensor: Sensor) -> Part:
    """A press returns what is finite, shaped and in SI."""
    contact = _press(sensor, HALF)
    grid = (len(contact.y_m), len(contact.x_m))
    fields = {
        name: np.asarray(getattr(contact, name)) for name in ("pressure_pa", "displacement_m", "touching")
    }
    wrong = [
        f"{name} is {list(a.shape)}, the grid {list(grid)}" for name, a in fields.items() if a.shape != grid
    ]
    lengths = [contact.x_m, contact.y_m, contact.displacement_m, contact.radius_m]
    for what, values, most in (
        ("lengths [m]", lengths, MAX_M),
        ("forces [N]", [contact.force_n, *contact.lateral_n], MAX_N),
        ("pressures [Pa]", [contact.pressure_pa], MAX_PA),
    ):
        greatest = max(float(np.abs(np.asarray(value)).max()) for value in values)
        if not greatest <= most:
            wrong.append(f"{what} up to {greatest:g}; no touch goes beyond {most:g}")
    if not (contact.radius_m > 0 and np.asarray(contact.touching).any()):
        wrong.append("a press at half the known depth touches nothing")
    yield verdict("press-plausible", not wrong, "; ".join(wrong))


def contact_origin(sensor: Sensor) -> Part:
    """A contact says what made it."""
    probe, specimen = _own(sensor)
    contact = _press(sensor, HALF)
    pose = Pose(0.0, 0.0, HALF * sensor.known_depth_m(probe, specimen))
    same = (contact.probe, contact.pose, contact.specimen) == (probe, pose, specimen)
    yield verdict(
        "contact-origin",
        same,
        f"asked {probe} at {pose}, answered {contact.probe}, {contact.pose}",
    )


def force_law_agrees(sensor: Sensor) -> Part:
    """The force law is that of its presses."""
    law = force_law(sensor, *_own(sensor))
    presses = [_press(sensor, share) for share in DEPTHS]
    read = np.interp([one.pose.depth_m for one in presses], law.depth_m, law.force_n)
    off = float(np.abs(read / [one.force_n for one in presses] - 1).max())
    yield at_most(
        "force-law-agrees", off, SAME_LAW, "",
        f"between them lie {100 * off:.1f} %; let force_law() read what press() gives, or leave it out",
    )  # fmt: skip


def depth_refused(sensor: Sensor) -> Part:
    """Beyond the known depth a press is refused."""
    error = refusal(partial(_press, sensor, 1 + BEYOND))
    yield verdict(
        "depth-refused", isinstance(error, RangeError),
        f"a press a thousandth deeper than known {describe(error)}; raise RangeError",
    )  # fmt: skip


def frames_reproducible(sensor: Sensor) -> Part:
    """The same rng draws the same frame."""
    contact = _press(sensor, HALF)
    one, other = (sensor.render(contact, np.random.default_rng(3)).image for _ in range(2))
    yield verdict(
        "frames-reproducible", np.array_equal(one, other),
        "two frames of one contact and one seed differ; draw all chance from the rng that is given",
    )  # fmt: skip


def press_visible(sensor: Sensor) -> Part:
    """A press is seen beyond the noise."""
    rest, contact = untouched(sensor), _press(sensor, HALF)
    noise = _rms(_mean_image(sensor, rest, 1) - _mean_image(sensor, rest, 2))
    change = _rms(_mean_image(sensor, contact, 3) - _mean_image(sensor, rest, 1))
    yield judge(
        "press-visible", change > BEYOND_NOISE * noise, change, BEYOND_NOISE * noise, "",
        f"a press changes the frame by {change:.3g} grey levels, noise by {noise:.3g}",
    )  # fmt: skip


def image_axes(sensor: Sensor) -> Part:
    """A contact moves in the image as the axes say."""
    motions = _motions(sensor)
    worst = min(motions, key=lambda motion: motion.cosine)
    yield judge(
        "image-axes", worst.cosine >= ALIGNED, worst.cosine, ALIGNED, "",
        f"{worst}; {_stated(sensor)}",
    )  # fmt: skip


def image_scale(sensor: Sensor) -> Part:
    """A contact moves in the image as far as the axes say.

    A patch of light moves by 0.99 to 1.01 of what is stated. Among markers the centroid lags behind, since
    those that a contact moves little stand where they are and weigh too: the TacTip's moves by 0.65 to 0.75.
    So a half is tolerated either way, and axes that are wrong by a factor of 3 or more do not pass.
    """
    worst = max(_motions(sensor), key=lambda motion: abs(motion.share - 1))
    off = abs(worst.share - 1)
    yield at_most(
        "image-scale", off, SAME_SCALE, "",
        f"{worst}, {worst.share:.3g} times as far as stated; {_stated(sensor)}; are they in px/m?",
    )  # fmt: skip


def plan_inside(sensor: Sensor) -> Part:
    """Its outline holds its own plan's places."""
    outline, message = sensor.outline, ""
    try:
        plan = plan_from(sensor.default_plan(), sensor)
        outside = [
            place.name
            for place in plan.places.places()
            if not outline.contains(place.x_mm * 1e-3, place.y_mm * 1e-3, _own(sensor)[0].radius_m)
        ]
        message = f"at {', '.join(outside)} its probe reaches over the outline" if outside else ""
        for words in plan.indenters:
            sensor.probe(words)
    except PalpateError as e:
        message = f"its plan is refused: {e}"
    yield verdict("plan-inside", not message, message)


def rectified_size(sensor: Sensor) -> Part:
    """A rectified frame has the size it states."""
    frame = sensor.render(untouched(sensor), np.random.default_rng(0))
    height, width = sensor.rectify(frame).image.shape[:2]
    yield verdict(
        "rectified-size", (width, height) == sensor.rectified_px,
        f"{width} x {height} px, and it states {sensor.rectified_px[0]} x {sensor.rectified_px[1]} px",
    )  # fmt: skip


def probe_refused(sensor: Sensor) -> Part:
    """Words that are no probe are refused."""
    error = refusal(partial(sensor.probe, "no such probe"))
    yield verdict(
        "probe-refused", isinstance(error, InputError),
        f"probe('no such probe') {describe(error)}; raise InputError and say what there is",
    )  # fmt: skip


LAWS: tuple[Callable[[Sensor], Part], ...] = (
    at_rest,
    force_grows,
    pressure_integral,
    press_plausible,
    contact_origin,
    force_law_agrees,
    depth_refused,
    frames_reproducible,
    press_visible,
    image_axes,
    image_scale,
    plan_inside,
    rectified_size,
    probe_refused,
)


def _rms(difference: ndarray) -> float:
    return float(np.sqrt(np.mean(difference**2)))


class _Motion(NamedTuple):
    """Motion of a contact in the image when it is moved over the skin.

    Attributes:
        by_m: over the skin, along x and y [m].
        stated_px, seen_px: columns and rows by the axes, and as they are seen [px].
    """

    by_m: tuple[float, float]
    stated_px: Float[ndarray, 2]
    seen_px: Float[ndarray, 2]

    @property
    def share(self) -> float:
        """Distance seen over the stated one."""
        return float(np.hypot(*self.seen_px) / np.hypot(*self.stated_px))

    @property
    def cosine(self) -> float:
        """Cosine of the angle between the way seen and the stated one."""
        whole = max(np.hypot(*self.seen_px) * np.hypot(*self.stated_px), 1e-12)
        return float(self.seen_px @ self.stated_px / whole)

    def __str__(self) -> str:
        x_m, y_m = self.by_m
        return f"moved by ({1e3 * x_m:.3g}, {1e3 * y_m:.3g}) mm it moves by {self.seen_px} px"


def _stated(sensor: Sensor) -> str:
    axes = sensor.axes
    return f"the axes of {axes.region!r} say {axes.across} and {axes.down} px/m"


def _motions(sensor: Sensor) -> list[_Motion]:
    """Motions of a contact along x and y, of which the axes may state no more than one as not seen.

    Raises:
        InputError: the axes state neither, the probe has no room, or no press is seen.
    """
    one, other = (_region(sensor, untouched(sensor), seed) for seed in (1, 2))
    rest, noise = one, _rms(one - other)
    share, motions = _faintest(sensor, rest, noise), []
    for way in ((1.0, 0.0), (0.0, 1.0)):
        room_m = ASIDE * _room_m(sensor, way)
        x_m, y_m = room_m * way[0], room_m * way[1]
        stated_px = np.array(sensor.axes.moved_px(2 * x_m, 2 * y_m))
        if not stated_px.any():
            continue
        before, after = (
            _centroid(_change(sensor, _press(sensor, share, side * x_m, side * y_m), rest, noise))
            for side in (-1, 1)
        )
        motions.append(_Motion((2 * x_m, 2 * y_m), stated_px, after - before))
    if not motions:
        raise InputError(f"{_stated(sensor)}; state by how much a contact moves", code="axes-unstated")
    return motions


def _room_m(sensor: Sensor, way: tuple[float, float]) -> float:
    """The farthest from the skin's centre, to either side, at which the probe lies on the outline [m]."""
    outline, radius_m = sensor.outline, _own(sensor)[0].radius_m
    (x, y), tried = way, np.linspace(0.0, outline.radius_m, PLACES_TRIED)
    held = [t for t in tried if all(outline.contains(s * t * x, s * t * y, radius_m) for s in (-1, 1))]
    if not held or held[-1] == 0:
        raise InputError(
            f"the probe of {1e3 * radius_m:.3g} mm radius has no room to move on the outline", code="no-room"
        )
    return float(held[-1])


def _faintest(sensor: Sensor, rest: ndarray, noise: float) -> float:
    """The share of the known depth whose press is seen well, of `LIGHT`: the lighter, the more local it is.

    Raises:
        InputError: none is seen in the region of the axes.
    """
    for share in LIGHT:
        if _rms(_region(sensor, _press(sensor, share), 3) - rest) > BEYOND_NOISE * noise:
            return share
    region = sensor.axes.region
    raise InputError(f"no press is seen in {region!r}; name another region", code="press-not-seen")


def _region(sensor: Sensor, contact: Contact, seed: int) -> Float[ndarray, "h w"]:
    x, y, w, h = sensor.regions()[sensor.axes.region]
    return _mean_image(sensor, contact, seed)[y : y + h, x : x + w]


def _change(sensor: Sensor, contact: Contact, rest: ndarray, noise: float) -> Float[ndarray, "h w"]:
    """Change against the untouched region, where it is none of noise."""
    change = _region(sensor, contact, 3) - rest
    return np.where(np.abs(change) > NOT_NOISE * noise, change, 0.0)


def _centroid(change: ndarray) -> Float[ndarray, 2]:
    """Centroid of what has changed: column and row, weighed by the square of the change.

    Raises:
        InputError: nothing has.
    """
    weight = change**2
    if not weight.any():
        raise InputError("a press beside the skin's centre is not seen; is it drawn where the pose says?")
    y, x = np.mgrid[: weight.shape[0], : weight.shape[1]]
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


if not TYPE_CHECKING:  # mypy accepts only the names imported above

    def __getattr__(name: str) -> object:
        """Return a public name, imported on first use."""
        for module, names in _NAMES.items():
            if name in names:
                return getattr(import_module(module), name)
        raise AttributeError(f"palpate.check has no {name!r}; it has {', '.join(__all__)}")
