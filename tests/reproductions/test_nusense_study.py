"""The NUSense thesis made again: its analyses on made-up presses, and the whole study small."""

import json
import math
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.calibration.shear import LabelledCues, TouchCues, calibrate_shear
from palpate.calibration.shear.calibrate_runs import baseline_errors, transferred_errors
from palpate.core import Reading
from palpate.core.errors import ExistsError, InputError
from palpate.estimators.lattice import ControlPoints
from palpate.sensors.nusense.nusense_sensor import FIRM_TAPS, PLANS, nusense
from palpate_reproductions.nusense import nusense_experiments, reproduce_nusense, scale_named
from palpate_reproductions.nusense.nusense_analysis import force_line, held_out_line, shuffled_r2
from palpate_reproductions.nusense.nusense_experiments import (
    arm_or_reader_holds,
    cut_seen,
    part_of,
    read_errors,
    weighed_errors,
)
from palpate_reproductions.nusense.nusense_setup import RECORDINGS, SMALL, NuSenseStudy, StudyScale
from palpate_reproductions.nusense.published_shear import published_gamma_of

FIELDS = {"name", "value", "unit", "published", "source", "why"}


def touched(gamma, force_n, press, tip="round") -> LabelledCues:
    """Labelled cues of made-up frames."""
    cues = tuple(TouchCues(float(g), math.nan, 1.0, 1.0, 0.0, 0.0, 1, 2e-3) for g in gamma)
    n = len(cues)
    tips = np.full(n, tip) if isinstance(tip, str) else np.array(tip)
    image = np.column_stack([np.asarray(gamma), *np.zeros((5, n))])
    return LabelledCues(cues, np.asarray(force_n, float), np.arange(n) / 12, np.array(press), tips, image)


def presses(slope=12.0, offset=-0.2, count=5, noise=0.0, seed=0):
    """Frames down and up again: gamma, force, press."""
    rng = np.random.default_rng(seed)
    gamma = np.tile(np.concatenate([np.linspace(0, 0.65, 12), np.linspace(0.6, 0, 8)]), count)
    press = np.repeat([f"l0/{i}" for i in range(count)], 20)
    return gamma, slope * gamma + offset + noise * rng.standard_normal(len(gamma)), press


def test_a_line_is_what_the_frames_lie_on_and_its_error_is_of_presses_left_out():
    gamma, force, press = presses(noise=0.1)
    line = force_line(gamma, force, press)
    assert_allclose((line.slope, line.offset), (12.0, -0.2), atol=0.1)
    assert_allclose(line.rms, 0.1, rtol=0.2)
    assert_allclose(line.mae, 0.1 * math.sqrt(2 / math.pi), rtol=0.2)
    assert (line.frames, line.presses) == (100, 5)
    odd = np.where(press == "l0/3", force + 5, force)  # a press unlike the others
    held = held_out_line(gamma, odd, press)
    assert_allclose((odd - held)[press == "l0/3"].mean(), 5, atol=0.1)  # is not learnt
    assert force_line(gamma[:20], force[:20], press[:20]).mae is None


def test_forces_dealt_out_anew_teach_nothing():
    gamma, force, press = presses(count=10, noise=0.1)
    assert force_line(gamma, force, press).r2 > 0.99
    assert -0.3 < shuffled_r2(gamma, force, press, 1) < 0.05


@pytest.mark.parametrize(
    ("off_mm", "half_mm", "held"),
    [(0.05, 0.0, True), (0.06, 0.0, False), (0.06, 0.04, True), (-0.06, 0.04, True), (0.08, 0.04, False)],
)
def test_an_interval_of_a_place_has_room_for_the_arm(off_mm, half_mm, held):
    """The arm is off by 0.033 mm, 0.054 mm in 90 %."""
    reading = Reading(
        quantity="x", unit="m", coverage=0.9, valid=True, why="", drift=None, calibration="", frame="",
        time_s=0.0, value=1e-3 * off_mm, low=1e-3 * (off_mm - half_mm), high=1e-3 * (off_mm + half_mm),
        calibrated_range=(-0.02, 0.02),
    )  # fmt: skip
    assert arm_or_reader_holds(reading, 0.0) is held


def test_a_weight_sets_the_scale_of_another_pad_and_is_not_scored():
    gamma, force, press = presses(count=12, offset=0.0)
    learnt = touched(gamma, force, press)
    lens = nusense().spec.lens
    marks = ControlPoints(np.array([[0, 0], [1, 0]]), np.array([[1.0, 2.0], [3.0, 4.0]]), np.ones(2))
    fit = calibrate_shear(learnt, marks, lens, 0.055, law="published")
    stiff = touched(gamma, 1.2 * force, press)
    alone, weighed = read_errors(fit, stiff), weighed_errors(fit, stiff)
    assert alone["mae_N"] > 0.5
    assert_allclose(alone["bias_N"], -alone["mae_N"])
    assert_allclose(weighed["mae_N"], 0, atol=1e-6)
    assert_allclose(weighed["scale"], 1.2)
    assert abs(weighed["weight_N"] - 5) < 0.5
    first = part_of(stiff, stiff.press == "l0/0")
    assert len(first.cues) == len(first.force_n) == len(first.image) == 20


def test_baselines_of_one_run_are_read_on_another():
    gamma, force, press = presses(count=12, noise=0.02)
    learnt = touched(gamma, force, press)
    used = learnt.force_n >= 1
    same = transferred_errors(learnt, used, learnt, used)
    assert same.keys() == baseline_errors(learnt, used).keys()
    assert same["mean shift"] < 0.05 < 1 < same["mean"]
    stiff = touched(gamma, 1.2 * np.asarray(force), press)
    scored = stiff.force_n >= 1
    assert_allclose(
        transferred_errors(learnt, used, stiff, scored)["mean shift"],
        (stiff.force_n[scored] * 0.2 / 1.2).mean(),
        rtol=0.05,
    )


def test_the_published_formula_goes_with_pressure_and_not_with_where_it_is():
    pad = nusense()
    x = np.linspace(-6e-3, 6e-3, 61)
    hill = 1e5 * np.exp(-(x[None, :] ** 2 + x[:, None] ** 2) / (2 * 1.5e-3**2))
    one = published_gamma_of(pad, hill, x, x)
    assert_allclose(published_gamma_of(pad, 2 * hill, x, x), 2 * one)
    assert_allclose(published_gamma_of(pad, hill, x + 3e-3, x), one, rtol=1e-6)
    # a Gaussian of 1.5 mm blurred by 1.5 mm: half the peak, wider by sqrt 2; its slope's size over the plane
    layers, s = pad.spec.layers, 1.5e-3 * math.sqrt(2)
    slope = 0.5e5 * (2 * math.pi) ** 1.5 * s / 2
    shift_m3 = layers.gel_m**2 * 3 / layers.gel_pa * slope
    expected = 164**2 / 18_000 * shift_m3 / (19 * 14 * 2.4e-3**2) * 333 / 0.055
    assert_allclose(one, expected, rtol=0.01)


def test_every_plan_of_the_thesis_is_recorded_and_small_changes_only_what_costs_time():
    assert {one.plan for one in RECORDINGS.values()} == set(PLANS)
    assert len({one.session for one in RECORDINGS.values()}) == len(RECORDINGS)  # no two share their noise
    assert scale_named("full").plan_fields("cycles")["cycles"] == 70
    assert SMALL.plan_fields("cycles")["cycles"] == 70
    assert SMALL.plan_fields("hysteresis")["speed_mm_s"] == 0.5
    assert len(SMALL.plan_fields("places")["places"]["at_mm"]) == 24
    for name in RECORDINGS:
        changed = {k for k, v in SMALL.plan_fields(name).items() if PLANS[RECORDINGS[name].plan].get(k) != v}
        assert changed <= {"speed_mm_s", "cycles", "reference_frames", "clearance_mm", "until_N"}
    speeds = {SMALL.plan_fields(name)["speed_mm_s"] for name in ("force", "session", "copy-1", "copy-2")}
    assert len(speeds) == 1
    with pytest.raises(InputError, match="small, full"):
        scale_named("large")


TINY = StudyScale(
    "tiny",
    {
        "places": {
            "places": {"kind": "listed", "at_mm": [[0.0, 0.0], [12.0, 7.0]]},
            "cycles": 2,
            "speed_mm_s": 4.0,
        },
        "edges": {"indenters": ["edge:25:0", "edge:25:60"], "speed_mm_s": 2.0, **FIRM_TAPS},
        "force": {"indenters": ["flat"], "cycles": 1, "speed_mm_s": 4.0, **FIRM_TAPS},
    },
    {"reference_frames": 2, "clearance_mm": 0.3, "taps": 0},
)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Two places, twice each."""
    out, told = tmp_path_factory.mktemp("study") / "nusense", []
    entries = reproduce_nusense(out, TINY, part="places", progress=lambda *said: told.append(said))
    return out, entries, told


def number(entries, name: str) -> float:
    (found,) = (one["value"] for one in entries if one["name"] == name)
    return found


@pytest.mark.slow
def test_every_number_has_its_fields_and_is_what_the_file_holds(small):
    out, entries, told = small
    assert json.loads((out / "summary.json").read_text()) == entries
    assert (out / "runs" / "places" / "manifest.json").is_file()
    for one in entries:
        assert set(one) == FIELDS
        assert one["unit"]
        assert (one["published"] is None) == (one["source"] == "") == (one["why"] == "")
    assert len({one["name"] for one in entries}) == len(entries)
    assert len({what for what, *_ in told}) == 2  # recording and reading


@pytest.mark.slow
def test_places_are_found_where_the_tip_was_set(small):
    _, entries, _ = small
    assert number(entries, "places by centre of the pressure: told") == 100
    assert number(entries, "places by centre of the pressure: RMS") < 0.15
    assert number(entries, "places by centre of the ring: RMS") < 0.5
    printed = {one["published"] for one in entries if one["published"] is not None}
    assert printed == {0.50, 0.09}


@pytest.mark.slow
def test_the_page_holds_its_figures_and_no_nan(small):
    out, _, _ = small
    page = (out / "report.html").read_text(encoding="utf-8")
    images = re.findall(r'<img src="([^"]{20})', page)
    assert len(images) == 3  # a press, how far it moved, and the places
    assert all(one.startswith("data:image/") for one in images)
    words = re.sub(r'src="[^"]*"', "", page)
    words = words[words.index("<body>") :]
    assert not re.search(r"\b(nan|NaN|inf|None|Undefined)\b", words)
    assert "http://" not in words
    assert "Virtual" in words


@pytest.mark.slow
def test_a_study_is_never_overwritten_and_a_part_has_to_be_there(small, tmp_path):
    out, _, _ = small
    with pytest.raises(ExistsError):
        reproduce_nusense(out, TINY)
    with refused("unknown-name", InputError):
        reproduce_nusense(tmp_path / "a", TINY, part="colour")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_taps_of_a_flat_tip_set_the_clocks(tmp_path):
    run = NuSenseStudy(tmp_path, TINY, 0).run("force")
    assert run.labels["force_N"].max() > 5
    assert set(run.labels["indenter"].dropna()) == {"flat"}


@pytest.mark.slow
def test_a_cut_is_seen_where_it_gapes(tmp_path, monkeypatch):
    monkeypatch.setattr(nusense_experiments, "DRAWS", 1)
    for seen in cut_seen(NuSenseStudy(tmp_path, TINY, 0), 0.5)["flags"].values():
        assert (seen["rest"], seen["rest_of"], seen["pressed_of"]) == (1, 1, 4)
        assert seen["pressed"] >= 2  # a press closes a cut in part
