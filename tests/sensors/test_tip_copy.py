"""A TacTip's copy from presses of known force: truth recovered, forces read, weights checked, refusals."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused
from typer.testing import CliRunner

from palpate.cli import app
from palpate.core import ImageError, InputError, RangeError
from palpate.estimators.unit_fit import GRAVITY_M_S2
from palpate.mechanics.axisymmetric.tip_table import tip_between
from palpate.recordings.exchange.image_import import import_press
from palpate.recordings.exchange.press_folder import write_press, write_specimens
from palpate.sensors.tactip import tactip
from palpate.sensors.tactip.tip_copies import (
    COPY_TERMS,
    PlatePress,
    designed_tip,
    fit_tip_copy,
    known_presses,
    pins_between,
    read_plate_press,
)
from palpate.sensors.tactip.tip_copies.tip_copy import SPREADS, load_tip_copy, write_tip_copy
from palpate.sensors.tactip.tip_copies.tip_copy_fit import check_tip_weight
from palpate.sensors.tactip.tip_copies.tip_estimate import TipEstimate
from palpate.sensors.tactip.tip_copies.tip_variation import TipSpread, VirtualTip, drawn_tip

DESIGN = designed_tip(tactip(127))
RATIO = 22.0
FORCES_N = (0.4, 1.2, 2.2, 3.2, 4.2)
CALM = TipSpread(glare=(0.0, 0.0))  # whose frames are found faster


def copy_of(seed: int) -> VirtualTip:
    return drawn_tip(DESIGN.spec, tip_between(math.log(RATIO)), np.random.default_rng(seed), CALM)


def pressed(tip: VirtualTip, force_n: float, rng, *, position: bool = False, **lean) -> PlatePress:
    depth = tip.depth_m(force_n)
    sd = math.hypot(0.005 * force_n, 0.01)
    told = force_n + sd * float(rng.standard_normal())
    pins = pins_between(*tip.frames(depth, rng, **lean), 127)
    return PlatePress(*pins, told, sd, 7e-3 + depth if position else None)


@pytest.fixture(scope="module")
def tip() -> VirtualTip:
    return copy_of(4)


@pytest.fixture(scope="module")
def presses(tip):
    rng = np.random.default_rng(11)
    return [pressed(tip, f, rng, position=True) for f in FORCES_N]


@pytest.fixture(scope="module")
def fitted(presses):
    return fit_tip_copy(DESIGN, presses)


def test_five_known_forces_tell_stiffness_ratio_lever_camera_and_the_stage_s_zero(tip, fitted) -> None:
    true = {
        "stiffness": math.log(tip.force_n(3e-3) / DESIGN.stated_force_n), "ratio": math.log(RATIO),
        "lever_mm": 1e3 * tip.spec.pins.length_m, "camera_mm": 1e3 * tip.spec.camera.height_m,
        "axis_x_mm": 1e3 * tip.axis_m[0], "axis_y_mm": 1e3 * tip.axis_m[1],
    }  # fmt: skip
    told = fitted.copy.told
    away = {n: (told[n]["value"] - t) / told[n]["standard_deviation"] for n, t in true.items()}
    assert max(map(abs, away.values())) < 3, away
    assert abs(told["stiffness"]["value"] - true["stiffness"]) < 0.03
    assert abs(told["ratio"]["value"] - true["ratio"]) < 0.15
    assert abs(true["ratio"] - DESIGN.terms[1]) > 0.3  # as far from the design
    assert_allclose(fitted.zeros[0].zero_mm, 7.0, atol=0.05)
    skin, gel = fitted.copy.moduli_pa
    scale = tip.force_ratio
    assert_allclose([skin, gel], [scale * tip.tip.skin_pa, scale * tip.tip.gel_pa], rtol=0.15)
    assert max(one.off_px for one in fitted.presses) < 0.1


def test_forces_and_depths_of_new_presses_are_read_and_intervals_hold_them(tip, fitted) -> None:
    rng = np.random.default_rng(12)
    for force_n in (3.9,):
        read = read_plate_press(fitted.copy, pressed(tip, force_n, rng))
        assert abs(read.force_n - force_n) < 0.02 * force_n + 0.01
        assert abs(math.log(read.force_n / force_n)) < 3 * read.force_share < 0.1
        assert abs(read.depth_mm - 1e3 * tip.depth_m(force_n)) < 3 * read.depth_sd_mm < 0.2


def test_slopes_are_those_of_the_rows(presses) -> None:
    estimate = TipEstimate(DESIGN, presses[::2])
    state = estimate._start()
    state[:10] += 0.3 * np.array([SPREADS[name] for name in COPY_TERMS]) * np.array([1, -1] * 5)
    blocks, sure = list(estimate.blocks(state)), estimate.known(state)
    rng = np.random.default_rng(0)
    scale = np.ones(len(state))
    scale[:10] = [SPREADS[name] for name in COPY_TERMS]
    for _ in range(3):
        step = 1e-4 * scale * rng.standard_normal(len(state))
        ends = [(list(estimate.residuals(one)), estimate.known(one)) for one in (state - step, state + step)]
        (before, sure_before), (after, sure_after) = ends
        for block, (low, _), (high, _) in zip(blocks, before, after, strict=True):
            change = (low - high) / 2
            assert_allclose(block.slopes @ step[block.at], change, atol=2e-3 * np.abs(change).max())
        for row, low, high in zip(sure, sure_before, sure_after, strict=True):
            assert_allclose(row.slopes @ step, (low.off - high.off) / 2, rtol=2e-3, atol=1e-7)


def test_a_press_without_a_force_leaves_the_stiffness_untold(presses) -> None:
    alone = fit_tip_copy(DESIGN, [replace(presses[2], force_n=None, position_m=None)], advise=False)
    assert "stiffness" in alone.untold


@pytest.mark.slow
def test_a_stage_s_position_is_what_would_help_without_one(presses, fitted) -> None:
    blind = fit_tip_copy(DESIGN, [replace(one, position_m=None) for one in presses])
    assert "stage-position" in [one.press for one in blind.helpful]
    assert all(one.ratio < 0.9 and one.term in COPY_TERMS for one in blind.helpful)
    assert (
        fitted.copy.told["edge_rad"]["standard_deviation"]
        < 0.9 * (blind.copy.told["edge_rad"]["standard_deviation"])
    )
    assert "stiffness" not in blind.untold


@pytest.mark.parametrize(
    ("skin", "gel", "drifted"),
    [
        (1.0, 1.0, ()),
        (1.15, 1.15, ("stiffness",)),
        (0.85, 0.85, ("stiffness",)),
        (1.0, 1.3, ("stiffness", "ratio")),
    ],
)
@pytest.mark.cases(1)
def test_a_known_weight_sees_what_has_changed(tip, fitted, skin: float, gel: float, drifted) -> None:
    before, now = tip_between(math.log(RATIO)), tip_between(math.log(RATIO * skin / gel))
    changed = replace(tip, tip=now, force_ratio=tip.force_ratio * gel * before.gel_pa / now.gel_pa)
    weight_n = 0.25 * GRAVITY_M_S2
    check = check_tip_weight(fitted.copy, [pressed(changed, weight_n, np.random.default_rng(14))], 0.25)
    assert check.drifted == drifted
    assert_allclose(check.force_n, weight_n)
    assert check.least_change < 0.1
    if skin == gel:
        assert_allclose(check.stiffness_change, skin - 1, atol=0.03)
    else:
        assert check.ratio_change < -0.1 < 0 < check.stiffness_change


@pytest.mark.slow
def test_a_weight_that_leans_slides_or_moves_is_refused(tip, fitted) -> None:
    rng = np.random.default_rng(15)
    with refused("weight-inclined", ImageError):
        check_tip_weight(fitted.copy, [pressed(tip, 2.0, rng, lean_rad=(math.radians(3), 0.0))], 0.2)
    one = pressed(tip, 2.0, rng)
    with refused("weight-moved", ImageError):
        check_tip_weight(fitted.copy, [one, pressed(tip, 2.2, rng)], 0.2)
    to_and_fro = [pressed(tip, 2.0, rng, lean_rad=(math.radians(lean), 0.0)) for lean in (1.4, -1.4)]
    with refused("weight-moved", ImageError):
        check_tip_weight(fitted.copy, to_and_fro, 0.2)
    pushed = replace(one, moved_px=one.moved_px + np.array([4.0, 0.0]))
    with refused("weight-slid", ImageError):
        check_tip_weight(fitted.copy, [pushed], 0.2)
    with refused("mass-range", RangeError):
        check_tip_weight(fitted.copy, [one], 0.0)


@pytest.mark.slow
def test_shuffled_forces_one_load_and_another_tip_s_frames_are_refused(tip, presses, fitted) -> None:
    order = [3, 0, 4, 1, 2]
    wrong = [
        replace(one, force_n=presses[k].force_n, position_m=None)
        for one, k in zip(presses, order, strict=True)
    ]
    with pytest.raises((RangeError, ImageError)) as caught:
        fit_tip_copy(DESIGN, wrong)
    assert caught.value.code in ("forces-differ", "pins-differ")
    with refused("one-load", InputError):
        fit_tip_copy(DESIGN, [replace(one, force_n=2.0 + 0.1 * i) for i, one in enumerate(presses)])
    other = pressed(copy_of(5), 2.0, np.random.default_rng(16))
    with refused("tip-differs", ImageError):
        read_plate_press(fitted.copy, other)
    bent = replace(presses[2], moved_px=2 * presses[2].rest_px - presses[2].moved_px)  # inwards
    with refused("pins-differ", ImageError):
        read_plate_press(fitted.copy, bent)
    for what in ({"force_n": -1.0}, {"force_sd_n": 0.0}):
        with refused("not-positive", InputError):
            replace(presses[0], **what)
    with refused("no-presses", InputError):
        fit_tip_copy(DESIGN, [])
    with refused("not-positive", RangeError):
        designed_tip(tactip(127), SPREADS | {"ratio": 0.0})


def test_a_copy_goes_through_its_file_and_another_file_is_refused(tmp_path: Path, fitted) -> None:
    write_tip_copy(fitted.copy, "127", tmp_path / "c.json")
    again = load_tip_copy(tmp_path / "c.json")
    for name in ("terms", "covariance", "rest_px", "cells"):
        assert_allclose(getattr(again, name), getattr(fitted.copy, name))
    with refused("no-presses", InputError):
        write_tip_copy(DESIGN, "127", tmp_path / "d.json")
    with refused("file-missing", InputError):
        load_tip_copy(tmp_path / "none.json")
    record = json.loads((tmp_path / "c.json").read_text())
    record["covariance"][0][0] = -1.0
    (tmp_path / "c.json").write_text(json.dumps(record))
    with refused("unit-damaged", InputError):
        load_tip_copy(tmp_path / "c.json")


def recorded(folder: Path, tip: VirtualTip, number: str, rng) -> None:
    """A press as a rig writes it: the untouched tip, and frames on the way down."""
    depth = np.array([-0.5e-3, *(tip.depth_m(f) for f in (0.5, 1.5, 3.0))])
    rest, frames = None, []
    state = rng.integers(1 << 31)
    for d in depth:  # one seat for all frames of a press
        calm = replace(tip, press_rad=0.0, slip_px=0.0)
        rest, image = calm.frames(max(d, 0.0), np.random.default_rng(state))
        frames.append(rest if d < 0 else image)
    force = [0.0 if d < 0 else tip.force_n(d) for d in depth]
    rows = pd.DataFrame(
        {
            "time_s": 0.05 * np.arange(4),
            "force_raw_N": force,
            "actual_mm": 1e3 * (depth + 3e-3),
            "frame": range(4),
        }
    )
    write_press(folder, number, frames, rows)


@pytest.mark.slow
def test_verbs_calibrate_a_folder_and_a_run_read_a_force_and_weigh(tmp_path: Path, tip) -> None:
    rng = np.random.default_rng(17)
    folder = tmp_path / "presses"
    for number in ("01", "02"):
        recorded(folder / "rigid", tip, number, rng)
        recorded(folder / "S1", tip, number, rng)
    write_specimens(folder, {"rigid": math.inf, "S1": 3e3})
    import_press(folder / "rigid" / "01.tif", tmp_path / "run", force=folder / "rigid" / "01.csv")
    from_folder, from_run = known_presses([folder], 6, 127), known_presses([tmp_path / "run"], 3, 127)
    assert sorted({one.approach for one in from_folder}) == [0, 1]
    assert_allclose([one.force_n for one in from_run], [0.5, 1.5, 3.0], rtol=1e-4)
    assert_allclose(
        np.diff([one.position_m for one in from_run]), np.diff([tip.depth_m(f) for f in (0.5, 1.5, 3)])
    )
    with refused("press-count", InputError):
        known_presses([folder], 7, 127)
    out = tmp_path / "copy.json"
    words = ["calibrate", "--method", "tip-unit", str(folder), "--presses", "5", "--out", str(out), "--quiet"]
    said = CliRunner().invoke(app, [*words, "--json"])
    assert said.exit_code == 0, said.output
    told = json.loads(said.output)
    assert abs(told["force_at_3_mm_N"] / tip.force_n(3e-3) - 1) < 0.05
    assert len(told["zeros"]) == 2
    assert CliRunner().invoke(app, words).exit_code == 2  # the file is there
    weight_n = 0.2 * GRAVITY_M_S2
    for name, image in zip(("rest", "w"), tip.frames(tip.depth_m(weight_n), rng), strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    common = ["--reference", str(tmp_path / "rest.png"), "--with", str(out), "--quiet"]
    read = CliRunner().invoke(app, ["read", str(tmp_path / "w.png"), *common, "--json"])
    assert abs(json.loads(read.output)["force_N"] / weight_n - 1) < 0.04
    for mass, drifted in (("200", []), ("240", ["stiffness"])):
        words = ["check-weight", str(tmp_path / "w.png"), *common, "--mass-g", mass, "--json"]
        weighed = CliRunner().invoke(app, words)
        assert json.loads(weighed.output)["drifted"] == drifted, weighed.output


def test_another_number_of_pins_or_size_of_frames_is_refused(tip) -> None:
    rest, image = tip.frames(2e-3, np.random.default_rng(18))
    with refused("pin-count", ImageError):
        pins_between(rest, image, 331)
    with refused("image-size", ImageError):
        pins_between(rest, image[:-1], 127)
    with refused("force-range", RangeError):
        tip.depth_m(1e3)
