"""The verbs of compliance on a tiny experiment of rendered presses."""

import json
import math
import shutil
from dataclasses import replace

import pandas as pd
import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import Lens
from palpate.sensors.tactip import tactip
from palpate.sensors.tactip.tactip_press import pixels_per_tangent
from palpate.workflows.tactip_trials import record_trials, specimens_at


def compliance(*words, status=0):
    begin = {"calibrate": ["calibrate", "--method", "compliance"], "read": ["read"]}
    first, rest = (
        (words[0], words[1:])
        if words[0] in ("calibrate", "latency", "plate", "compare", "read")
        else ("read", words)
    )
    result = CliRunner().invoke(app, [*begin.get(first, ["compliance", first]), *map(str, rest)])
    assert result.exit_code == status, result.output + result.stderr
    return result


def strict(text: str):
    """JSON as the standard has it: no NaN, no Infinity."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    """A rigid plate and two specimens, two trials each, at 8 mm/s so that there are few frames."""
    out = tmp_path_factory.mktemp("experiment") / "presses"
    spec = replace(tactip(), speed_m_s=8e-3)
    record_trials(out, spec, specimens_at(spec, {"rigid": math.inf, "S1": 7.6e3, "S3": 1.1e3}), 2, seed=1)
    return out


@pytest.fixture(scope="module")
def press(experiment):
    return experiment / "S1" / "01.tif", "--force", experiment / "S1" / "01.csv"


@pytest.fixture(scope="module")
def calibration(experiment, tmp_path_factory):
    path = tmp_path_factory.mktemp("calibration") / "tip.npz"
    return path, compliance("calibrate", experiment, "--out", path, "--note", "tiny", "--quiet").output


def test_a_press_alone_is_read_and_said_to_be_uncalibrated(press) -> None:
    said = compliance(*press).output
    assert "sensor and specimen" in said
    assert "no calibration was given" in said
    found = strict(compliance(*press, "--json").output)
    assert found["readings"] == []
    assert found["pins"] == 127
    assert found["speed_mm_s"] == pytest.approx(8)
    assert 0.5 < found["series_stiffness"]["value_N_per_mm"] < 7.6  # tip and specimen in series yield more
    assert found["as_reported"]["regression_per_N"]["value"] > 0


def test_a_lens_gives_the_untouched_area_in_mm2(press, tmp_path) -> None:
    """The virtual camera written as a lens: the field is a circle of six pitches of 2.6 mm."""
    focal = pixels_per_tangent(tactip())
    Lens("pinhole", (focal, focal), (149.5, 149.5), (0.0,) * 5, (300, 300)).write(tmp_path / "lens.json")
    found = strict(compliance(*press, "--lens", tmp_path / "lens.json", "--json").output)
    assert found["untouched_area_mm2"] == pytest.approx(math.pi * 15.6**2, rel=0.01)


def test_a_calibrated_press_is_told_with_its_interval(press, calibration) -> None:
    path, _ = calibration
    found = strict(compliance(*press, "--with", path, "--json").output)
    readings = {one["quantity"]: one for one in found["readings"]}
    assert set(readings) == {
        "stiffness", "stiffness_both_cues", "area_at_4_N", "spread_rate", "modulus", "radius"
    }  # fmt: skip
    told = readings["stiffness"]
    assert told["unit"] == "N_per_mm"
    assert told["value"] == pytest.approx(7.6, rel=0.15)
    assert told["low"] <= told["value"] <= told["high"]
    assert told["valid"], told["why"]
    assert len(found["area"]) == found["frames"]
    assert "stiffness" in compliance("read", *press, "--with", path).output


def test_picture_and_readings_are_written_once(press, calibration, tmp_path, figures_blank) -> None:
    path, _ = calibration
    for i, more in enumerate(((), ("--with", path))):
        out = tmp_path / str(i)
        compliance(*press, *more, "--out", out)
        assert sorted(one.name for one in out.iterdir()) == ["press.png", "readings.json"]
        strict((out / "readings.json").read_text())
        assert (out / "press.png").read_bytes().startswith(b"\x89PNG")
        before = (out / "readings.json").read_bytes()
        assert "nothing is ever overwritten" in compliance(*press, "--out", out, status=2).stderr
        assert (out / "readings.json").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize("calibrated", [False, True])
def test_specimens_are_compared(experiment, calibration, tmp_path, calibrated) -> None:
    out, more = tmp_path / "compared", ("--with", calibration[0]) if calibrated else ()
    found = strict(compliance("compare", experiment, "--out", out, "--json", "--pooled", *more).output)
    assert sorted(one.name for one in out.iterdir()) == ["comparison.json", "comparison.png", "trials.csv"]
    assert found["trials"] == {"rigid": 2, "S1": 2, "S3": 2}
    assert (found["calibration"] is not None) == calibrated
    held = strict((out / "comparison.json").read_text())
    assert {**held, "out": str(out)} == found
    table = pd.read_csv(out / "trials.csv")
    assert list(table["specimen"]) == ["rigid", "rigid", "S1", "S1", "S3", "S3"]
    series = found["cues"]["series_stiffness_N_per_mm"]
    assert series["mean"]["rigid"] > series["mean"]["S1"] > series["mean"]["S3"]
    for name, (low, high) in series["interval_95"].items():
        assert low <= series["mean"][name] <= high
    assert "pseudo-replication" in json.dumps(found["pooled_sums"])
    if calibrated:
        told = {name: each[0] for name, each in found["specimens"].items()}
        assert told["S3"]["value"] < told["S1"]["value"]
    assert "overwritten" in compliance("compare", experiment, "--out", out, status=2).stderr


def test_grouped_trials_are_compared_by_a_mixed_model(experiment, tmp_path, figures_blank) -> None:
    presses = grouped(
        experiment, tmp_path / "presses", "specimen,trial,day", lambda name, k: f"{name},{k},d{k}"
    )
    out = tmp_path / "compared"
    compliance("compare", presses, "--out", out, "--group", "day", "--quiet")
    held = strict((out / "comparison.json").read_text())
    model = held["cues"]["series_stiffness_N_per_mm"]["mixed_model"]
    assert model["variance"]["day"] is None
    told = next(one for one in model["pairs"] if (one["first"], one["second"]) == ("S1", "S3"))["difference"]
    assert told["low"] <= told["value"] <= told["high"] < 0
    assert told["p"] <= told["p_all_cues"]
    rows = pd.read_csv(out / "differences.csv").set_index(["cue", "first", "second"])
    assert math.isclose(rows.loc[("series_stiffness_N_per_mm", "S1", "S3"), "low"], told["low"])
    assert list(pd.read_csv(out / "trials.csv")["day"]) == ["d1", "d2"] * 3


def grouped(experiment, copy, header, row):
    """The experiment again, with a table of what its presses share."""
    shutil.copytree(experiment, copy)
    rows = [row(name, k) for name in ("rigid", "S1", "S3") for k in (1, 2)]
    (copy / "trials.csv").write_text("\n".join([header, *filter(None, rows)]) + "\n")
    return copy


@pytest.mark.parametrize(
    ("row", "words", "says"),
    [
        (lambda name, k: f"{name},{k},of-{name}", ("day",), "two specimens or more in each day"),
        (lambda name, k: f"{name},{k},d{k}", ("tip",), "no column 'tip'"),
        (lambda name, k: f"{name},{k},d{k}", ("day", "day"), "two different ones"),
        (
            lambda name, k: f"{name},{k}," + "d" * k if name == "S1" or k == 2 else f"{name},{k},",
            ("day",),
            "no day",
        ),
        (lambda name, k: f"{name},{k},d" if k == 1 else "", ("day",), "no row for rigid/02, S1/02, S3/02"),
        (lambda name, k: f"{name},1,d", ("day",), "more than once"),
        (lambda name, k: f"{name},{k + 7},d", ("day",), "which is not in"),
    ],
)
def test_groups_that_cannot_be_used_are_refused_before_a_press_is_read(
    experiment, tmp_path, row, words, says
) -> None:
    presses = grouped(experiment, tmp_path / "presses", "specimen,trial,day", row)
    more = [one for word in words for one in ("--group", word)]
    one_line(compliance("compare", presses, "--out", tmp_path / "out", *more, status=2), says)
    assert not (tmp_path / "out").exists()


def one_line(result, *says: str) -> None:
    assert result.stderr.startswith("palpate: ")
    assert result.stderr.count("\n") == 1
    for one in says:
        assert one in result.stderr


def test_frames_and_table_of_different_length_are_refused_in_one_line(experiment, tmp_path) -> None:
    short = tmp_path / "short.csv"
    rows = pd.read_csv(experiment / "S1" / "01.csv")
    rows[rows["frame"] < rows["frame"].max() - 3].to_csv(short, index=False)
    out = tmp_path / "out"
    result = compliance(experiment / "S1" / "01.tif", "--force", short, "--out", out, status=2)
    one_line(result, "is it of this press?")
    assert not out.exists()
    whole = tmp_path / "whole.csv"
    rows.drop(columns="frame").to_csv(whole, index=False)
    one_line(compliance(experiment / "S1" / "01.tif", "--force", whole, status=2), "rows and there are")


def test_what_cannot_be_read_is_said_in_one_line(experiment, press, tmp_path) -> None:
    garbage = tmp_path / "tip.npz"
    garbage.write_bytes(b"nothing")
    one_line(compliance(*press, "--with", garbage, status=2), "no calibration of compliance")
    one_line(compliance(*press, "--with", tmp_path / "none.npz", status=2), "none.npz")
    one_line(compliance(tmp_path / "none.tif", *press[1:], status=2), "none.tif")
    one_line(compliance(*press, "--force-column", "grip_N", status=2), "grip_N")
    one_line(compliance("calibrate", experiment, "--out", tmp_path / "tip.txt", status=2), ".npz")
    one_line(
        compliance("calibrate", tmp_path / "none", "--out", tmp_path / "a.npz", status=2), "is no folder"
    )


@pytest.fixture(scope="module")
def there_and_back(tmp_path_factory):
    """Presses that come back, by a camera late by 60 ms: two of S1 and a rigid plate's two."""
    out = tmp_path_factory.mktemp("late") / "presses"
    spec = replace(tactip(), speed_m_s=12e-3)
    faces = specimens_at(spec, {"rigid": math.inf, "S1": 7.6e3})
    record_trials(out, spec, faces, 2, seed=3, back=True, late_s=0.06)
    return out


@pytest.mark.slow
def test_the_latency_of_a_camera_is_told_by_presses_that_come_back_and_taken_off(
    there_and_back, tmp_path
) -> None:
    out = tmp_path / "latency.json"
    found = strict(compliance("latency", there_and_back, "--out", out, "--quiet", "--json").output)
    assert found["valid"]
    assert found["low_ms"] < 60 < found["high_ms"]
    assert found["high_ms"] - found["low_ms"] < 5
    assert "one speed" in found["flags"][0]
    late, corrected = tmp_path / "late.npz", tmp_path / "corrected.npz"
    compliance("calibrate", there_and_back, "--out", late, "--quiet")
    said = compliance(
        "calibrate", there_and_back, "--out", corrected, "--latency", out, "--quiet", "--json"
    ).output
    record = strict(said)
    assert record["latency_ms"] == pytest.approx(60, abs=3)
    assert record["nuisances"]["late_ms"] == pytest.approx(found["standard_uncertainty_ms"])
    press = (there_and_back / "S1" / "01.tif", "--force", there_and_back / "S1" / "01.csv", "--json")
    both = strict(compliance(*press, "--with", corrected, "--latency", out).output)
    assert both["nuisances"]["late_ms"] == pytest.approx(2**0.5 * found["standard_uncertainty_ms"])
    apart = strict(compliance(*press, "--with", late, "--latency", out).output)
    assert any("were not corrected" in flag for flag in apart["flags"])
    assert not any(one["valid"] for one in apart["readings"])
    other = strict(compliance(*press, "--with", corrected).output)
    assert any("read with --latency" in flag for flag in other["flags"])
