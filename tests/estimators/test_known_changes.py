"""A guard that knows its model refuses what costs it and no more, and says what a frame looks like."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.oracles.plain_guard_features import features as plain_features

from palpate.core import CertificateError
from palpate.estimators.guard import (
    ChangeExamples,
    KnownChanges,
    NoveltyDetector,
    Registration,
    Verdict,
    cross_fitted,
    fit_known_changes,
    fit_novelty_detector,
    image_features,
    rescaled,
    thumbnails,
)

FEATURES = 20
TOUCH = np.linspace(1, 3, FEATURES)  # what a touch moves
NAMES = ("focus", "dust")
COSTLY, FREE = 7, 12  # the feature that a costly change moves, and a free one


def examples(rng: np.random.Generator, frames: int = 150, each: int = 120) -> ChangeExamples:
    """Frames whose features a touch moves together; focus moves one feature and costs, dust another one."""
    clean = 5 * rng.normal(size=(frames, 1)) * TOUCH + rng.normal(size=(frames, FEATURES))
    parts, frame, kind, harm, novelty = [clean], [np.arange(frames)], [0] * frames, [0.0] * frames, []
    novelty += rng.uniform(0.4, 1.0, frames).tolist()
    for number, feature in ((1, COSTLY), (2, FREE)):
        chosen, size = rng.integers(0, frames, each), rng.uniform(0, 20, each)
        changed = clean[chosen] + 0.3 * rng.normal(size=(each, FEATURES))
        changed[:, feature] += size
        parts.append(changed)
        frame.append(chosen)
        kind += [number] * each
        harm += (np.maximum(size - 6, 0) / 100 * (number == 1)).tolist()
        novelty += (0.7 + size / 8).tolist()
    return ChangeExamples(
        np.concatenate(parts), np.concatenate(frame), np.array(kind), np.array(harm), np.array(novelty), NAMES
    )


@pytest.fixture(scope="module")
def registration() -> Registration:
    return Registration.fit(np.random.default_rng(0).uniform(0, 255, (20, 8, 8, 1)).astype(np.float32))


@pytest.fixture(scope="module")
def known(registration) -> KnownChanges:
    return fit_known_changes(examples(np.random.default_rng(1)), registration)


def changed(rng: np.random.Generator, feature: int, size: float) -> np.ndarray:
    new = 5 * rng.normal() * TOUCH + rng.normal(size=FEATURES)
    new[feature] += size
    return new


def verdicts(known: KnownChanges, feature: int, size: float, novelty: float) -> list[Verdict]:
    rng = np.random.default_rng(2)
    return [known.judge(changed(rng, feature, size), novelty) for _ in range(60)]


def share(found: list[Verdict]) -> float:
    return float(np.mean([one.atypicality > 1 for one in found]))


def test_what_costs_is_refused_and_named_and_as_large_a_change_that_costs_nothing_passes(known) -> None:
    costly, free = verdicts(known, COSTLY, 15, 2.5), verdicts(known, FREE, 15, 2.5)
    assert share(costly) >= 0.95
    assert share(free) <= 0.05
    assert share(verdicts(known, COSTLY, 0, 0.8)) <= 0.03
    assert np.mean([one.kind == "focus" and one.costs for one in costly]) >= 0.95
    assert np.mean([one.kind == "dust" for one in free]) >= 0.95


def test_where_no_example_is_near_the_thumbnails_own_limit_holds(known) -> None:
    for feature in (3, 17):
        far = verdicts(known, feature, 40, 1.2)
        assert not any(one.known for one in far)
        assert share(far) == 1.0
        assert share(verdicts(known, feature, 40, 0.9)) <= 0.1


def test_without_harm_the_same_change_passes(registration) -> None:
    free = examples(np.random.default_rng(1))
    unharmed = fit_known_changes(replace(free, harm=np.zeros_like(free.harm)), registration)
    assert share(verdicts(unharmed, COSTLY, 15, 2.5)) <= 0.05


def test_examples_of_a_frame_do_not_vouch_for_each_other(registration) -> None:
    many = examples(np.random.default_rng(3))
    one = int(np.flatnonzero((many.kind == 1) & (many.harm > 0.05))[0])
    calm = replace(many, harm=np.where(many.frame == many.frame[one], many.harm, 0.0))
    folds = [np.arange(k, 150, 5) for k in range(5)]
    assert cross_fitted(calm, registration, folds)[one].atypicality < 5
    assert len(cross_fitted(calm, registration, folds)) == len(many.frame)


def test_limits_let_all_but_the_share_allowed_pass(known) -> None:
    unchanged = np.linspace(0, 4, 101)
    wider, factor = rescaled(known, unchanged)
    assert factor == pytest.approx(3.88)
    features = np.zeros(FEATURES)
    assert wider.judge(features, 0.9).atypicality == pytest.approx(
        known.judge(features, 0.9).atypicality / factor
    )
    assert rescaled(known, unchanged / 10)[1] == 1.0


def pins(shift: float = 0.0, blur: float = 0.0, turn: float = 0.0, large: float = 1.0) -> np.ndarray:
    """Bright discs on a dark ground ``[h w 1]``, seen by a camera a little elsewhere; so much larger."""
    y, x = np.mgrid[0:96, 0:96] * 1.0
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    x, y = c * (x - 47.5) + s * (y - 47.5) + 47.5 - shift, -s * (x - 47.5) + c * (y - 47.5) + 47.5
    across, along = x / large % 16 - 8, y / large % 12 - 6
    image = 20 + 200 / (1 + np.exp(2 * (np.hypot(across, along) - 3)))
    image *= np.exp(-((x - 60) ** 2 + (y - 30) ** 2) / 4000)
    return np.rint(cv2.GaussianBlur(image, (0, 0), blur) if blur else image).astype(np.uint8)[..., None]


def test_a_registration_finds_shift_and_turn_in_their_own_units() -> None:
    """A thumbnail is a third of the image: 0.6 px of 96 are 0.2 of 32."""
    found = Registration.fit(np.repeat(thumbnails([pins(large=3)]), 3, axis=0))
    moved = found.features(thumbnails([pins(shift=0.6, large=3)])[0])
    assert moved[0] == pytest.approx(0.2, rel=0.15)
    assert abs(moved[1]) < 0.02
    turned = found.features(thumbnails([pins(turn=0.5, large=3)])[0])
    assert turned[2] == pytest.approx(np.radians(0.5), rel=0.15)


def test_features_are_those_of_the_plain_computation_to_1e_9() -> None:
    rng = np.random.default_rng(8)
    grey, colour = pins(blur=1.0), rng.integers(0, 256, (90, 121, 3)).astype(np.uint8)
    binary = np.where(pins() > 120, 255, 0).astype(np.uint8)
    drawn = [rng.integers(0, 256, (*shape, 1)).astype(np.uint8) for shape in ((1, 9), (3, 5), (300, 500))]
    for image in (grey, colour, binary, binary[:, :95], np.zeros((40, 40, 1), np.uint8), *drawn):
        np.testing.assert_allclose(image_features(image), plain_features(image), rtol=0, atol=1e-9)


def test_a_verdict_is_that_of_all_examples_put_in_order(known) -> None:
    """Distances are sums of float32, known to 2 parts in 10^6 whatever their order."""
    rng = np.random.default_rng(9)
    for _ in range(50):
        at, novelty = changed(rng, COSTLY, rng.uniform(0, 20)), rng.uniform(0.5, 3)
        place = 3 * np.arcsinh((at - known.centre) / (3 * known.spread)) @ known.axes
        square = np.sum((known.places - place) ** 2, axis=1)
        near = np.argsort(square)[:12]
        weight = 1 / (1 + square[near])
        harm = weight @ known.harm[near] / weight.sum() / known.limits[0]
        ratio = (1 + np.sqrt(square[near[2]])) / (1 + known.spacing[near].mean())
        tolerated = max(known.limits[2], known.novelty[near].max()) if ratio <= known.limits[1] else 1.0
        verdict = known.judge(at, novelty)
        assert verdict.atypicality == pytest.approx(
            max(harm, novelty / tolerated) / known.limits[3], rel=2e-6
        )
        assert verdict.known == bool(ratio <= known.limits[1])


def detector(rng: np.random.Generator) -> NoveltyDetector:
    thumbs = rng.uniform(0, 255, (60, 8, 8, 1)).astype(np.float32)
    return fit_novelty_detector(thumbs, np.array_split(np.arange(60), 5), thumbs[:0])


def guard(known: KnownChanges) -> NoveltyDetector:
    return replace(detector(np.random.default_rng(5)), changes=known)


def test_known_changes_come_back_from_disk_to_the_last_digit(known, tmp_path) -> None:
    guard(known).save(tmp_path / "guard.npz")
    again = NoveltyDetector.load(tmp_path / "guard.npz").changes
    assert again is not None
    for at in np.random.default_rng(6).normal(0, 10, (20, FEATURES)):
        assert again.judge(at, 1.5) == known.judge(at, 1.5)


def test_damaged_known_changes_are_refused(known, tmp_path) -> None:
    guard(known).save(tmp_path / "guard.npz")
    with np.load(tmp_path / "guard.npz") as held:
        parts = dict(held)
    changes = [
        parts | change
        for change in (
            {"known_harm": parts["known_harm"][:-1]},
            {"known_places": np.full_like(parts["known_places"], np.nan)},
            {"known_limits": np.zeros(4)},
            {"known_kind": parts["known_kind"] + 9},
            {"known_axes": parts["known_axes"][1:]},
            {"known_axes": parts["known_axes"][0]},
            {"known_registration_mean": parts["known_registration_mean"][1:]},
        )
    ]
    for arrays in (*changes, {key: part for key, part in parts.items() if key != "known_spacing"}):
        np.savez(tmp_path / "other.npz", **arrays)
        with pytest.raises(CertificateError, match="calibrate again"):
            NoveltyDetector.load(tmp_path / "other.npz")
