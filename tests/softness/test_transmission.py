"""From a touch to a finger: curves, intervals and judgements carried stage by stage."""

import json
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import InputError, RangeError
from palpate.mechanics.fingertip_laws import hertz_fingertip
from palpate.mechanics.half_space.hertz import Body
from palpate.softness import read_object, transmission
from palpate.softness.rendering_simulation import simulate
from palpate.softness.touched_flat import Cylinder, TouchedFlat, read_touched_flat
from palpate.softness.transmission import (
    CueNoise,
    judged,
    modulus_of_chord,
    object_under,
    order_kept,
    shared_peak_n,
    transmit,
)

FINGER = hertz_fingertip(Body(30e3 / 0.75, 15e-3))
OFTEN = 3.0  # presses a second, whose renderings are short
READING = {
    "quantity": "modulus", "unit": "MPa", "value": 0.2, "low": 0.15, "high": 0.3, "valid": True, "why": "",
    "coverage": 0.9, "calibration": "compliance-1",
}  # fmt: skip


def flat(kpa: float, below: float = 0.8, above: float = 1.3) -> TouchedFlat:
    """A reading with its interval."""
    return TouchedFlat(1e3 * kpa, 1e3 * below * kpa, 1e3 * above * kpa, 0.9, "compliance-1", "a reading")


@pytest.fixture(scope="module", autouse=True)
def one_scored_press():
    """The second press is scored and none after it: what is felt of them is alike."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(transmission, "simulate", partial(simulate, presses=2))
        patched.setattr(transmission, "FASTER", 1.6)  # of which the slowest press takes most of the time
        yield


@pytest.fixture(scope="module")
def two():
    """A stiff and a soft object, touched exactly, felt."""
    flats = {"stiff": flat(200), "soft": flat(50)}
    peak = shared_peak_n(FINGER, list(flats.values()))
    return [
        transmit(
            name, one, FINGER, peak_n=peak, true_flat_pa=one.flat_pa, seed=i, draws=200, frequency_hz=OFTEN
        )
        for i, (name, one) in enumerate(flats.items())
    ]


def test_quantiles_of_a_reading_are_its_value_and_its_ends_and_fall_evenly_in_compliance() -> None:
    one = flat(100, 0.7, 2.0)
    assert_allclose(one.at(np.array([0.05, 0.5, 0.95])), [70e3, 100e3, 200e3], rtol=1e-12)
    drawn = one.drawn(2000, np.random.default_rng(0))
    assert_allclose(np.quantile(drawn, [0.05, 0.5, 0.95]), [70e3, 100e3, 200e3], rtol=5e-3)
    assert (np.diff(one.at(np.linspace(0.01, 0.99, 50))) > 0).all()
    endless = TouchedFlat(100e3, 70e3, math.inf, 0.9, "c", "w").drawn(1000, np.random.default_rng(0))
    assert 0.04 < np.isinf(endless).mean() < 0.06  # beyond 1 / E = 0 lies a rigid object


def test_a_cylinder_with_free_ends_is_its_modulus_times_area_over_height_and_a_bonded_one_is_stiffer() -> (
    None
):
    free, bonded = (Cylinder(18.5e-3, 7e-3, 0.499, ends) for ends in ("free", "bonded"))
    assert free.flat_pa(3100.0) == pytest.approx(3100 * 7e-3 / (math.pi * 18.5e-3**2) / (1 - 0.499**2))
    assert bonded.flat_pa(3100.0) < 0.3 * free.flat_pa(3100.0)
    with refused("cylinder", RangeError, match="0 mm"):
        Cylinder(0.0, 40e-3, 0.48)


def test_what_is_felt_is_what_was_touched_within_the_display_s_error_and_softer_is_softer(two) -> None:
    for one in two:
        for cue in one.cues.values():
            assert cue.lost["touch"] == pytest.approx(0, abs=1e-12)
            assert abs(cue.lost["display"]) < 0.05
            assert cue.way_in > cue.felt / cue.touched > cue.way_out  # pressure and arm follow with a delay
            assert cue.held
    assert order_kept(two) == {"touched": True, "felt": True}
    wrong = [
        replace(two[0], true_flat_pa=two[1].true_flat_pa),
        replace(two[1], true_flat_pa=two[0].true_flat_pa),
    ]
    assert order_kept(wrong) == {"touched": False, "felt": False}


@pytest.fixture
def one_frequency(monkeypatch):
    """A finger whose frequency is known."""
    monkeypatch.setattr(transmission, "FASTER", 1.0001)


@pytest.mark.slow
def test_at_one_frequency_the_interval_felt_is_the_reading_s_through_the_finger(one_frequency) -> None:
    made = {"peak_n": 0.3, "draws": 200, "frequency_hz": OFTEN}
    one = transmit("n", flat(200), FINGER, true_flat_pa=200e3, **made)
    low, high = one.cues["displacement"].interval()
    ends = [
        0.3 / float(object_under(FINGER, pa, 0.3).displacement.at_force(0.3))
        for pa in (one.touched.low_pa, one.touched.high_pa)
    ]
    assert high - low == pytest.approx(ends[1] - ends[0], rel=0.3)
    narrow = transmit("n", flat(200, 0.98, 1.02), FINGER, true_flat_pa=60e3, **made)
    for cue in narrow.cues.values():  # a reading that is three times too stiff
        assert not cue.held
        assert not cue.true_held


def test_how_fast_the_finger_presses_is_in_the_interval(two) -> None:
    """At twice the frequency the display's force is another, by more than the reading leaves open."""
    wide = two[0].cues["displacement"]
    low, high = wide.interval()
    assert high - low > 0.05 * wide.felt


def test_the_modulus_of_a_chord_gives_it_back_and_none_is_stiffer_than_rigid() -> None:
    for cue in ("displacement", "area"):
        soft = object_under(FINGER, 150e3, 0.4)
        chord = 0.4 / float(getattr(soft, cue).at_force(0.4))
        assert modulus_of_chord(FINGER, chord, 0.4, cue) == pytest.approx(150e3, rel=1e-4)
        assert modulus_of_chord(FINGER, 10 * chord, 0.4, cue) == math.inf


def test_cues_that_differ_alike_add_in_quadrature_and_one_that_is_not_perceived_adds_nothing(two) -> None:
    def told(noise: CueNoise, stage: str = "true") -> float:
        return judged(two, noise)[stage].pairs["stiff", "soft"]

    both, arm, skin = told(CueNoise(0.2, 0.2)), told(CueNoise(0.2, math.inf)), told(CueNoise(math.inf, 0.2))
    assert both > max(arm, skin) > 0.5
    d = [math.sqrt(2) * float(norm.ppf(p)) for p in (arm, skin, both)]
    assert d[2] == pytest.approx(math.hypot(d[0], d[1]), rel=0.02)
    assert told(CueNoise(0.2, 0.2), "drawn") < both + 0.02
    alike = [two[0], replace(two[0], name="same")]
    assert judged(alike, CueNoise(0.1, 0.1))["felt"].pairs["stiff", "same"] == pytest.approx(0.5)
    assert judged(two[::-1], CueNoise(0.2, 0.2)) == judged(
        two, CueNoise(0.2, 0.2)
    )  # in order by what they are
    wrong = [replace(two[0], true_flat_pa=1e3), two[1]]
    assert judged(wrong, CueNoise(0.2, 0.2))["true"].pairs["soft", "stiff"] == pytest.approx(1 - both)
    chord = {"displacement": 100.0, "area": 1.0}
    apart = CueNoise(0.2, math.inf).place(chord) - CueNoise(0.2, math.inf).place(
        {**chord, "displacement": 120.0}
    )
    assert norm.cdf(apart / math.sqrt(2)) == pytest.approx(0.75)  # a Weber fraction apart


def test_bad_input_is_refused(tmp_path, two) -> None:
    path = tmp_path / "readings.json"
    for change, said in (
        ({"valid": False, "why": "drift"}, "not valid"), ({"unit": "kPa"}, "'MPa' is needed"),
        ({"value": -1.0}, "above 0"), ({"quantity": "radius"}, "0 readings of modulus"),
        ({"low": 0.25}, "inside its interval"), ({"value": 10**400}, "above 0"), ({"low": 1e-300}, "above 0"),
        ({"coverage": 0.9999999999999999}, "0.999 is allowed"), ({"calibration": "\ud800"}, "is no name"),
    ):  # fmt: skip
        path.write_text(json.dumps({"readings": [READING | change]}))
        with pytest.raises((InputError, RangeError), match=said):
            read_touched_flat(path, "modulus")
    path.write_text("[" * 100_000)
    with pytest.raises(InputError, match="no record"):
        read_touched_flat(path, "modulus")
    path.write_text(json.dumps({"readings": [READING]}))
    with refused("cylinder-missing", InputError):
        read_touched_flat(path, "stiffness")
    with refused("flat-kind", InputError):
        read_touched_flat(path, "hardness")
    with pytest.raises(RangeError, match="asked outside"):
        transmit("x", flat(100), FINGER, peak_n=50.0)
    for force in (0.0, 1e-9, math.nan, math.inf):
        with refused("press-force", RangeError):
            transmit("x", flat(100), FINGER, peak_n=force)
    with refused("too-few-draws", InputError, match="20"):
        transmit("x", flat(100), FINGER, peak_n=0.3, draws=3)
    with pytest.raises(InputError, match="different names"):
        judged([two[0], two[0]], CueNoise(0.1, 0.1))
    with pytest.raises(RangeError, match="above 0"):
        CueNoise(0.0, 0.1)


@pytest.mark.slow
def test_the_verb_renders_readings_writes_a_page_and_objects_and_overwrites_nothing(tmp_path) -> None:
    for name, value in (("A", 0.2), ("B", 0.06)):
        (tmp_path / name).mkdir()
        one = READING | {"value": value, "low": 0.8 * value, "high": None if name == "A" else 1.2 * value}
        (tmp_path / name / "readings.json").write_text(json.dumps({"readings": [one]}))
    words = ["transmit", "press", *(str(tmp_path / n / "readings.json") for n in "AB"), "--finger", "30:15"]
    words += [
        "--frequency-hz",
        f"{OFTEN}",
        "--true-kpa",
        "200,60",
        "--out",
        str(tmp_path / "felt"),
        "--quiet",
    ]
    said = CliRunner().invoke(app, [*words, "--json"])
    assert said.exit_code == 0, said.output
    told = json.loads(said.output)
    assert told["ranks"] == {"touched": True, "felt": True}
    assert told["objects"][0]["modulus_high_kPa"] is None
    assert "nobody has" in (tmp_path / "felt" / "transmission.html").read_text()
    assert read_object(tmp_path / "felt" / "A.toml").greatest_n == pytest.approx(told["peak_N"])
    assert CliRunner().invoke(app, words).exit_code == 2
    for option, given, text in (
        ("--weber", "0.1", "ARM:SKIN"), ("--true-kpa", "200", "1 values for 2"),
        ("--cylinder", "20:40", "as in"),
        ("--finger", "soft", "not MODULUS_KPA"), ("--peak-n", "0", "N and more"),
        ("--live-s", "-1", "0 for none"),
    ):  # fmt: skip
        other = [*words[:-2], str(tmp_path / "other"), "--quiet", option, given]
        said = CliRunner().invoke(app, other)
        assert said.exit_code == 2
        assert text in " ".join(said.output.split())
        assert not (tmp_path / "other").exists()
