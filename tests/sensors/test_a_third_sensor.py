"""What a third sensor costs: one folder with one class and one line of metadata, and nothing else is touched.

The sensor is a square pad of soft rubber on which a ball is pressed by Hertz's law; its camera sees a patch
as bright as the pressure.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.installed_packages import lay_package
from tests.refusals import refused
from typer.testing import CliRunner

import palpate
from palpate.check import check_sensor
from palpate.cli import app
from palpate.core.errors import InputError
from palpate.recordings import Run
from palpate.rig.plans import PLANS, plan_from, plan_of, plan_of_sensor

PAD = '''
"""A square pad of rubber over a camera."""

from dataclasses import dataclass, replace

import numpy as np

from palpate.core import Contact, Frame, InputError, Pose, Probe, RangeError
from palpate.core.contact import FRESH
from palpate.core.contact import Outline
from palpate.core.sensor import SEATED, ImageAxes
from palpate.mechanics.half_space import hertz

PX_PER_M = 2000.0


@dataclass(frozen=True)
class PadSpec:
    """Side [m], modulus [Pa] and radius of the ball [m]; image of the pad alone."""

    side_m: float = 24e-3
    modulus_pa: float = 0.3e6
    ball_m: float = 4e-3
    noise: float = 1.0


@dataclass(frozen=True)
class Pad:
    """The pad of a spec."""

    spec: PadSpec = PadSpec()
    name: str = "pad"
    rate_hz: float = 30.0
    exposure_s: float = 0.01
    moves: str = "probe"
    default_probe: str = "sphere:8"

    @property
    def frame_px(self):
        side = round(self.spec.side_m * PX_PER_M)
        return side, side

    rectified_px = frame_px

    @property
    def outline(self):
        return Outline.rectangle(self.spec.side_m, self.spec.side_m)

    @property
    def axes(self):
        return ImageAxes("pad", (PX_PER_M, 0.0), (0.0, PX_PER_M))

    def regions(self):
        return {"pad": (0, 0, *self.frame_px)}

    def probe(self, words):
        if words != self.default_probe:
            raise InputError(f"the pad is pressed by {self.default_probe}, not {words!r}")
        return Probe("sphere", self.spec.ball_m)

    def specimen(self, words):
        return None

    def known_depth_m(self, probe, specimen=None, *, lateral=False):
        return 0.0 if lateral else 0.25 * probe.radius_m

    def press(self, probe, pose, specimen=None, history=FRESH):
        if pose.depth_m > self.known_depth_m(probe):
            raise RangeError(f"{1e3 * pose.depth_m:g} mm is beyond Hertz's law; press less")
        depth_m = max(pose.depth_m, 0.0)
        made = hertz.press(probe, replace(pose, depth_m=depth_m), self.spec.modulus_pa, 0.5)
        return replace(made, pose=pose, history=history)

    def render(self, contact, rng, seating=SEATED):
        width, height = self.frame_px
        x = (np.arange(width) + 0.5 - width / 2) / PX_PER_M - contact.pose.x_m
        y = (np.arange(height) + 0.5 - height / 2) / PX_PER_M - contact.pose.y_m
        a = max(contact.radius_m, 1e-9)
        peak = 1.5 * contact.force_n / (np.pi * a**2)
        bright = peak * np.sqrt(np.maximum(1 - (x**2 + y[:, None] ** 2) / a**2, 0)) / self.spec.modulus_pa
        image = seating.light * (40 + 300 * bright) + self.spec.noise * rng.standard_normal(bright.shape)
        return Frame(np.clip(image, 0, 255).astype(np.uint8), exposure_s=self.exposure_s, sensor=self.name)

    def rectify(self, frame):
        return frame

    def default_plan(self):
        return {
            "kind": "stepped",
            "name": "pad",
            "places": {"kind": "listed", "at_mm": [[0.0, 0.0]]},
            "cycles": 3,
            "depth_mm": 0.6,
            "step_mm": 0.2,
            "frames": 2,
            "reference_frames": 1,
            "taps": 0,
        }
'''


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One folder on the path, with the metadata that an installer writes."""
    site = tmp_path / "site"
    (site / "rubber_pad").mkdir(parents=True)
    (site / "rubber_pad" / "__init__.py").write_text(PAD)
    lay_package(site, "rubber_pad", "palpate.sensors", "pad", "rubber_pad:Pad")
    monkeypatch.syspath_prepend(str(site))
    return tmp_path


def test_a_sensor_of_no_name_brings_its_plans_by_its_path(installed: Path) -> None:
    path = "rubber_pad:Pad"
    pad = palpate.sensor(path)
    own = plan_of_sensor(pad)
    assert own == plan_of(path) == plan_of(path, pad) == plan_of("pad", pad)
    assert (own.name, own.indenters) == ("pad", ("sphere:8",))
    with refused("plugin-import", InputError):
        plan_of("rubber_pad:Mat")


def test_going_around_a_layer_is_refused_on_a_skin_that_is_not_round(installed: Path) -> None:
    words = ["record", "--rig", "virtual:pad", "--plan", "layer", "--out", str(installed / "run"), "--json"]
    caught = CliRunner().invoke(app, words)
    assert caught.exit_code == 2
    assert json.loads(caught.stdout)["error"]["code"] == "not-round"


def test_a_sensor_of_one_folder_is_found_checked_recorded_and_calibrated(installed: Path) -> None:
    pad = palpate.sensor("pad")
    assert [one for one in check_sensor(pad) if not one.ok] == []
    assert PLANS["pad"].indenters == ("sphere:8",)
    wide = plan_from({"places": {"kind": "grid", "per_side": 5, "pitch_mm": 6.0}}, pad)
    assert len(wide.places.places()) == 9  # the outer ones reach over the pad's edge

    run, cal = installed / "run", installed / "cal"
    recorded = CliRunner().invoke(app, ["record", "--rig", "virtual:pad", "--out", str(run), "--quiet"])
    assert recorded.exit_code == 0, recorded.output + recorded.stderr
    manifest = Run.open(run).manifest
    assert (manifest.sensor, manifest.regions) == ("virtual pad", {"pad": (0, 0, 48, 48)})
    assert not (run / "presses").exists()

    words = [
        "calibrate",
        str(run),
        "--targets",
        "force_N",
        "--model",
        "pca-ridge",
        "--size",
        "16x16",
        "--out",
        str(cal),
        "--json",
        "--quiet",
    ]
    calibrated = CliRunner().invoke(app, words)
    assert calibrated.exit_code == 0, calibrated.output + calibrated.stderr
    scores = {one["column"]: one["score"] for one in json.loads(calibrated.stdout)["targets"]}
    assert scores["force_N"]["r2"] > 0.5  # brightness is pressure: a line through pixels knows much of it
