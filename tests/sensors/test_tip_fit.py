"""A virtual tip fitted to taps: its kinematics by closed forms, its terms recovered, its pins named."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.refusals import refused
from typer.testing import CliRunner

import palpate
from palpate.cli import app
from palpate.core import ImageError, InputError, LabelError
from palpate.sensors.tactip import fitted_tactip
from palpate.sensors.tactip.posed_tip import POSE, PosedTip, TipTerms
from palpate.sensors.tactip.tactip_press import lattice
from palpate.sensors.tactip.taps import load_reader, register_taps, tip_fit, tip_reader
from palpate.sensors.tactip.taps.tap_folder import fit_folder
from palpate.sensors.tactip.taps.tap_pins import named_taps
from palpate.sensors.tactip.taps.tip_fit import fit_tip, judge_tip
from palpate.sensors.tactip.taps.tip_reader import TwinError

TRUE = TipTerms(
    lever_mm=0.8, camera_mm=50.0, depth_zero_mm=0.4, edge_rad=1.05, tilt_xy=-0.9, tilt_yx=0.9,
    shear_xx=-0.8, shear_yy=-0.85, twist=0.7, slip_mm=1.2,
)  # fmt: skip


def layout(rings: int = 5, pitch_px: float = 22.0) -> np.ndarray:
    """Pins about (150, 140) px; 91 in five rings."""
    steps = [
        (i, j) for i in range(-rings, rings + 1) for j in range(-rings, rings + 1) if abs(i + j) <= rings
    ]
    i, j = np.array(steps).T
    return np.stack([150 + pitch_px * (i + j / 2), 140 + pitch_px * np.sqrt(0.75) * j], axis=1)


TIP, SMALL = PosedTip(layout(), 0.5), PosedTip(layout(3, 36.7), 0.5)


def poses(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform([0.5, -20, -20, -4, -4, -5], [5.5, 20, 20, 4, 4, 5], (count, 6))


def tapped(count: int, seed: int = 0, tip: PosedTip = TIP) -> tuple[np.ndarray, np.ndarray]:
    """Taps of the true tip, each slipped by half a pixel, its pins found to a tenth."""
    at, rng = poses(count, seed), np.random.default_rng([seed, 1])
    places = tip.places_px(TRUE, at) + 0.5 * rng.standard_normal((count, 1, 2))
    return at, places + 0.1 * rng.standard_normal(places.shape)


def upright(**pose: float) -> np.ndarray:
    return np.array([[{"depth_mm": 3.0, **pose}.get(name, 0.0) for name in POSE]])


def test_plate_that_carries_all_carries_pins_by_its_own_motion() -> None:
    """Everything sticks: the middle pin goes by the shear, and all turn about it by the twist."""
    stuck = TRUE._replace(shear_xx=1.0, shear_xy=0, shear_yx=0, shear_yy=1.0, shear_rad=9.0, slip_mm=0.05,
                          twist=1.0, twist_rad=9.0)  # fmt: skip
    still, moved = (TIP.places_px(stuck, upright(shear_x_mm=s))[0] for s in (0.0, 1.0))
    shift = moved - still
    middle = int(np.argmin(np.hypot(*(TIP.rest_px - TIP.middle_px).T)))
    assert shift[middle, 0] > 0
    assert_allclose(shift[:, 1], 0, atol=0.05 * shift[middle, 0])
    other = TIP.places_px(stuck, upright(shear_y_mm=-2.0))[0] - still
    assert_allclose(other[middle], [0, -2 * shift[middle, 0]], rtol=1e-3, atol=1e-3)
    turned = TIP.places_px(stuck, upright(twist_deg=5.0))[0] - TIP.middle_px
    angle = np.deg2rad(5.0)
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    assert_allclose(turned, (still - TIP.middle_px) @ rotation, atol=0.02)


@pytest.mark.parametrize(
    ("tip", "taps", "lever_mm"), [(SMALL, 40, 0.3), pytest.param(TIP, 90, 0.15, marks=pytest.mark.slow)]
)
def test_terms_come_back_within_their_intervals_and_what_is_left_is_the_taps_own(tip, taps, lever_mm) -> None:
    """The error of the lever falls with the root of the number of pins seen."""
    fitted = fit_tip(tip, *tapped(taps, tip=tip))
    away = (np.array(fitted.terms) - np.array(TRUE)) / np.array(fitted.spread)
    told = [abs(z) for z, name in zip(away, TipTerms._fields, strict=True) if name not in fitted.untold]
    assert np.mean(np.array(told) < 1.645) > 0.6
    assert max(told) < 6
    assert abs(fitted.terms.lever_mm - TRUE.lever_mm) < lever_mm
    judged = judge_tip(fitted, tapped(taps, tip=tip), tapped(30, 7, tip))
    assert judged.residual_px < 1.3 * np.hypot(0.5, 0.1) * np.sqrt(2)
    assert judged.floor_px > judged.residual_px  # so few taps are few for a polynomial of six values
    assert judged.motion_px > 5 * judged.residual_px


def slipped(poses_: np.ndarray) -> np.ndarray:
    """What no term has: a smooth lean of the field with depth and tilt, up to 4 px."""
    lean = 0.03 * (poses_[:, :1] - 3) * poses_[:, 1:3]
    return np.clip(lean, -4, 4)[:, None, :]


@pytest.mark.slow
def test_poses_are_read_and_intervals_hold_them_where_the_tip_errs_smoothly() -> None:
    at, places = tapped(90)
    new, seen = tapped(200, 7)
    fit = fit_tip(TIP, at, places + slipped(at))
    reader = tip_reader.TipReader.learnt(fit, at, places + slipped(at))
    read = reader.read(seen + slipped(new))
    off = np.abs(read.poses - new)
    held = (off <= read.half_widths)[read.valid].mean(axis=0)
    print(off[read.valid].mean(axis=0), held, read.valid.mean())
    assert read.valid.mean() > 0.5
    assert (held > 0.8).all()
    assert off[read.valid][:, 0].mean() < 0.06
    unlearnt = replace(reader, error=replace(reader.error, off=np.zeros_like(reader.error.off) + 1e-9))
    assert np.abs(unlearnt.told(seen + slipped(new))[0] - new).mean() > 1.5 * off.mean()
    mirrored = (seen + slipped(new)).copy()
    mirrored[..., 0] = 300 - mirrored[..., 0]
    assert reader.read(mirrored).valid.mean() < 0.05
    lost = seen.copy()
    lost[:, ::2] = np.nan
    assert not reader.read(lost).valid.any()


def test_an_error_that_is_smooth_in_the_pose_is_learnt_and_left_out_taps_are_told_as_by_the_others(
    rng,
) -> None:
    at = poses(60)
    off = np.stack([at[:, 0] * at[:, 1] / 20, np.sin(at[:, 2] / 10)], axis=1) + 0.01 * rng.standard_normal(
        (60, 2)
    )
    law = TwinError.learnt(at, off)
    assert np.sqrt(np.mean(law.left_out**2)) < 0.5 * np.std(off)
    others = replace(law, known=at[1:], off=off[1:])
    assert_allclose(others.scale.half, law.scale.half)
    assert_allclose(off[0] - others.at(at[:1])[0], law.left_out[0], atol=1e-8)
    assert_allclose(law.at(at[:1], np.array([0]))[0], others.at(at[:1])[0], atol=1e-8)
    shuffled_off = off[rng.permutation(60)]
    assert np.sqrt(np.mean(TwinError.learnt(at, shuffled_off).left_out ** 2)) > 0.9 * np.std(off)


@pytest.mark.slow
def test_too_few_taps_and_poses_that_do_not_differ_are_refused() -> None:
    at, places = tapped(90)
    with refused("too-few-taps", InputError):
        fit_tip(TIP, at[:7], places[:7])
    few = fit_tip(TIP, at[:9], places[:9])
    with refused("too-few-taps", InputError):
        tip_reader.TipReader.learnt(few, at[:9], places[:9])
    same = at.copy()
    same[:, 5] = 2.0
    with refused("pose-constant", InputError):
        fit_tip(TIP, same, places)


def test_tables_that_tell_no_tip_are_refused_before_any_image_is_read(tmp_path) -> None:
    """No image lies in these folders; naming the pins of 2,000 takes minutes."""
    at = poses(12)
    table = pd.DataFrame(at, columns=POSE).assign(image_file=[f"{i}.png" for i in range(12)])
    for code, row, bad in (
        ("pose-constant", "", {"depth_mm": 3.0, "twist_deg": 2.0}),
        ("not-finite", "row 2", {"depth_mm": ""}),
        ("not-finite", "row 5", {"depth_mm": [*"123", "", *at[4:, 0]]}),
    ):
        table.assign(**bad).to_csv(tmp_path / "labels.csv", index=False)
        with refused(code, match=row or None):
            fit_folder(tmp_path, tmp_path)


def shuffled(places: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Spots of taps in any order, with specks beyond the field."""
    specks = [rng.uniform(0, 15, (3, 2)) + np.array([303.0, 283.0]) for _ in places]
    return [rng.permutation(np.concatenate([one, few])) for one, few in zip(places, specks, strict=True)]


def test_pins_get_their_names_from_each_image_alone_although_spots_come_in_any_order_with_specks(rng) -> None:
    at = poses(12, 3)
    places = TIP.places_px(TRUE, at)
    named, layout = named_taps(shuffled(places, rng), (300, 320), 91)
    good = np.isfinite(named[..., 0]).any(axis=1)
    assert good.mean() > 0.9
    order = [int(np.argmin(np.hypot(*(places[good][0] - one).T))) for one in named[good][0]]
    off = np.hypot(*(named - places[:, order])[good].transpose(2, 0, 1))
    assert np.nanmax(off) < 1e-9  # not one with another's name
    assert np.isfinite(off).mean() > 0.99
    again, _ = named_taps(shuffled(places[:3], rng), (300, 320), 91, layout=layout)
    assert_array_equal(again, named[:3])


def test_another_number_of_pins_than_the_lattices_and_spots_on_none_are_refused(rng) -> None:
    found = shuffled(TIP.places_px(TRUE, poses(3, 3)), rng)
    with refused("pin-count", InputError):
        named_taps(found, (300, 320), 127)
    with refused("no-lattice", InputError):
        named_taps([rng.uniform(0, 300, (91, 2)) for _ in range(3)], (300, 320), 91)


def drawn(folder, at, places, **change) -> None:
    (folder / "images").mkdir(parents=True)
    rows = ["image_file," + ",".join(POSE)]
    for i, (pose, one) in enumerate(zip(at, places, strict=True)):
        image = np.zeros((300, 320), np.uint8)
        for x, y in one:
            cv2.circle(image, (round(16 * x), round(16 * y)), 16 * 5, 255, -1, cv2.LINE_8, 4)
        cv2.imwrite(str(folder / "images" / f"{i}.png"), image)
        rows.append(f"{i}.png," + ",".join(f"{v:.6f}" for v in pose))
    text = "\n".join(rows)
    for before, after in change.items():
        text = text.replace(before, after)
    (folder / "labels.csv").write_text(text + "\n")


@pytest.mark.slow
def test_a_folder_is_fitted_by_the_verb_and_bad_ones_are_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(tip_fit, "ROUNDS", 4)
    monkeypatch.setattr(tip_reader, "REFITTED_BELOW", 0)  # five more fits
    at = poses(70, 3)
    at[:, 1:] *= np.linspace(0.05, 1, 70)[:, None]
    at[0] = upright(depth_mm=0.5)[0]
    places = TIP.places_px(TRUE, at)
    drawn(tmp_path / "train", at[::2], places[::2])
    drawn(tmp_path / "val", at[1::2], places[1::2])
    words = ["calibrate", "--method", "tip-pose", str(tmp_path / "train"), "--judge", str(tmp_path / "val")]
    words += ["--preset", "91", "--presses", "20"]
    said = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "out"), "--json", "--quiet"])
    assert said.exit_code == 0, said.output
    told = json.loads(said.output)
    assert told["residual_px"] < 3 < told["motion_px"]
    assert set(told["terms"]) == set(TipTerms._fields)
    assert sorted(one.name for one in (tmp_path / "out").iterdir()) == ["reader.json", "tip.json", "tip.png"]
    again = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "out"), "--quiet"])
    assert again.exit_code == 2
    images = [str(tmp_path / "val" / "images" / f"{i}.png") for i in (4, 20)]
    read = CliRunner().invoke(app, ["read", *images, "--with", str(tmp_path / "out"), "--json", "--quiet"])
    for row, true in zip(json.loads(read.output)["readings"], at[1::2][[4, 20]], strict=True):
        away = np.abs(np.array(list(row["pose"].values())) - true)
        assert (away < 4 * np.array(list(row["half_width"].values()))).all()
    blank = tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.zeros((300, 320), np.uint8))
    shown = ["read", str(blank), "--with", str(tmp_path / "out"), "--quiet", "--json"]
    (row,) = json.loads(CliRunner().invoke(app, shown).output)["readings"]
    assert not row["valid"]
    cv2.imwrite(str(blank), np.zeros((100, 100), np.uint8))
    read = CliRunner().invoke(app, shown)
    assert (read.exit_code, json.loads(read.stdout)["error"]["code"]) == (2, "image-size")
    (tmp_path / "out" / "reader.json").write_text('{"format": "other"}')
    with refused("reader-damaged", InputError):
        load_reader(tmp_path / "out")
    with refused("pin-count", InputError):
        register_taps([tmp_path / "train"], 127)
    with refused("pin-count", InputError):
        register_taps([tmp_path / "train"], 0)
    drawn(tmp_path / "few", at[:5], places[:5])
    with refused("too-few-taps", InputError):
        register_taps([tmp_path / "few"], 91)
    drawn(tmp_path / "deep", at[:12], places[:12], depth_mm="deepness")
    with refused("column-missing", LabelError, match="depth_mm"):
        register_taps([tmp_path / "deep"], 91)
    (tmp_path / "val" / "images" / "3.png").unlink()
    with refused("image-unreadable", ImageError):
        register_taps([tmp_path / "val"], 91)


def test_the_fitted_preset_is_the_terms_that_the_page_prints() -> None:
    spec = palpate.sensor("tactip-331-fitted").spec
    assert (spec.pins.count, spec.pins.length_m, spec.camera.height_m) == (331, 0.29e-3, 34.2e-3)
    assert spec == fitted_tactip()
    polar, _ = lattice(spec.pins, spec.inner_radius_m)
    assert_allclose(polar.max(), 1.00, atol=0.01)  # the field's edge, as fitted
    with pytest.raises(InputError, match="331-fitted"):
        palpate.sensor("tactip-fitted")
