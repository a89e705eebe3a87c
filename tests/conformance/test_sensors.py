"""Every registered sensor keeps the laws of the contract; for each law there is a sensor that breaks it."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from tests.refusals import refused
from tests.slow_params import mostly_slow

from palpate.check import LAWS, SAME_SCALE, check_sensor, image_axes, image_scale
from palpate.core.contact import Contact, Outline, Pose
from palpate.core.errors import InputError, RangeError
from palpate.core.frame import Frame
from palpate.core.sensor import SENSORS, ImageAxes, Sensor, contract_faults, for_rig, sensor
from palpate.rig.virtual import virtual_rig
from palpate.sensors import palm
from palpate.sensors.palm.palm_sensor import Palm

SMALL = {"palm": "palm-debug"}  # a tenth of the pixels each way is the same design


@pytest.mark.parametrize("name", SENSORS.names())
def test_every_registered_sensor_keeps_every_law(name: str) -> None:
    findings = check_sensor(sensor(SMALL.get(name, name)))
    assert [one for one in findings if not one.ok] == []
    assert len(findings) == len(LAWS) + 1
    (scale,) = [one.measured for one in findings if one.code == "image-scale"]
    assert scale is not None
    assert scale < 0.75 * SAME_SCALE, "within the tolerance with margin"


@pytest.mark.slow
@pytest.mark.parametrize("name", SENSORS.names())
@pytest.mark.cases(1)
def test_a_sensor_at_the_size_of_a_rig_keeps_every_law(name: str) -> None:
    assert [one for one in check_sensor(for_rig(sensor(name))) if not one.ok] == []


class Broken:
    """A sound sensor in which some things are otherwise."""

    def __init__(self, sound: Sensor, **otherwise: Any) -> None:
        self._sound = sound
        self.__dict__.update(otherwise)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sound, name)


SOUND = Palm(palm.debug())


def contact_with(change: Callable[[Contact], dict[str, Any]]) -> dict[str, Any]:
    """A press whose contact is otherwise."""

    def press(*args: Any, **kwargs: Any) -> Contact:
        made = SOUND.press(*args, **kwargs)
        return replace(made, **change(made))

    return {"press": press}


def frame_with(change: Callable[[np.ndarray, Contact], np.ndarray]) -> dict[str, Any]:
    """A picture that is otherwise."""

    def render(contact: Contact, rng: np.random.Generator, *rest: Any) -> Frame:
        frame = SOUND.render(contact, rng, *rest)
        return replace(frame, image=np.ascontiguousarray(change(frame.image, contact)))

    return {"render": render}


def shallow(*args: Any, **kwargs: Any) -> Contact:
    """What is deeper than is known is pressed as deep as is known."""
    probe, pose, *rest = args
    known = SOUND.known_depth_m(probe)
    return SOUND.press(probe, replace(pose, depth_m=min(pose.depth_m, known)), *rest, **kwargs)


def by_chance(contact: Contact, rng: np.random.Generator, *rest: Any) -> Frame:
    """Noise of its own."""
    return SOUND.render(contact, np.random.default_rng(), *rest)


def any_probe(words: str) -> Any:
    try:
        return SOUND.probe(words)
    except InputError:
        return SOUND.probe("sphere:10")


WRONG: dict[str, dict[str, Any]] = {
    "contract": {"regions": lambda: {"fringes": (0, 0, 10_000, 10), "mirror": (0, 0, 10, 10)}},
    "at-rest": frame_with(lambda image, _: image[:-1]),
    "force-grows": contact_with(lambda made: {"force_n": 2.0 * (made.pose.depth_m > 0)}),
    "pressure-integral": contact_with(lambda made: {"pressure_pa": 1.1 * made.pressure_pa}),
    "press-plausible": contact_with(
        lambda made: {"x_m": 1e3 * made.x_m, "y_m": 1e3 * made.y_m, "pressure_pa": 1e-6 * made.pressure_pa}
    ),
    "contact-origin": contact_with(lambda made: {"pose": Pose(1e-3, 0.0, made.pose.depth_m)}),
    "force-law-agrees": {
        "force_law": lambda probe, specimen=None: replace(
            SOUND.force_law(probe), force_n=1e3 * SOUND.force_law(probe).force_n
        )
    },
    "depth-refused": {"press": shallow},
    "frames-reproducible": {"render": by_chance},
    "press-visible": {
        "render": lambda contact, rng, *rest: SOUND.render(
            SOUND.press(SOUND.probe("sphere:10"), Pose(0.0, 0.0, 0.0)), rng, *rest
        )
    },
    "image-axes": {"axes": ImageAxes("mirror", (-1e3, 0.0), (0.0, 866.0))},
    "image-scale": {"axes": replace(SOUND.axes, across=tuple(px / 3 for px in SOUND.axes.across))},
    "plan-inside": {
        "outline": Outline.disc(57e-3),
        "default_plan": lambda: {"kind": "listed", "places": {"kind": "listed", "at_mm": [[26.0, 0.0]]}},
    },
    "rectified-size": {"rectified_px": (100, 50)},
    "probe-refused": {"probe": any_probe},
}


def test_a_broken_sensor_is_known_for_every_law() -> None:
    names = [one.code for one in check_sensor(SOUND)]
    assert sorted(names) == sorted(WRONG)


@pytest.mark.parametrize("law", WRONG)
@pytest.mark.cases(8)
def test_a_sensor_that_breaks_a_law_is_found_out_by_it(law: str) -> None:
    findings = {one.code: one for one in check_sensor(Broken(SOUND, **WRONG[law]))}
    assert not findings[law].ok
    assert findings[law].message


def scaled(axes: ImageAxes, across: float, down: float) -> ImageAxes:
    """Axes that state other distances in the same directions."""
    (xx, xy), (yx, yy) = axes.across, axes.down
    return replace(axes, across=(across * xx, across * xy), down=(down * yx, down * yy))


SMALL_ONES = [sensor(SMALL.get(name, name)) for name in SENSORS.names()]


@pytest.mark.parametrize("sound", SMALL_ONES, ids=lambda sound: sound.name)
@pytest.mark.parametrize(
    ("across", "down"),
    mostly_slow([(1 / 3, 1.0), (1.0, 1 / 5), (3.0, 1.0), (1.0, 5.0)], lambda i: i % 3 == 0),
)
@pytest.mark.cases(1)
def test_axes_of_another_scale_are_found_out(sound: Sensor, across: float, down: float) -> None:
    (finding,) = image_scale(cast(Sensor, Broken(sound, axes=scaled(sound.axes, across, down))))
    assert finding.code == "image-scale"
    assert not finding.ok
    way = r"moved by \(0, " if across == 1 else r", 0\) mm it moves"
    assert re.search(way, finding.message)


@pytest.mark.parametrize(
    ("otherwise", "code"),
    [
        ({"axes": ImageAxes("mirror", (0.0, 0.0), (0.0, 0.0))}, "axes-unstated"),
        ({"axes": ImageAxes("corner", (1e3, 0.0), (0.0, 1e3))}, "press-not-seen"),
        ({"outline": Outline.disc(10e-3)}, "no-room"),
    ],
)
def test_axes_of_which_nothing_can_be_seen_do_not_pass(otherwise: dict[str, Any], code: str) -> None:
    regions = {**SOUND.regions(), "corner": (0, 0, 5, 5)}
    unseen = cast(Sensor, Broken(SOUND, regions=lambda: regions, **otherwise))
    assert {"image-axes", "image-scale"} <= {one.code for one in check_sensor(unseen) if not one.ok}
    with refused(code, InputError):
        list(image_axes(unseen))


def test_a_long_narrow_skin_is_pressed_within_its_outline_alone() -> None:
    pressed: list[tuple[float, float]] = []

    def press(probe: Any, pose: Pose, *rest: Any, **more: Any) -> Contact:
        pressed.append((pose.x_m, pose.y_m))
        return SOUND.press(probe, pose, *rest, **more)

    narrow = Outline.rectangle(50e-3, 12e-3)
    (finding,) = image_axes(cast(Sensor, Broken(SOUND, outline=narrow, press=press)))
    assert finding.ok
    assert all(narrow.contains(x_m, y_m, 5e-3) for x_m, y_m in pressed)
    assert max(x_m for x_m, _ in pressed) == pytest.approx(5e-3, rel=0.02)  # a quarter of its own room
    assert max(y_m for _, y_m in pressed) == pytest.approx(0.25e-3, rel=0.2)


@pytest.mark.parametrize(
    ("otherwise", "says"),
    [
        ({"frame_px": (192.0, 108)}, "frame_px is .width, height."),
        ({"rate_hz": 0.0}, "rate_hz is a number above 0 Hz"),
        ({"exposure_s": float("nan")}, "exposure_s is a number above 0 s"),
        ({"moves": "both"}, "moves is"),
        ({"spec": {"diameter_m": 1}}, "spec is a frozen dataclass"),
        ({"outline": 57e-3}, "outline is an Outline"),
        (
            {"axes": ImageAxes("top", (1, 0), (0, 1))},
            "axes are ImageAxes of one of its regions, fringes, mirror",
        ),
        ({"render": None}, "a sensor has render"),
    ],
)
def test_what_can_be_told_without_a_press_is_told_by_its_law(otherwise: dict[str, Any], says: str) -> None:
    faults = "; ".join(contract_faults(Broken(SOUND, **otherwise)))
    assert re.search(says, faults)


def test_a_rig_refuses_a_sensor_whose_frames_are_of_another_size() -> None:
    wrong = Broken(SOUND, **frame_with(lambda image, _: image[::2]))
    with refused("contract-broken", InputError, match="192"):
        virtual_rig(wrong)  # type: ignore[arg-type]


def test_a_face_that_leans_too_far_is_refused_in_degrees() -> None:
    tip = sensor("tactip")
    with pytest.raises(RangeError, match="2 degrees"):
        tip.press(tip.probe("rigid"), Pose(1e-3, 0.0, 1e-3))
