"""One copy of the palm from its own pictures: what they tell, what they cannot, and what a weight adds."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import (
    ExistsError,
    ImageError,
    InputError,
    ManualClock,
    Pose,
    RangeError,
    silent,
)
from palpate.core.errors import MisfitError
from palpate.estimators.unit_fit import GRAVITY_M_S2, most_probable
from palpate.optics.stress_optic import StressOpticLaw
from palpate.recordings import Manifest, RunWriter
from palpate.sensors.palm.copies import palm_copy_fit
from palpate.sensors.palm.copies.copy_estimate import joined
from palpate.sensors.palm.copies.palm_copy import (
    LOCAL,
    TERMS,
    CopyFit,
    PalmCopy,
    PicturedPress,
    PressFound,
    Widening,
    designed_copy,
    measured_copy,
)
from palpate.sensors.palm.copies.palm_copy_fit import (
    _estimate_at,
    _first_looks,
    check_weight,
    fit_copy,
    pictured,
    pictured_presses,
    read_copy,
    read_press,
    refuse_far,
    refuse_misfit,
    write_copy,
)
from palpate.sensors.palm.copies.press_picture import seen_press
from palpate.sensors.palm.palm_press import press, press_to_force
from palpate.sensors.palm.palm_render import render
from palpate.sensors.palm.palm_spec import PalmSpec, palm, scaled_down
from palpate.sensors.palm.probe_shapes import parse_probe

DESIGN = scaled_down(palm(), 20, "tiny")
E, C = DESIGN.youngs_modulus_pa, DESIGN.stress_optic.coefficient_per_pa


def own(modulus: float = 1.0, coefficient: float = 1.0, **others: float) -> PalmSpec:
    """A palm by shares of the design's E and C."""
    law = StressOpticLaw(coefficient * C)
    return replace(DESIGN, youngs_modulus_pa=modulus * E, stress_optic=law, **others)


def taken(spec: PalmSpec, force_n: float, x_m: float, y_m: float, *, known: bool = True) -> PicturedPress:
    """A press on a palm, drawn by the exact way with the camera's noise."""
    rng = np.random.default_rng(round(1e3 * force_n))
    contact = press_to_force(spec, force_n, x_m, y_m)
    rest = press(spec, Pose(x_m, y_m, -1e-3))
    images = (render(one, spec, rng, exact=True).image for one in (contact, rest))
    if not known:
        return PicturedPress(*images)
    return PicturedPress(*images, force_n, 0.005, (x_m, y_m))


TRUE = own(1.12, 0.91, lamp_gain=1.06, polariser_rad=math.pi / 4 + 0.02)


@pytest.fixture(scope="module")
def fitted() -> PalmCopy:
    presses = [taken(TRUE, 2.0, 4e-3, 2e-3), taken(TRUE, 5.0, -3e-3, -5e-3)]
    return fit_copy(designed_copy(DESIGN), presses).copy


def test_a_picture_holds_the_product_of_modulus_and_coefficient_and_neither_alone() -> None:
    known, at = designed_copy(DESIGN), Pose(3e-3, 1e-3, 2e-3)

    def seen(log_modulus: float, log_product: float) -> np.ndarray:
        terms = known.terms.copy()
        terms[:2] = log_modulus, log_product
        return pictured(replace(known, terms=terms), at)

    assert np.array_equal(seen(0.3, 0.1), seen(-0.2, 0.1))
    assert np.abs(seen(0.0, 0.1) - seen(0.0, 0.0)).max() > 0.02
    spec = own(1.3, 1 / 1.3)
    whole = replace(known, spec=spec)
    assert np.abs(pictured(whole, at) - seen(0.0, 0.0)).max() < 1e-4


def test_a_measured_coefficient_is_the_copy_s_and_leaves_its_modulus_the_design_s() -> None:
    known = measured_copy(DESIGN, 1.2 * C, 0.03, 0.2)
    assert known.coefficient_per_pa == pytest.approx(1.2 * C)
    assert known.modulus_pa == pytest.approx(E)
    assert (known.modulus_share, known.coefficient_share) == pytest.approx((0.2, 0.03))
    for wrong in (1e12 * C, 0.0, -C, math.nan, C / 6):
        with refused("coefficient-range", RangeError):
            measured_copy(DESIGN, wrong)
    for code, *shares in (
        ("ratio-range", 2.0, 0.2),
        ("ratio-range", 0.02, 25),
        ("not-positive", 0.0, 0.2),
        ("not-positive", 0.02, math.nan),
    ):
        with refused(code, RangeError):
            measured_copy(DESIGN, C, *shares)


@pytest.mark.slow
def test_two_known_forces_tell_modulus_coefficient_lamp_and_polariser(fitted: PalmCopy) -> None:
    assert fitted.modulus_pa == pytest.approx(1.12 * E, rel=0.03)
    assert fitted.coefficient_per_pa == pytest.approx(0.91 * C, rel=0.03)
    told = fitted.told
    assert told["lamp"]["value"] == pytest.approx(math.log(1.06), abs=0.02)
    assert told["polariser_rad"]["value"] == pytest.approx(0.02, abs=0.01)
    assert fitted.modulus_share < 0.06


@pytest.mark.slow
@pytest.mark.parametrize(
    ("modulus", "coefficient", "drifted"),
    [
        (1.0, 1.0, ()),
        (1.0, 1.15, ("coefficient",)),
        (1.15, 1.0, ()),  # of so small a picture E is told to 8 % (standard deviation) alone
        (1.15, 1 / 1.15, ("coefficient",)),
    ],
)
def test_a_known_weight_tells_what_has_changed_and_names_what_it_is_sure_of(
    fitted: PalmCopy, modulus: float, coefficient: float, drifted: tuple[str, ...]
) -> None:
    now = own(1.12 * modulus, 0.91 * coefficient, lamp_gain=1.06, polariser_rad=math.pi / 4 + 0.02)
    press_ = taken(now, 2.0, 1e-3, -2e-3, known=False)
    check, _ = check_weight(fitted, press_.image, press_.reference, 2.0 / GRAVITY_M_S2)
    assert check.drifted == drifted
    assert check.force_n == pytest.approx(2.0)
    assert math.log1p(check.modulus_change) == pytest.approx(math.log(modulus), abs=0.04)
    assert math.log1p(check.coefficient_change) == pytest.approx(math.log(coefficient), abs=0.04)
    assert check.read_n == pytest.approx(2.0 * coefficient, rel=0.05)


@pytest.mark.parametrize(
    ("way", "moved_m", "rolled"), [("x_m", 0.11e-3, False), ("x_m", -0.3e-3, True), ("y_m", 0.3e-3, True)]
)
def test_a_weight_that_rolls_between_two_pictures_is_refused(monkeypatch, way, moved_m, rolled) -> None:
    known, picture = designed_copy(DESIGN), np.zeros((2, 2, 3), np.uint8)
    later = picture + np.uint8(1)
    first = PressFound(1e-3, -1e-3, 2e-3, 2.0, 2e-5, 2e-5, 1e-5, 0.01, 0.004)
    then = first._replace(**{way: getattr(first, way) + moved_m})
    monkeypatch.setattr(palm_copy_fit, "fit_copy", lambda *_, **__: CopyFit(known, (then,), ()))
    found = CopyFit(known, (first,), ())
    if rolled:
        with pytest.raises(InputError, match=re.escape(f"moved by {1e3 * moved_m:+.2f} mm along {way[0]}")):
            palm_copy_fit.refuse_rolling(found, picture, later, picture)
    else:
        palm_copy_fit.refuse_rolling(found, picture, later, picture)
    with pytest.raises(InputError, match="the same"):
        palm_copy_fit.refuse_rolling(found, picture, picture, picture)


def test_pictures_and_numbers_that_cannot_be_are_refused() -> None:
    fitted = designed_copy(DESIGN)
    press_ = taken(TRUE, 2.0, 0.0, 0.0, known=False)
    with refused("no-presses", InputError):
        fit_copy(fitted, [])
    with refused("press-not-seen", ImageError):
        read_press(fitted, press_.reference, press_.reference)
    with refused("image-size", ImageError):
        read_press(fitted, press_.image[:-1], press_.reference[:-1])
    with refused("force-range", RangeError):
        fit_copy(fitted, [replace(press_, force_n=-1.0)])
    with refused("mass-range", RangeError):
        check_weight(fitted, press_.image, press_.reference, math.nan)
    with refused("not-positive", RangeError):
        designed_copy(DESIGN, modulus_share=0.0)


def test_a_light_press_is_seen_in_the_mirror_and_noise_is_not() -> None:
    """A press of 0.4 N changes the mirror's picture by 2 to 3 % of white, two untouched frames by 1.2 %."""
    rng, known = np.random.default_rng(3), designed_copy(DESIGN, modulus_share=0.01, coefficient_share=0.01)
    contacts = (press(DESIGN, Pose(2e-3, 1e-3, one)) for one in (0.25e-3, -1e-3, -1e-3))
    pressed, rest, again = (render(one, DESIGN, rng, exact=True).image for one in contacts)
    (look,) = _first_looks(known, seen_press(DESIGN, PicturedPress(pressed, rest))).values()
    assert math.hypot(look.place[0] - 2e-3, look.place[1] - 1e-3) < 4e-3
    with refused("press-not-seen", ImageError):
        _first_looks(known, seen_press(DESIGN, PicturedPress(again, rest)))


@pytest.mark.parametrize(("off", "fits"), [(0.0118, True), (0.0120, False)])
def test_a_reading_is_refused_above_the_stated_multiple_of_a_pixel_s_error(
    monkeypatch, off: float, fits: bool
) -> None:
    """Presses of the palm's ball reach 0.0110 of white; probes that were read wrongly begin at 0.0127."""
    found, picture = (
        PressFound(0.0, 0.0, 2e-3, 3.0, 1e-5, 1e-5, 1e-5, 0.1, off),
        np.zeros((2, 2, 3), np.uint8),
    )
    known = designed_copy(DESIGN)
    monkeypatch.setattr(palm_copy_fit, "fit_copy", lambda *_: CopyFit(known, (found,), ()))
    if fits:
        assert read_press(known, picture, picture) is found
    else:
        with pytest.raises(MisfitError):
            read_press(known, picture, picture)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("probe", "depth_m", "start_m", "fits"),
    [
        (None, 1.2e-3, 1.2e-3, True),
        (None, 2.5e-3, 2.5e-3, True),
        ("sphere:5", 1.2e-3, 0.9e-3, False),  # read as 0.91 +- 0.04 mm before
        ("punch:6", 1.2e-3, 1.75e-3, False),  # read as 1.75 +- 0.08 mm before
    ],
)
def test_a_picture_of_another_probe_misfits_and_one_of_the_palm_s_ball_does_not(
    probe: str | None, depth_m: float, start_m: float, fits: bool
) -> None:
    """The estimate begins where the whole search ends, so that the test stays short."""
    place = 2e-3, 1e-3
    shape, rng = None if probe is None else parse_probe(probe), np.random.default_rng(1)
    contacts = (press(DESIGN, Pose(*place, one), shape) for one in (depth_m, -1e-3))
    shown = PicturedPress(*(render(one, DESIGN, rng, exact=True).image for one in contacts))
    known = designed_copy(DESIGN, modulus_share=0.01, coefficient_share=0.01)
    local = np.zeros((1, len(LOCAL)))
    local[0, :3] = *place, math.log(start_m)
    state, seen = joined(known.terms, local), [seen_press(DESIGN, shown)]
    estimate = _estimate_at(known, seen, state)
    (found,) = estimate.fit(most_probable(estimate, state, silent, rounds=3)).presses
    if fits:
        refuse_misfit(found)
        assert found.misfit < 1.0
    else:
        with pytest.raises(MisfitError):
            refuse_misfit(found)


@pytest.mark.parametrize("unit", [1e3, 1 / 4.44822])  # mN, lbf
def test_forces_in_another_unit_are_refused_since_no_picture_shows_them(unit: float) -> None:
    known = designed_copy(DESIGN)

    def by(modulus: float) -> PalmCopy:
        terms = known.terms.copy()
        terms[0] = math.log(modulus)  # the product, which pictures tell, stays
        return replace(known, terms=terms)

    with pytest.raises(RangeError, match=re.escape(f"E is {unit:.3g} and C {1 / unit:.3g} times")):
        refuse_far(known, by(unit))
    refuse_far(known, by(1.8))
    refuse_far(known, by(1 / 1.8))


def test_a_copy_goes_through_its_file_and_another_file_is_refused(tmp_path: Path) -> None:
    from palpate.sensors.palm.copies.palm_copy_fit import design_for

    known = design_for("debug", (108, 192))
    known = replace(
        known, terms=known.terms + 0.01 * np.arange(len(TERMS)), widening=Widening(1.5, 2.0, 1.25, 6),
        local_spreads=(0.01, 0.02, 0.03, 0.04, 0.05),
    )  # fmt: skip
    write_copy(known, "debug", tmp_path / "mine.json")
    again = read_copy(tmp_path / "mine.json")
    assert np.array_equal(again.terms, known.terms)
    assert np.array_equal(again.covariance, known.covariance)
    assert again.spec == known.spec
    assert (again.widening, again.local_spreads) == (known.widening, known.local_spreads)
    with pytest.raises(ExistsError):
        write_copy(known, "debug", tmp_path / "mine.json")
    record = json.loads((tmp_path / "mine.json").read_text())
    for changed in (
        {"format": "other"},
        {"covariance": [[1.0]]},
        {"terms": {}},
        {"preset": "none"},
        {"widening": {"place": 0.5}},  # held-out presses make no interval narrower
        {"widening": {"place": "wide"}},
        {"frame_px": [math.inf, 108]},
        {"terms": record["terms"] | {"lamp": 1e4}},
    ):
        (tmp_path / "other.json").write_text(json.dumps(record | changed))
        with pytest.raises(InputError):
            read_copy(tmp_path / "other.json")
    few = dict(list(record["terms"].items())[:22])  # as an earlier format had them
    (tmp_path / "other.json").write_text(json.dumps(record | {"format": "palpate palm copy 2", "terms": few}))
    with refused("unit-format", InputError):
        read_copy(tmp_path / "other.json")
    with refused("frame-size", ImageError):
        design_for("debug", (100, 100))


def run_of(path: Path, presses: list[dict]) -> Path:
    """A run of presses, each an image of its number after one of 100 more, untouched."""
    kinds = {"press": "text", "reference": "flag", "force_N": "number", "x_mm": "number", "y_mm": "number",
             "indenter": "text", "phase": "text"}  # fmt: skip
    clock, manifest = ManualClock(), Manifest.new(sensor="palm", labels=kinds)
    with RunWriter.create(path, manifest, clock=clock, overflow="wait") as writer:
        for i, told in enumerate(presses, 1):
            for is_rest in (True, False):
                clock.sleep(0.1)
                held = {"x_mm": 0.0, "y_mm": 0.0, "indenter": "sphere:10", "phase": "down", "press": f"{i}"}
                held |= told | {"reference": is_rest}
                held |= {"force_N": 0.0, "phase": "reference"} if is_rest else {}
                writer.frame(np.full((8, 16, 3), 100 * is_rest + i, np.uint8), labels=held)
    return path


def test_presses_of_a_run_are_spread_over_force_and_near_enough_to_the_middle(tmp_path: Path) -> None:
    """Twelve of 1 to 12 N, 2 mm farther out each: of those within 15 mm, least and most and one between."""
    run = run_of(
        tmp_path / "run", [{"force_N": 1.0 * i, "x_mm": 1.2 * i, "y_mm": -1.6 * i} for i in range(1, 13)]
    )
    near = pictured_presses(run, 3, 0.01, within_m=15e-3)
    assert [one.force_n for one in near] == [2.0, 4.0, 7.0]  # 1 N is less than a tenth of 12 N
    assert [int(one.image[0, 0, 0]) for one in near] == [2, 4, 7]
    assert [int(one.reference[0, 0, 0]) for one in near] == [102, 104, 107]
    np.testing.assert_allclose(near[0].place_m, (2.4e-3, -3.2e-3))
    assert len(pictured_presses(run, 11, 0.01)) == 11
    with refused("press-count", InputError):
        pictured_presses(run, 7, 0.01, within_m=15e-3)


def test_presses_by_another_probe_sideways_or_of_another_sign_are_no_copy_s(tmp_path: Path) -> None:
    def shots(sign: float) -> list[dict]:
        others = ({}, {"phase": "lateral"}, {"indenter": "sphere:8"}, {"indenter": "punch:8"})
        return [{"force_N": sign * n} | one for n, one in zip((1.0, 2.0, 3.0, 40.0), others, strict=True)]

    pressed = run_of(tmp_path / "pressed", shots(1.0))
    (own_,) = pictured_presses(pressed, 1, 0.01, ball="sphere:10")  # 1 N, though another's press had 40 N
    assert own_.force_n == 1.0
    with refused("indenter-differs", InputError):
        pictured_presses(pressed, 1, 0.01, ball="sphere:12")
    with refused("force-sign", InputError):
        pictured_presses(run_of(tmp_path / "pulled", shots(-1.0)), 1, 0.01, ball="sphere:10")
