"""The verbs of normal force: a calibration from a run of rendered presses, and a copy told by one weight."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.virtual_shears import VirtualPad
from typer.testing import CliRunner

from palpate.calibration.shear import ShearCalibration
from palpate.cli import app
from palpate.recordings import Manifest, RunWriter

LEVELS = 40
DEEPEST_M = VirtualPad().sensor.known_depth_m(VirtualPad().sensor.probe("round"))
LABELS = {"force_N": "number", "press": "text", "indenter": "text", "reference": "flag"}


def verb(*words, status=0):
    fit = ["calibrate", "--method", "shear-force"]
    result = CliRunner().invoke(
        app, [*(fit if words[0] == "fit" else ["check-weight"]), *map(str, words[1:])]
    )
    assert result.exit_code == status, result.output + result.stderr
    return result


def rendered(pad, contact, seed):
    return pad.sensor.render(contact, np.random.default_rng(seed)).image


def write_run(path, presses, labels=LABELS):
    """Three reference frames, then a frame a press at places and forces that differ."""
    pad, rng = VirtualPad(), np.random.default_rng(6)
    depths = np.linspace(0.3, 0.95, LEVELS) * DEEPEST_M
    with RunWriter.create(path, Manifest.new(sensor="nusense", labels=labels), overflow="wait") as writer:
        for i in range(3 + presses):
            x, y = rng.uniform(-1, 1, 2) * (10e-3, 8e-3)
            contact = pad.contact("round", x, y, 0.0 if i < 3 else depths[(7 * i) % LEVELS])
            about = {"force_N": contact.force_n, "press": f"{i}", "indenter": "round", "reference": i < 3}
            writer.frame(rendered(pad, contact, i), labels={k: v for k, v in about.items() if k in labels})
    return path


def calibrated_from(folder, presses):
    words = ("fit", write_run(folder / "run", presses), "--out", folder / "pad.npz", "--law", "placed")
    words = (*words, "--quiet", "--json")
    return folder / "pad.npz", json.loads(verb(*words).stdout), words


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    return calibrated_from(tmp_path_factory.mktemp("force"), 16)[:2]


@pytest.mark.slow
def test_fit_makes_a_calibration_better_than_its_baselines(tmp_path):
    out, record, words = calibrated_from(tmp_path, 36)
    assert ShearCalibration.load(out).id == record["calibration"]
    across = abs(VirtualPad().sensor.spec.lens.focal_px[0]) * 2.4 / 55  # px of a tile of 2.4 mm, 55 mm away
    assert ShearCalibration.load(out).pitch_px == pytest.approx(across, rel=0.15)
    assert record["presses"] == 36
    assert record["samples_K"] == 164**2
    assert record["mae_N"] < 0.15
    assert set(record["baselines_mae_N"]) == {
        "mean", "mean shift", "ridge on image moments", "kernel ridge on gamma and area",
        "sum of pixel change", "kernel ridge on image moments",
    }  # fmt: skip
    assert all(error > record["mae_N"] for error in record["baselines_mae_N"].values())
    before = out.read_bytes()
    assert "exists" in verb(*words, status=2).stderr
    assert out.read_bytes() == before


def test_weigh_tells_a_copys_stiffness(calibrated, tmp_path):
    out, record = calibrated
    pad = VirtualPad("8", 1)
    weight = pad.contact("round", 1e-3, 0.0, 1.3e-3)
    for name, contact in (("rest", pad.contact("round", 0.0, 0.0, 0.0)), ("on", weight)):
        (tmp_path / name).mkdir()
        for i in range(2):
            image = rendered(pad, contact, 10 + i)
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    words = ("weigh", "--with", out, "--reference", tmp_path / "rest", "--json", "--out")
    on = (tmp_path / "on", "--mass-g", f"{weight.force_n / 9.80665e-3:.2f}")
    found = json.loads(verb(*words, tmp_path / "copy.npz", *on).stdout)
    assert found["of"] == record["calibration"]
    assert found["scale"] > 1.02  # this copy is 9 % stiffer
    assert abs(found["scale"] - 1.09) < 2 * found["scale_error"] < 0.1
    nothing = (tmp_path / "rest", "--mass-g", "400")
    assert "weight" in verb(*words, tmp_path / "none.npz", *nothing, status=2).stderr
    assert not (tmp_path / "none.npz").exists()


def test_a_run_without_force_is_refused(tmp_path):
    run = write_run(tmp_path / "run", 2, {k: v for k, v in LABELS.items() if k != "force_N"})
    assert "force_N" in verb("fit", run, "--out", tmp_path / "pad.npz", "--quiet", status=2).stderr
    assert "nusense" not in verb("fit", run, "--out", tmp_path / "pad.txt", status=2).stderr
    assert not (tmp_path / "pad.npz").exists()


def test_shear_adds_newtons_with_a_calibration_and_refuses_one_of_another_lens(calibrated, tmp_path):
    out, _ = calibrated
    pad, rng = VirtualPad(), np.random.default_rng(11)
    frames = tmp_path / "frames"
    frames.mkdir()
    contacts = [pad.contact("round", 4e-3, -3e-3, depth) for depth in (0.0, 0.0, 0.65 * DEEPEST_M)]
    for i, contact in enumerate(contacts):
        image = pad.sensor.render(contact, rng).image
        cv2.imwrite(str(frames / f"{i}.png"), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    words = ["read", str(frames), "--reference", str(frames / "0.png"), "--with", str(out)]
    told = CliRunner().invoke(app, [*words, "--json", "--quiet"])
    assert told.exit_code == 0, told.output
    lines = [json.loads(line) for line in told.stdout.splitlines()]
    forces = [line["readings"]["force_N"] for line in lines]
    assert [one["valid"] for one in forces] == [False, False, True]
    assert forces[2]["value"] == pytest.approx(contacts[2].force_n, abs=0.5)
    assert forces[2]["low"] < contacts[2].force_n < forces[2]["high"]
    assert {line["calibration"] for line in lines} == {ShearCalibration.load(out).id}
    lens = tmp_path / "lens.json"
    own = ShearCalibration.load(out).lens
    replace(own, focal_px=(1.1 * own.focal_px[0], 1.1 * own.focal_px[1])).write(lens)
    other = CliRunner().invoke(app, [*words, "--lens", str(lens)])
    assert other.exit_code == 2
