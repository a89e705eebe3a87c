"""Sensors by name: built in, by another package, and what is refused by which law."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.installed_packages import lay_package
from tests.refusals import refused

import palpate
from palpate.core.contact import Outline, Pose, Specimen
from palpate.core.errors import InputError, RangeError
from palpate.core.sensor import SENSORS, sensor

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Lay a package with an entry point on the path, as an installer does."""

    def lay(name: str, value: str, code: str = "", package: str = "stranger") -> None:
        (tmp_path / f"{package}.py").write_text(code)
        lay_package(tmp_path, package, "palpate.sensors", name, value)
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.delitem(sys.modules, package, raising=False)

    return lay


def test_built_in_sensors_are_found_by_name_and_preset() -> None:
    assert SENSORS.names()[:2] == ("palm", "tactip")
    assert palpate.sensor("palm").name == "palm"
    assert palpate.sensor("palm-small").frame_px == (480, 270)
    assert palpate.sensor("tactip-331").spec.pins.count == 331


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("hand", "unknown-name"),
        ("palm-huge", "unknown-name"),
        ("tactip-12", "pin-count"),
        ("tactip-soft", "unknown-name"),
        ("nowhere.at.all:make", "plugin-import"),
        ("palpate.core:VERSION", "plugin-import"),
        ("palpate.core.sensor:SEATED", "not-callable"),
    ],
)
def test_a_name_that_is_none_is_refused(name: str, code: str) -> None:
    with refused(code, InputError):
        sensor(name)


def test_a_sensor_of_another_package_is_found_and_one_without_a_name_by_its_path(install: Install) -> None:
    code = "from palpate.sensors.palm.palm_sensor import palm\ndef make(): return palm('debug')\n"
    install("strange", "stranger:make", code)
    assert "strange" in SENSORS.names()
    assert sensor("strange").name == "palm-debug"
    assert sensor("stranger:make").name == "palm-debug"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("import nothing_of_that_name", "plugin-import"),
        ("def make(): raise OSError('no disk')", "plugin-import"),
        ("import sys\ndef make(): sys.exit(0)", "plugin-import"),
        ("class make: name = 'x'", "contract-broken"),
    ],
)
def test_a_sensor_that_cannot_be_one_is_refused_by_name_and_law(
    install: Install, text: str, code: str
) -> None:
    install("strange", "stranger:make", text)
    with refused(code, InputError):
        sensor("strange")


def test_a_name_that_is_taken_is_refused_and_both_are_named(install: Install) -> None:
    install("palm", "stranger:make", "def make(): return None")
    with refused("name-taken", InputError, match="stranger:make"):
        sensor("palm")


def test_a_disc_a_rectangle_and_a_polygon_say_what_lies_inside() -> None:
    disc, box = Outline.disc(20e-3), Outline.rectangle(20e-3, 10e-3)
    triangle = Outline.polygon(((-10e-3, -5e-3), (10e-3, -5e-3), (0.0, 5e-3)))
    assert disc.contains(5e-3, 0.0, 5e-3)
    assert not disc.contains(5.01e-3, 0.0, 5e-3)
    assert box.contains(0.0, 2e-3, 3e-3)
    assert not box.contains(0.0, 2e-3, 3.01e-3)
    assert triangle.contains(0.0, 0.0, 2e-3)
    assert not triangle.contains(0.0, 4e-3, 2e-3)
    assert box.radius_m == pytest.approx(125**0.5 * 1e-3)
    with pytest.raises(InputError, match="convex"):
        Outline.polygon(((0.0, 0.0), (0.0, 1.0), (1.0, 0.0)))


def test_a_polygon_goes_once_around_the_skins_centre() -> None:
    turns = [math.tau * i / 5 for i in range(5)]
    pentagon = tuple((math.cos(turn), math.sin(turn)) for turn in turns)
    pentagram = tuple(pentagon[2 * i % 5] for i in range(5))
    assert Outline.polygon(pentagon).clearance_m(0.0, 0.0) == pytest.approx(math.cos(math.pi / 5))
    with refused("polygon-crosses", InputError):
        Outline.polygon(pentagram)
    with refused("polygon-center", InputError):
        Outline.polygon(tuple((x + 2.0, y) for x, y in pentagon))


@pytest.mark.parametrize(
    "code",
    [
        "from dataclasses import dataclass\n@dataclass\nclass make:\n    spec: int = 3\n",
        "def make(): return None",
        "def make(size='large'): return None",
    ],
)
def test_a_preset_is_refused_where_the_factory_takes_none(install: Install, code: str) -> None:
    install("strange", "stranger:make", code)
    with refused("preset-unknown", InputError, match="'strange'"):
        sensor("strange-small")


def test_specimens_are_read_from_words() -> None:
    assert Specimen.parse("S1=7.6") == Specimen("S1", 7600.0)
    assert Specimen.parse("new=5.3?") == Specimen("new", 5300.0)
    for words in ("", "soft", "=3", "S1=", "S1=-1", "S1=nan"):
        with pytest.raises(InputError, match="no specimen"):
            Specimen.parse(words)


def test_a_specimen_that_yields_takes_less_force_at_the_same_approach() -> None:
    tip = sensor("tactip")
    force = [
        tip.press(tip.probe(words), Pose(0.0, 0.0, 4e-3), tip.specimen(words)).force_n
        for words in ("rigid", "S1=7.6", "S3=1.1")
    ]
    assert force[0] > force[1] > force[2] > 0
    with refused("soft-specimen", RangeError):
        sensor("palm-debug").press(
            sensor("palm-debug").probe("sphere:10"), Pose(0.0, 0.0, 1e-3), Specimen("S1", 7600.0)
        )
