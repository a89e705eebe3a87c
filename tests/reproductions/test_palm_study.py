import json
import math
from dataclasses import replace

import pytest
from tests.refusals import refused

from palpate.core.errors import ExistsError, InputError, PalpateError
from palpate.estimators.networks import model_kind
from palpate_reproductions.palm import Scale, palm_reproduction, reproduce_palm, scale_of
from palpate_reproductions.palm.palm_published import MAE, NAMES, R2, TABLE_2
from palpate_reproductions.palm.palm_reproduction import beside, study_folder
from palpate_reproductions.palm.palm_setup import MODELS, PUBLISHED

SHORT = {"epochs": 1}
BRIEF = {"epochs": 1, "rendered": 24}
TINY = Scale(
    "tiny",
    side_px=32,
    frame_px=32,
    cycles=1,
    step_mm=1.0,
    depth_mm=2.0,
    frames=1,
    places=4,
    new_step_mm=1.0,
    coarse_step_mm=1.0,
    options={
        "palm-joint-raw": SHORT,
        "palm-force-conditioned": SHORT,
        "palm-two-stage": {"epochs": 1, "patience": 0},
        "palm-mlp-delta": {"epochs": 3},
        "palm-compact": BRIEF,
    },
    common={"palm-two-stage": {"patience": 0}, "palm-compact": BRIEF},
    steps=2,
    control_steps=2,
    loads=2,
)


def test_what_is_printed_is_of_targets_that_the_models_have():
    assert set(TABLE_2) == set(PUBLISHED) < set(NAMES) == set(MODELS)
    for model, target in {**MAE, **R2}:
        assert target == "place_mm" or target in model_kind(model).targets


def test_small_presses_the_sources_grid_and_about_900_frames():
    small = scale_of("small")
    plan = small.protocol()
    frames = len(plan.places.places()) * plan.cycles * len(plan.depths_um()) * plan.frames
    assert len(plan.places.places()) == 37
    assert 800 <= frames <= 1000
    with refused("unknown-name", InputError):
        scale_of("large")


def test_a_result_is_made_once_and_found_again(tmp_path):
    study, made = study_folder(tmp_path / "out", TINY, 0), []

    def make():
        made.append(1)
        return {"a": [1.5]}

    assert study.kept("x", make) == study.kept("x", make) == {"a": [1.5]}
    assert len(made) == 1
    assert list(study.seconds()) == ["x"]


def test_unfinished_work_of_another_seed_is_not_gone_on_with(tmp_path):
    study_folder(tmp_path / "out", TINY, 0)
    study_folder(tmp_path / "out", TINY, 0)
    with refused("work-of-another", ExistsError):
        study_folder(tmp_path / "out", TINY, 1)
    (tmp_path / "done").mkdir()
    with pytest.raises(ExistsError):
        study_folder(tmp_path / "done", TINY, 0)


def test_an_unknown_part_is_refused(tmp_path):
    with refused("unknown-name", InputError):
        reproduce_palm(tmp_path / "out", TINY, part="tables")
    assert not list(tmp_path.iterdir())


def test_a_part_that_fails_keeps_the_others_and_the_same_command_makes_it_alone(tmp_path, monkeypatch):
    made, broken = [], [True]

    def stage(name):
        def make(_):
            if name == "b" and broken:
                raise ValueError("no such thing")
            made.append(name)
            return {}

        return make

    stages = {name: stage(name) for name in "abc"}
    monkeypatch.setattr(palm_reproduction, "STAGES", stages)
    monkeypatch.setitem(palm_reproduction.PARTS, "all", stages)
    with refused("parts-failed", PalpateError):
        reproduce_palm(tmp_path / "out", TINY)
    assert made == ["a", "c"]
    assert not (tmp_path / "out").exists()
    broken.clear()
    reproduce_palm(tmp_path / "out", TINY)
    assert made == ["a", "c", "b"]
    assert (tmp_path / "out" / "summary.json").exists()


def test_a_network_is_ahead_only_where_the_intervals_over_places_do_not_overlap():
    low, high = ({"mae_low": a, "mae_high": a + 0.1} for a in (0.1, 0.21))
    between = {"mae_low": 0.15, "mae_high": 0.25}
    assert beside(low, high) == "ahead"
    assert beside(high, low) == "behind"
    for one, other in ((low, between), (between, low), (high, between)):
        assert beside(one, other) == "overlapping"


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_a_tiny_study_runs_from_end_to_end(tmp_path):
    out = tmp_path / "study"
    tiny = replace(TINY, loads=40)  # of every shape enough to hold out a fifth
    entries = reproduce_palm(out, tiny, seed=0)
    assert json.loads((out / "summary.json").read_text()) == entries
    names = [one["name"] for one in entries]
    assert len(names) == len(set(names))
    assert all(math.isfinite(one["value"]) for one in entries)
    printed = {(one["published"], one["source"]) for one in entries if one["published"] is not None}
    assert len([one for one in entries if one["published"] is not None]) == len(MAE) + len(R2)
    assert all("palm-photoelastic-2026" in source for _, source in printed)
    page = (out / "report.html").read_text()
    assert "Virtual." in page
    assert "0.244" in page
    assert page.count("data:image/png") >= 7
    with pytest.raises(ExistsError):
        reproduce_palm(out, tiny, seed=0)
