"""Twins across a split are found, and frames that only resemble each other are not called twins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from palpate.calibration import leakage
from palpate.calibration.leakage import LeakageAudit, audit
from palpate.core import ManualClock
from palpate.estimators.findings import FindingCode
from palpate.recordings import Manifest, PackedSet, Run, RunWriter, pack, split
from palpate.recordings.label_tables import label_kinds
from palpate.recordings.preparation import Preparation

SIDE = 64


def packed_set(folder: Path, images: Sequence[np.ndarray], table: pd.DataFrame) -> PackedSet:
    manifest = Manifest.new(sensor="s1", labels=label_kinds(table))
    with RunWriter.create(folder / "run", manifest, clock=ManualClock(), overflow="wait") as writer:
        for i, image in enumerate(images):
            writer.frame(image, time_ns=i, labels=table.iloc[i].to_dict())
    channels = 1 if images[0].ndim == 2 else 3
    return pack(Run.open(folder / "run"), folder / "packed", Preparation(None, (112, 112), channels))


def press(rng: np.random.Generator, depth: float | None = None) -> np.ndarray:
    """What a touch at a random place might look like: rings on a grey ground."""
    x, y = rng.uniform(12, SIDE - 12, 2)
    depth = rng.uniform(0.3, 1.0) if depth is None else depth
    rows, columns = np.mgrid[:SIDE, :SIDE]
    r = np.hypot(columns - x, rows - y)
    return 120 + 80 * depth * np.cos(r * (0.3 + depth)) * np.exp(-((r / 14) ** 2))


def seen(scene: np.ndarray, rng: np.random.Generator, noise: float) -> np.ndarray:
    return np.clip(np.rint(scene + rng.normal(0, noise, scene.shape)), 0, 255).astype(np.uint8)


def pressed(
    folder: Path, rng: np.random.Generator, noise: float, presses: int = 10, each: int = 10
) -> PackedSet:
    scenes = [press(rng) for _ in range(presses)]
    table = pd.DataFrame({"press": np.repeat(np.arange(float(presses)), each), "depth_mm": 1.0})
    return packed_set(folder, [seen(scene, rng, noise) for scene in scenes for _ in range(each)], table)


def audited(packed: PackedSet, spec: str, **options: Any) -> LeakageAudit:
    return audit(packed, split(packed.table, spec), **options)


@pytest.mark.parametrize("noise", [0.0, 1.0, 5.0])
@pytest.mark.cases(1)
def test_a_still_scene_recorded_often_leaks_under_a_random_split_and_not_by_press(tmp_path, rng, noise):
    packed = pressed(tmp_path, rng, noise)
    random, by_press = audited(packed, "random"), audited(packed, "group:press")
    assert random.near_duplicates >= 0.99 * len(packed)
    assert not random.clean
    assert random.shared_groups == {"press": 10}
    (same,) = (one for one in random.findings if one.code == FindingCode.LOOK_ALIKES)
    assert 0 < same.values["count"] <= same.values["held"] == 100
    assert by_press.near_duplicates == 0
    assert by_press.clean
    assert by_press.checked_pairs == 100 * 80  # five folds of twenty against the other eighty


def test_separate_touches_do_not_leak_under_a_random_split(tmp_path, rng):
    images = [seen(press(rng), rng, 1.5) for _ in range(60)]
    found = audited(
        packed_set(tmp_path, images, pd.DataFrame({"depth_mm": rng.uniform(0.3, 1, 60)})), "random"
    )
    assert found.near_duplicates == 0
    assert found.clean
    assert found.shared_groups == {}
    assert found.examples == ()


@pytest.mark.parametrize("grey_levels", [0, 2])
@pytest.mark.cases(1)
def test_copies_among_separate_touches_are_found_and_named(tmp_path, rng, grey_levels):
    images = [seen(press(rng), rng, 0) for _ in range(20)]
    noisy = images[7] + rng.integers(-grey_levels, grey_levels + 1, images[7].shape)
    images.append(np.clip(noisy, 0, 255).astype(np.uint8))
    names = [f"touch_{i}.png" for i in range(20)] + ["copy.png"]
    packed = packed_set(tmp_path, images, pd.DataFrame({"image_file": names, "press": np.arange(21.0)}))
    found = audited(packed, "leave-one-out:press")
    assert sorted(found.examples) == [("copy.png", "touch_7.png"), ("touch_7.png", "copy.png")]
    assert not found.clean


def test_equal_pictures_are_copies_whatever_their_labels(tmp_path, rng):
    images = [seen(press(rng), rng, 1.0) for _ in range(20)]
    images.append(images[7])
    names = [f"touch_{i}.png" for i in range(20)] + ["copy.png"]
    depths = np.append(rng.uniform(0.1, 1.0, 20), 5.0)
    table = pd.DataFrame({"image_file": names, "press": np.arange(21.0), "depth_mm": depths})
    found = audited(packed_set(tmp_path, images, table), "leave-one-out:press")
    assert (found.near_duplicates, found.altered_copies, found.clean) == (2, 0, False)
    assert found.findings[0].code == FindingCode.CONTRADICTING_LABELS
    assert found.findings[0].values == {"count": 2, "held": 21, "first": "touch_7.png", "second": "copy.png"}
    table["depth_mm"] = np.append(depths[:20], depths[7])
    (tmp_path / "agreeing").mkdir()
    found = audited(packed_set(tmp_path / "agreeing", images, table), "leave-one-out:press")
    assert found.near_duplicates == 2
    assert FindingCode.CONTRADICTING_LABELS not in {one.code for one in found.findings}


@pytest.mark.parametrize(("grey_levels", "twins"), [(4, 0), (1, 16)])
def test_frames_that_differ_in_one_small_cell_only_are_no_copies(tmp_path, rng, grey_levels, twins):
    """A touch of one cell of 16 x 16 is lost in the mean over all cells and seen in the largest."""
    scene = seen(press(rng), rng, 0).astype(float) / 2 + 60
    images = []
    for number in range(16):
        image = scene.copy()
        row, column = 4 * (2 + 3 * (number // 4)), 4 * (2 + 3 * (number % 4))
        image[row : row + 4, column : column + 4] += grey_levels
        images.append(image.astype(np.uint8))
    packed = packed_set(tmp_path, images, pd.DataFrame({"press": np.arange(16.0)}))
    found = audited(packed, "leave-one-out:press")
    assert found.limit == 0.5
    assert found.near_duplicates == twins


def test_the_untouched_skin_is_the_same_in_every_press_and_counts_as_no_leak(tmp_path, rng):
    ground = np.full((SIDE, SIDE), 120.0)
    images, rows = [], []
    for number in range(12):
        for depth in (0.0, 0.002, 0.4, 0.8):  # the second touch is too light to be seen
            images.append(seen(ground if depth == 0 else press(rng, depth), rng, 1.0))
            rows.append({"press": float(number), "depth_mm": depth})
    packed = packed_set(tmp_path, images, pd.DataFrame(rows))
    found = audited(packed, "group:press")
    assert found.clean
    assert found.at_rest == 12
    # Were they not known to be at rest, they would be twins of each other.
    assert audited(packed, "group:press", at_rest=np.zeros(48, dtype=bool)).near_duplicates >= 12


def test_groups_on_both_sides_are_counted_by_column_and_text(tmp_path, rng):
    images = [seen(press(rng), rng, 1.0) for _ in range(40)]
    table = pd.DataFrame(
        {"material": ["soft", "hard"] * 20, "press": np.arange(40.0) // 2, "note": [""] * 40}
    )
    packed = packed_set(tmp_path, images, table)
    random = audited(packed, "random")
    assert random.shared_groups["material"] == 2
    assert random.shared_names["material"] == ("hard", "soft")
    assert "note" not in random.shared_groups
    assert not random.clean
    by_press = audited(packed, "group:press")
    assert by_press.shared_groups == {"material": 2}
    assert by_press.clean  # a new press of a known material is a fair question, and the text says which it is
    (one,) = by_press.findings
    assert (one.code, one.values["held_out"]) == (FindingCode.GROUPS_NOT_HELD_OUT, "press")
    assert "material" in str(one.values["groups"])
    assert audited(packed, "random", group_columns=["press"]).shared_groups.keys() == {"press"}


def test_beyond_so_many_pairs_every_so_many_frames_stand_for_all(tmp_path, rng, monkeypatch):
    """40 frames are 1,600 pairs; of 500 at most, every fourth held-out frame is compared."""
    packed = pressed(tmp_path, rng, 1.0, presses=10, each=4)
    whole = audited(packed, "group:press")
    assert whole.checked_pairs == 40 * 32
    monkeypatch.setattr(leakage, "_MAX_PAIRS", 500)
    assert audited(packed, "group:press").checked_pairs == 5 * 2 * 32
