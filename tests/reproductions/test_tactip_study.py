"""The compliance report made again: upright in some seconds, whole in minutes; both with the slow tests."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core.errors import ExistsError, InputError
from palpate.psychophysics import fit_line
from palpate.rig.virtual.linear_rig import LINEAR_RIG
from palpate.sensors.tactip import tactip
from palpate_reproductions.tactip import tactip_reproduction as study
from palpate_reproductions.tactip.tactip_reproduction import CUES, reproduce_tactip
from palpate_reproductions.tactip.tactip_setup import (
    KAPPA,
    KAPPA_NEW,
    NAMES,
    Experiment,
    kappa_n_m,
    stiffness_line,
    under_plate,
)

FIELDS = {"name", "value", "unit", "published", "source", "why"}


@pytest.fixture(scope="module")
def upright(tmp_path_factory):
    """Two trials, no tilt."""
    out, told = tmp_path_factory.mktemp("study") / "tactip", []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "TILTS", (0,))
        patch.setattr(study, "CONTROLS", ("as assumed", "linear rig"))
        entries = reproduce_tactip(out, trials=2, progress=lambda *said: told.append(said))
    return out, entries, told


def number(entries, name: str) -> float:
    (found,) = (one["value"] for one in entries if one["name"] == name)
    return found


@pytest.mark.slow
def test_every_number_has_its_fields_and_is_what_the_file_holds(upright) -> None:
    out, entries, _ = upright

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    assert json.loads((out / "summary.json").read_text(), parse_constant=refuse) == entries
    assert sorted(one.name for one in out.iterdir()) == ["report.html", "summary.json"]
    for one in entries:
        assert set(one) == FIELDS
        assert one["unit"]
        assert (one["published"] is None) == (one["source"] == "") == (one["why"] == "")
    names = [one["name"] for one in entries]
    assert len(set(names)) == len(names)


@pytest.mark.slow
def test_what_the_report_prints_of_upright_specimens_is_beside_ours(upright) -> None:
    _, entries, _ = upright
    printed = {one["published"] for one in entries if one["published"] is not None}
    assert {KAPPA[name].value for name in NAMES} <= printed
    assert KAPPA_NEW[0].value in printed
    assert KAPPA_NEW[30].value not in printed


@pytest.mark.slow
def test_the_new_specimen_is_found_by_touch(upright) -> None:
    """Two trials: 15 % by touch, 6 % by both cues."""
    _, entries, _ = upright
    assert_allclose(number(entries, "0 degrees: new specimen by touch alone"), 5.3, rtol=0.15)
    assert_allclose(number(entries, "0 degrees: new specimen by both cues"), 5.3, rtol=0.06)
    low, high = (number(entries, f"0 degrees: new specimen by touch alone, {end}") for end in ("low", "high"))
    assert low < 5.3 < high


@pytest.mark.slow
def test_the_page_holds_its_figures_and_no_nan(upright) -> None:
    out, _, _ = upright
    page = (out / "report.html").read_text(encoding="utf-8")
    images = re.findall(r'<img src="([^"]{20})', page)
    assert len(images) == 4  # the new specimen, the plate, a trend and a line for the one tilt
    assert all(one.startswith("data:image/") for one in images)
    words = re.sub(r'src="[^"]*"', "", page)
    words = words[words.index("<body>") :]
    assert not re.search(r"\b(nan|NaN|inf|None)\b", words)
    assert "http://" not in words
    assert "Virtual" in words


@pytest.mark.slow
def test_a_study_is_never_overwritten_and_needs_two_trials(upright, tmp_path) -> None:
    out, _, _ = upright
    with pytest.raises(ExistsError):
        reproduce_tactip(out)
    with refused("trial-count", InputError):
        reproduce_tactip(tmp_path / "a", trials=1)
    assert not list(tmp_path.iterdir())
    result = CliRunner().invoke(app, ["reproduce", "tactip", "--out", str(out)])
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1


def test_on_the_linear_rig_the_encoder_has_the_stiffness_and_the_command_the_droop_in_series() -> None:
    """The command for the encoder is the negative control: 1/Kp comes in as false compliance."""
    for name in NAMES:
        kappa, Kp = kappa_n_m(name), LINEAR_RIG.stiffness_n_m
        encoder, command = (
            np.mean([line.slope for line in under_plate(tactip(), name, 5, 5, LINEAR_RIG, over).lines])
            for over in study.OVER
        )
        assert_allclose(encoder, kappa, rtol=0.005)
        assert_allclose(1 / command - 1 / encoder, 1 / Kp, rtol=0.05)
        assert_allclose(command, kappa * Kp / (kappa + Kp), rtol=0.005)
        (ideal,) = under_plate(tactip(), name, 1, 5, over="command").lines
        assert_allclose(ideal.slope, kappa, rtol=0.02)


def test_a_line_is_through_the_references_and_read_at_the_new_specimen() -> None:
    told = object.__new__(Experiment)  # of an experiment the table alone counts
    table = {
        "specimen": ["S1", "S2", "S3", "new", "new", "new"],
        "cue": [10.0, 20.0, 30.0, 12.0, 14.0, np.nan],
    }
    object.__setattr__(told, "table", pd.DataFrame(table))
    line, new = stiffness_line(told, "cue")
    assert_allclose(new, 13.0)
    same = fit_line(np.array([10.0, 20.0, 30.0]), np.array([7.6, 3.1, 1.1]))
    assert_allclose((line.slope, line.start), (same.slope, same.start))


@pytest.mark.slow
def test_the_whole_report_is_made_at_every_tilt(tmp_path) -> None:
    """5.3 N/mm within 15 % upright and 25 % inclined by touch; the cues that the report used are beside."""
    entries = reproduce_tactip(tmp_path / "study", seed=1)
    for tilt, within in ((0, 0.15), (30, 0.25), (45, 0.25)):
        for how in ("touch alone", "both cues"):
            assert_allclose(number(entries, f"{tilt} degrees: new specimen by {how}"), 5.3, rtol=within)
        for cue in CUES.values():
            assert number(entries, f"{tilt} degrees: {cue}, Kruskal-Wallis p") < 0.01
        for name in NAMES:
            assert number(entries, f"{tilt} degrees: contact area of {name}, median error over 1 to 5 N") < 5
    page = (tmp_path / "study" / "report.html").read_text(encoding="utf-8")
    assert page.count("<img ") == 2 + 2 * 3
    assert not re.search(r"\bnan\b", re.sub(r'src="[^"]*"', "", page), re.IGNORECASE)
