"""The reader on the page, which knows only the card and the model's file, reads what palpate reads."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.calibration_job import ReferenceRule
from palpate.core import Image, Lens
from palpate.core.reading import ReasonCode
from palpate.estimators import Estimator, read_card
from palpate.estimators.intervals import intervals_of
from palpate.estimators.model_card import CellsCard, InstrumentCard, RangeCard, StepsCard, TargetCard, sealed
from palpate.estimators.reference_uncertainty import doubt, with_reference

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "read-without-palpate.md"
WITHOUT_PALPATE = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)[0]
TOGETHER = 1e-9  # of a target's range: floating point of the interval, and the same float32 network

FISHEYE = Lens("kannala-brandt", (40.0, 41.0), (31.2, 23.9), (0.05, -0.02, 0.01, -0.002), (48, 64), 0.7)
PINHOLE = Lens("pinhole", (50.0, 51.0), (32.3, 22.8), (-0.3, 0.1, 0.01, -0.02, 0.01), (48, 64), name="wide")
CASES: dict[str, dict[str, Any]] = {
    "grey": {"size_px": (24, 32)},
    "colour-made-grey": {"size_px": (24, 32), "colour": True},
    "colour": {"size_px": (24, 32), "channels": 3, "colour": True},
    "grey-in-three-channels": {"size_px": (24, 32), "channels": 3},
    "crop": {"size_px": (16, 16), "crop_px": (7, 3, 41, 37)},
    "two-crops": {"size_px": (13, 22), "crop_px": (0, 5, 30, 31), "beside_px": (20, 2, 44, 40)},
    "difference": {"size_px": (24, 32), "delta": True},
    "sizes-that-do-not-divide": {"size_px": (17, 23), "crop_px": (1, 1, 61, 45), "colour": True},
    "one-side-enlarged": {"size_px": (60, 20), "colour": True},
    "fisheye": {"size_px": (24, 32), "lens": FISHEYE, "colour": True},
    "pinhole-crop": {"size_px": (16, 16), "crop_px": (7, 3, 41, 37), "lens": PINHOLE},
}


def colourful(image: Image) -> Image:
    """A frame whose channels differ, so that their order counts."""
    return np.stack([image, 255 - image, (image.astype(int) * 3 % 256).astype(np.uint8)], axis=2)


@pytest.fixture(params=CASES)
def compared(request, record_spots, tmp_path, monkeypatch):
    """The page's names after it was run beside a calibration, palpate's estimator, and frames."""
    case, targets = dict(CASES[request.param]), ("x_mm", "height_mm")
    colour = case.pop("colour", False)
    run = record_spots("run", 9, colour=colour)  # too few rows to try changes of the camera
    rule = ReferenceRule("reference", "true")
    calibrate(
        run,
        CalibrationPlan(targets, "pca-ridge", split="group:press", reference=rule, **case),
        tmp_path / "cal",
    )
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(WITHOUT_PALPATE, names)
    rng = np.random.default_rng(3)
    like = run.frame(0).image
    strange = [np.zeros_like(like), np.full_like(like, 255), rng.integers(0, 256, like.shape, np.uint8)]
    frames = [run.frame(i).image for i in range(0, len(run), 5)] + strange
    return names, Estimator.open("cal"), [colourful(one) for one in frames if one.ndim == 2][:4] + frames


@pytest.mark.cases(1)
def test_the_page_s_reader_reads_what_palpate_reads(compared) -> None:
    names, estimator, frames = compared
    targets = estimator.card.targets
    zero = estimator.zero(frames[0]) if estimator.card.input.delta else None
    ranges = intervals_of(estimator.card)
    allowed = set()
    for frame in frames:
        mine, readings = names["read"](frame, frames[0]), estimator.read(frame, zero)
        assert list(mine) == list(readings)
        value = np.array([[mine[target.column][0] for target in targets]])
        low, high = (ends[0] for ends in ranges.ends(value))
        for target, own_low, own_high in zip(targets, low, high, strict=True):
            reading, (estimate, *ends, meets) = readings[target.column], mine[target.column]
            near = TOGETHER * (target.greatest - target.least)
            assert [estimate, *ends] == pytest.approx(
                [reading.value, reading.low, reading.high], rel=1e-12, abs=near
            )
            assert bool(meets) == (not doubt(target, estimate, own_low, own_high))
            allowed.add(bool(meets))
            if reading.valid:
                assert meets
    assert True in allowed


def a_card_of_bands(target: TargetCard, rng: np.random.Generator) -> TargetCard:
    """The target with bands in ten cells, some of them none, limits that bind, and an instrument."""
    span = target.greatest - target.least

    def cells() -> CellsCard:
        limits = np.sort(rng.uniform(target.least, target.greatest, 9))
        half = 10 ** rng.uniform(-1, 2, 10) * (rng.random(10) < 0.7)
        return CellsCard(limits=tuple(limits), centre=tuple(rng.normal(0, 2, 10)), half=tuple(half))

    over = RangeCard(
        by_truth=cells(), by_estimate=cells(), beyond=tuple(rng.uniform(-0.4, 0.1, 2) * span),
        reach=tuple(rng.uniform(-0.2, 0.2, 2) * span), tenths=(),
    )  # fmt: skip
    instrument = InstrumentCard(
        instrument="scale", certificate="", certified_on="", standard_uncertainty=0.02, resolution=0.0,
        backlash=0.0, bias_removed=0.0, half_width=float(rng.uniform(0, 0.6) * span),
    )  # fmt: skip
    return target.model_copy(update={"over_range": over, "measured_by": instrument})


@pytest.mark.slow
def test_uneven_intervals_and_the_range_s_rule_are_those_of_the_card(plain) -> None:
    run, card = plain, read_card("cal")
    rng, refused, uneven, lengthened, by_instrument = np.random.default_rng(7), set(), 0, 0, 0
    for _ in range(25):
        targets = tuple(a_card_of_bands(target, rng) for target in card.targets)
        rewrite(card, targets)
        names: dict[str, Any] = {}
        exec(WITHOUT_PALPATE, names)
        estimator = Estimator.open("cal")
        ranges = intervals_of(estimator.card)
        for i in range(0, len(run), 7):
            frame = run.frame(i).image
            mine, readings = names["read"](frame), estimator.read(frame)
            value = np.array([[mine[target.column][0] for target in targets]])
            half = ranges.half_widths(value)[0]
            for j, target in enumerate(targets):
                reading, (estimate, low, high, meets) = readings[target.column], mine[target.column]
                near = TOGETHER * (target.greatest - target.least)
                assert [low, high] == pytest.approx([reading.low, reading.high], rel=1e-12, abs=near)
                own = tuple(float(ends[0][j]) for ends in ranges.ends(value))
                assert bool(meets) == (not doubt(target, estimate, *own))
                assert (low, high) == pytest.approx(with_reference(target, estimate, *own))
                refused.add(doubt(target, estimate, *own).code)
                bare = target.model_copy(update={"measured_by": None})
                by_instrument += bool(doubt(target, estimate, *own)) and not doubt(bare, estimate, *own)
                uneven += abs((high - estimate) - (estimate - low)) > 0.1 * (high - low)
                lengthened += own[1] - own[0] > 2.1 * half[j]
    assert refused == {"", "undetermined", "outside_range", "interval_outside_range"}
    assert uneven > 50
    assert lengthened > 50
    assert by_instrument > 10


@pytest.fixture
def plain(calibrate_spots, tmp_path, monkeypatch, changes_untried):
    """A run with a plain calibration in ``cal``, which the working folder holds."""
    monkeypatch.chdir(tmp_path)
    plan = {
        "targets": ("x_mm", "height_mm"),
        "model": "pca-ridge",
        "split": "group:press",
        "size_px": (24, 32),
    }
    return calibrate_spots(tmp_path / "cal", 16, **plan)[0]


def rewrite(card, targets) -> None:
    changed = sealed(card.model_dump(exclude={"id"}) | {"targets": targets})
    Path("cal/card.json").write_text(changed.model_dump_json())


def test_the_page_s_reader_gives_no_valid_reading_of_what_is_not_read(plain) -> None:
    run, card = plain, read_card("cal")
    x, height = card.targets
    rewrite(card, (x.model_copy(update={"score": x.score.model_copy(update={"half_width": 1e3})}), height))
    names: dict[str, Any] = {}
    exec(WITHOUT_PALPATE, names)
    estimator = Estimator.open("cal")
    codes = set()
    for i in range(0, len(run), 9):
        frame = run.frame(i).image
        mine, readings = names["read"](frame), estimator.read(frame)
        codes.add(readings["x_mm"].code)
        assert not mine["x_mm"][3]
        assert not readings["x_mm"].valid
        assert mine["height_mm"][3] or not readings["height_mm"].valid
    assert ReasonCode.NOT_LEARNED in codes


@pytest.mark.usefixtures("changes_untried")
def test_a_reader_that_knows_no_circle_stops_at_one(calibrate_spots, tmp_path, monkeypatch) -> None:
    plan = {"targets": ("x_mm",), "model": "pca-ridge", "circular": {"x_mm": 8.0}, "size_px": (24, 32)}
    calibrate_spots(tmp_path / "cal", 16, **plan)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError):
        exec(WITHOUT_PALPATE, {})


def test_grey_is_the_card_s_whole_numbers_for_every_colour() -> None:
    """OpenCV's arithmetic is not floating point, and not of 14 bits."""
    red, green = np.meshgrid(np.arange(256), np.arange(256), indexing="ij")
    for blue in range(0, 256, 17):
        image = np.stack([red, green, np.full_like(red, blue)], axis=2)
        steps = StepsCard()
        by_card = (image @ np.array(steps.grey_weights) + steps.grey_rounding) >> steps.grey_shift
        assert np.array_equal(cv2.cvtColor(image.astype(np.uint8), cv2.COLOR_RGB2GRAY), by_card)


def test_a_reader_of_one_rule_stops_at_another(plain) -> None:
    path = Path("cal/card.json")
    exec(WITHOUT_PALPATE, {})
    path.write_text(path.read_text().replace("palpate-steps/1", "palpate-steps/4"))
    with pytest.raises(AssertionError):
        exec(WITHOUT_PALPATE, {})
