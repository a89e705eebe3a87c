"""The NUSense thesis made again: its analyses on made-up presses, and the whole study small."""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.calibration.shear import LabelledCues, TouchCues, calibrate_shear
from palpate.calibration.shear.calibrate_runs import baseline_errors, transferred_errors
from palpate.cli import app
from palpate.core import Reading
from palpate.core.errors import ExistsError, InputError
from palpate.estimators.lattice import ControlPoints
from palpate.sensors.nusense.nusense_sensor import FIRM_TAPS, PLANS, nusense
from palpate_reproductions import nusense as nusense_package
from palpate_reproductions.nusense import nusense_experiments, reproduce_nusense, scale_named
from palpate_reproductions.nusense.nusense_analysis import (
    branch_table,
    drift_of,
    force_line,
    gamma_at,
    held_out_line,
    hysteresis_loop,
    loading_frames,
    rms_by,
    shuffled_r2,
    turned_deg,
)
from palpate_reproductions.nusense.nusense_experiments import (
    RANGES,
    arm_or_reader_holds,
    cut_seen,
    edge_errors,
    frames_near,
    in_ranges,
    part_of,
    place_errors,
    read_errors,
    weighed_errors,
)
from palpate_reproductions.nusense.nusense_setup import (
    RECORDINGS,
    SMALL,
    NuSenseStudy,
    StudyScale,
    labelled_cues,
    plain_cues,
)
from palpate_reproductions.nusense.published_shear import (
    ShearCurve,
    published_gamma_of,
    scale_of_published_shear,
)

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


def test_a_press_is_loaded_up_to_its_own_greatest_force():
    gamma, force, press = presses(count=2)
    force[20:] /= 2  # the second is lighter, and has a branch of its own
    keep = loading_frames(touched(gamma, force, press))
    assert keep.tolist() == ([True] * 12 + [False] * 8) * 2


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


def test_a_loop_is_the_force_that_is_lost_at_the_same_gamma():
    gamma = np.concatenate([np.linspace(0, 1, 40), np.linspace(1, 0, 40)[1:]])
    force = 8 * gamma - np.r_[np.zeros(40), np.full(39, 0.5)]
    loop = hysteresis_loop(force, gamma)
    assert_allclose(loop.width, 0.5, rtol=0.02)
    assert_allclose(loop.area, 0.5, rtol=0.03)  # 0.5 N over a gamma of 1
    assert_allclose(loop.share, 0.5 / 4, rtol=0.03)
    assert loop.gamma == 1
    elastic = hysteresis_loop(8 * gamma, gamma)
    assert_allclose((elastic.area, elastic.width, elastic.off_line), 0, atol=1e-9)
    with pytest.raises(InputError, match="3 frames"):
        hysteresis_loop(np.array([0.0, 1.0, 8.0]), np.array([0.0, 0.1, 0.7]))


def test_gamma_at_a_force_lies_between_its_frames_and_is_not_made_up_beyond():
    at = gamma_at(np.array([0.0, 2.0, 4.0]), np.array([0.0, 0.1, 0.3]), [1.0, 3.0, 5.0])
    assert_allclose(at, [0.05, 0.2, np.nan])
    gamma, force, press = presses(count=3)
    table = branch_table(touched(gamma, force, press), [1.0, 4.0])
    assert list(table) == ["l0/0", "l0/1", "l0/2"]
    assert_allclose(table["l0/1"], [(1 + 0.2) / 12, (4 + 0.2) / 12])


def test_a_drift_is_the_change_from_the_first_touch_to_the_last():
    values = 3.0 + 0.01 * np.arange(71)
    drift = drift_of(values)
    assert_allclose(drift.change, 0.7)
    assert_allclose(drift.error, 0, atol=1e-9)
    noisy = drift_of(3.0 + 0.1 * np.random.default_rng(2).standard_normal(70))
    assert abs(noisy.change) < 3 * noisy.error
    assert_allclose(noisy.error, 0.1 * math.sqrt(12 / 70), rtol=0.2)  # of a line over 70 even steps
    with pytest.raises(InputError, match="3 touches"):
        drift_of(np.array([1.0, 2.0]))


@pytest.mark.parametrize(("one", "other", "turn"), [(179, 1, -2), (1, 179, 2), (60, 55, 5), (0, 89, -89)])
def test_an_edge_has_no_front(one, other, turn):
    assert_allclose(turned_deg(one, other), turn)


def test_errors_of_edges_are_of_their_size_whatever_their_sign():
    rows = [
        {"p_off_deg": -2.0, "p_half_deg": 1.0},
        {"p_off_deg": 1.0, "p_half_deg": 1.5},
        {"p_off_deg": None, "p_half_deg": None},
    ]
    found = edge_errors(rows, "p")
    assert (found["told"], found["of"], found["median_deg"], found["greatest_deg"]) == (2, 3, 1.5, 2.0)
    assert found["covered"] == 0.5
    assert edge_errors(rows[2:], "p") == {"told": 0, "of": 1}


def test_places_err_by_the_distance_in_the_plane():
    rows = [
        {"place": "a", "cycle": 1, "true_mm": (0.0, 0.0), "ring_mm": (0.3, 0.4)},
        {"place": "a", "cycle": 2, "true_mm": (0.0, 0.0), "ring_mm": (0.3, -0.4)},
        {"place": "b", "cycle": 1, "true_mm": (5.0, 1.0), "ring_mm": (5.0, 1.0)},
        {"place": "b", "cycle": 2, "true_mm": (5.0, 1.0), "ring_mm": None},
    ]
    found = place_errors(rows, "ring")
    assert (found["told"], found["of"]) == (3, 4)
    assert_allclose(found["rms_mm"], math.sqrt(0.5 / 3))
    assert_allclose(found["shift_mm"], [0.2, 0.0], atol=1e-12)
    assert found["per_place_mm"] == pytest.approx({"a": 0.5, "b": 0.0})
    assert_allclose(found["rounds_mm"], [math.sqrt(0.25 / 2), 0.5])
    assert rms_by(["x", "y", "x"], np.array([3.0, 1.0, 4.0])) == pytest.approx(
        {"x": math.sqrt(12.5), "y": 1.0}
    )


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


def test_ranges_take_each_tip_between_its_forces():
    samples = touched(np.zeros(4), [2.0, 2.0, 5.0, 5.0], ["a"] * 4, ["flat", "round", "flat", "round"])
    text = in_ranges(samples, RANGES["as the text has it: flat to 3 N, round to 8 N"])
    caption = in_ranges(samples, RANGES["as the caption has it: round 1 to 3 N, flat 3 to 8 N"])
    assert text.tolist() == [True, True, False, True]
    assert caption.tolist() == [False, True, True, False]


def test_the_frame_nearest_to_a_force_is_on_the_way_down():
    force = [np.nan, 0.0, 2.0, 5.5, 7.0, 6.0, 1.0, 0.0, 6.6, 3.0]
    press = [None, "a", "a", "a", "a", "a", "a", "b", "b", "b"]
    labels = pd.DataFrame({"force_N": force, "press": np.array(press, object)})
    assert frames_near(labels, 6.0) == [3, 8]  # and not frame 5, at 6 N on its way up


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


def test_cues_are_kept_whole_in_a_file():
    gamma, force, press = presses(count=1)
    samples = touched(gamma, force, press)
    marks = ControlPoints(
        np.array([[0, 0], [1, 0]]), np.array([[1.5, 2.0], [3.0, 4.0]]), np.array([0.1, 0.2])
    )
    again = labelled_cues(json.loads(json.dumps(plain_cues(samples, marks), allow_nan=False)))
    assert_allclose(np.array(again.cues), np.array(samples.cues))
    assert math.isnan(again.cues[0].near)
    assert isinstance(again.cues[0].contacts, int)
    assert (again.press == samples.press).all()
    assert_allclose(again.image, samples.image)


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


def test_one_scale_is_what_a_formula_lacks():
    force = np.linspace(1, 8, 30)
    curve = ShearCurve(np.linspace(0.5, 9, 20), 0.25 * np.linspace(0.5, 9, 20))
    found = scale_of_published_shear(curve, 0.1 * force, force, np.repeat([1, 2, 3], 10))
    assert_allclose((found["slope_N"], found["gamma_over_measured"]), (4.0, 2.5))
    assert_allclose(found["one_scale_mae_N"], 0, atol=1e-9)
    assert found["mae_N"] > 1


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
def test_a_stopped_study_goes_on_where_it_was(tmp_path, small):
    _, entries, _ = small

    def stop(what: str, done: int, total: int) -> None:
        if what == "touches of places" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reproduce_nusense(tmp_path / "a", TINY, part="places", progress=stop)
    with refused("work-of-another", ExistsError):
        reproduce_nusense(tmp_path / "a", TINY, part="places", seed=1)
    told: list[str] = []
    again = reproduce_nusense(
        tmp_path / "a", TINY, part="places", progress=lambda what, *_: told.append(what)
    )
    assert len(set(told)) == 1  # nothing is recorded twice
    assert again == entries


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


@pytest.mark.slow
def test_edges_are_recorded_and_told(tmp_path):
    entries = reproduce_nusense(tmp_path / "a", TINY, part="edges")
    assert number(entries, "edges by axis of the pressure: told") == 100
    assert number(entries, "edges by axis of the pressure: greatest error") < 1.5
    assert number(entries, "edges by PCA of the most moved samples, as published: greatest error") < 10


@pytest.mark.slow
def test_the_verb_says_that_it_is_virtual(small, monkeypatch, tmp_path):
    _, entries, _ = small
    asked = []
    monkeypatch.setattr(
        nusense_package, "reproduce_nusense", lambda *given, **how: asked.append((given, how)) or entries
    )
    words = [
        "reproduce",
        "nusense",
        "--out",
        str(tmp_path / "a"),
        "--part",
        "places",
        "--seed",
        "3",
        "--quiet",
    ]
    said = CliRunner().invoke(app, words)
    assert said.exit_code == 0, said.output + said.stderr
    assert "Virtual sensor" in said.output
    assert "printed: 0.5" in said.output
    (_, scale), how = asked[0]
    assert (scale.name, how["part"], how["seed"]) == ("small", "places", 3)
    assert json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout) == entries
