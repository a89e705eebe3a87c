"""Which ball was grasped? Fifteen grasps, a coated gel lit in colours: a stand-in, not one of our sensors.

The rule, of two numbers a trial:

- the logarithm of the loading slope of force over the gripper's closing, from 1.5 N to the greatest force, as
  the data's own description has it;
- the gel's bulge (`casr.imprint`) when force first reaches 5 N, over a square in the pad's middle a third of
  the pad wide, against the frame in which the gripper is widest.

A trial goes to the ball whose mean is nearest, each number in units of its spread within balls
(`trial_assignment`), all learnt without that trial. What else was tried, and how it did, is in
docs/explanations/grasping-balls.md.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from tests.real.gel_curvature import ImprintRegion, Lamps, bulge
from tests.real.trial_assignment import assign, nearest

from palpate.core.errors import InputError, RangeError
from palpate.estimators.compliance.stiffness_curve import Loading, loading
from palpate.recordings.exchange.frame_sequences import VideoFrames
from palpate.recordings.exchange.press_table import read_press_table

SPIKE_N = -1.0
FROM_N, AT_N = 1.5, 5.0
RATE_HZ = 30.0
# Seen in the images: red light from below, green from the left, blue from above.
LAMPS = Lamps(((0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)))
PAD_PX = ((46, 68), (463, 111), (460, 384), (55, 445))  # its corners, by eye
RUBBER = ("orange_ball_softest", "green_ball_softer", "purple_ball_hardest")
OTHERS = ("golf_ball", "foam_brick")


@dataclass(frozen=True)
class Grasp:
    """One trial: its frames, force [N], width [m] and loading part."""

    name: str
    ball: str
    frames: list
    force_n: np.ndarray
    width_m: np.ndarray
    part: Loading


@pytest.fixture(scope="module")
def grasps(real_data):
    folder = real_data / "grasp-modulus"
    if not folder.is_dir():
        pytest.skip(f"no grasps at {folder}")
    return [_read(folder, ball, i) for ball in RUBBER + OTHERS for i in (1, 2, 3)]


def loading_slope(grasp: Grasp, *, held: bool) -> float:
    """Force over closing [N/m]; a width that is held counts once, and at the end of loading."""
    i = np.arange(grasp.part.first, grasp.part.last + 1)
    if held:
        fresh = np.flatnonzero(np.concatenate([[True], np.diff(grasp.width_m) != 0]))
        i = np.union1d(np.intersect1d(i, fresh), [grasp.part.last])
    return -float(np.polyfit(grasp.width_m[i], grasp.force_n[i], 1)[0])


def _read(folder, ball: str, i: int) -> Grasp:
    name = f"{ball}_{i}"
    video = VideoFrames(folder / f"{name}.avi")
    table = read_press_table(folder / f"{name}.csv", len(video), rate_hz=RATE_HZ)
    good = table.force_n >= SPIKE_N
    frames = [frame for frame, keep in zip(video, good, strict=True) if keep]
    force, width = table.force_n[good], table.position_m[good]
    return Grasp(name, ball, frames, force, width, loading(force, FROM_N))


def at_force(force_n: np.ndarray, values: np.ndarray, part: Loading, level_n: float) -> float:
    """The value at which force first reaches a level while loading, between samples by a straight line.

    Args:
        force_n: of every sample [N].
        values: of every sample.
        part: of the loading; the sample before it may be the lower one.
        level_n: force [N].

    Raises:
        InputError: as many values as forces are needed.
        RangeError: the loading part begins above the level or never reaches it.
    """
    if np.shape(force_n) != np.shape(values):
        raise InputError(
            f"{np.size(force_n)} forces and {np.size(values)} values; one of each", code="lengths-differ"
        )
    first = max(part.first - 1, 0)
    force = np.asarray(force_n, np.float64)[first : part.last + 1]
    if not force[0] <= level_n <= force.max():
        raise RangeError(
            f"{level_n:g} N is asked for, and loading goes from {force[0]:.3g} to {force.max():.3g} N",
            code="force-not-reached",
        )
    after = int(np.argmax(force >= level_n))
    if after == 0:
        return float(values[first])
    low, high = force[after - 1], force[after]
    k = (level_n - low) / (high - low)
    return float((1 - k) * values[first + after - 1] + k * values[first + after])


def middle(share: float = 1 / 3, off=(0, 0)) -> ImprintRegion:
    """A square around the mean of the pad's corners, so many times as wide as the pad."""
    corners = np.array(PAD_PX)
    side = round(share * np.ptp(corners[:, 0]))
    x, y = np.round(corners.mean(axis=0) - side / 2 + off).astype(int)
    return ImprintRegion(int(x), int(y), side, side)


def untouched(grasp: Grasp) -> np.ndarray:
    return grasp.frames[int(np.argmax(grasp.width_m))]


def touch(
    grasp: Grasp, at_n: float = AT_N, region: ImprintRegion | None = None, reference=untouched
) -> float:
    """The gel's bulge at a force [white/px]; at the greatest, where the grasp does not reach it."""
    region = region or middle()
    curvature = np.zeros(len(grasp.frames))
    for i in range(max(grasp.part.first - 1, 0), grasp.part.last + 1):
        curvature[i] = bulge(reference(grasp), grasp.frames[i], region, LAMPS)
    return at_force(grasp.force_n, curvature, grasp.part, min(at_n, grasp.force_n[grasp.part.last]))


def arm(grasp: Grasp, held: bool = False) -> float:
    return float(np.log(loading_slope(grasp, held=held)))


def of(grasps, *features) -> np.ndarray:
    return np.array([[feature(grasp) for feature in features] for grasp in grasps])


def report(title: str, grasps, found) -> None:
    print(f"{title}: {found.right} of {len(grasps)}, p = {found.p:.4g} of {found.labellings} labellings")


@pytest.mark.slow
def test_both_cues_tell_the_rubber_balls_and_never_worse_than_force_and_deformation(grasps, rng) -> None:
    balls, others = ([g for g in grasps if (g.ball in RUBBER) == rubber] for rubber in (True, False))
    labels = [g.ball for g in balls]
    felt, seen = of(balls, arm), of(balls, touch)
    both, alone, images = (assign(x, labels, rng) for x in (np.hstack([felt, seen]), felt, seen))
    for title, found in [("both", both), ("slope alone", alone), ("touch images alone", images)]:
        report(title, balls, found)
    away = nearest(np.hstack([felt, seen]), labels, of(others, arm, touch))
    for g, ball in zip([*balls, *others], (*both.assigned, *away), strict=True):
        print(f"  {g.name:22s} {np.exp(arm(g)) / 1e3:5.2f} N/mm {1e5 * touch(g):6.2f}e-5/px -> {ball}")
    assert both.right >= 8
    assert both.right >= alone.right
    assert both.p < 0.01

    # Closing read only where it is new: a stronger rival on force and deformation alone.
    better = assign(of(balls, lambda g: arm(g, held=True)), labels, rng)
    report("slope alone, fresh widths", balls, better)
    assert both.right >= better.right


@pytest.mark.slow
def test_all_fifteen_trials_among_five_objects_are_reported(grasps, rng) -> None:
    labels = [g.ball for g in grasps]
    for title, features in {
        "both": (arm, touch),
        "slope alone": (arm,),
        "touch images alone": (touch,),
    }.items():
        found = assign(of(grasps, *features), labels, rng, draws=999)
        report(f"five objects, {title}", grasps, found)
        for g, ball in zip(grasps, found.assigned, strict=True):
            if ball != g.ball:
                print(f"  {g.name} -> {ball}")
        assert found.p < 0.05  # far from luck; how many are right is reported, with no bar


@pytest.mark.slow
def test_what_an_untouched_gel_tells_of_the_ball_is_far_less_than_touch_does(grasps, rng) -> None:
    """A control, its scores reported with no bar: what light and gel say of the ball when nothing touches.

    An object's trials may be of one sitting, and the gel keeps a little of its last touch.
    """
    balls = [g for g in grasps if g.ball in RUBBER]
    labels, region = [g.ball for g in balls], middle()

    def patch(g):
        return untouched(g)[region.y : region.y + region.h, region.x : region.x + region.w]

    level = np.array([[patch(g).mean()] for g in balls])
    blank = np.full_like(untouched(balls[0]), 128)
    shape = np.array([[bulge(blank, untouched(g), region, LAMPS)] for g in balls])
    for title, x in [("brightness", level), ("bulge", shape)]:
        report(f"widest gripper, {title}", balls, assign(x, labels, rng))
    spread = [np.ptp([s.mean() for s in np.split(shape.ravel(), 3)]), np.ptp(of(balls, touch))]
    print(f"  bulge differs by {1e5 * spread[0]:.1f}e-5 untouched and {1e5 * spread[1]:.1f}e-5 touched")
    assert spread[0] < 0.25 * spread[1]
