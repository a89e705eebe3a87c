"""Flow of photographs whose true motion is known (Middlebury): a stand-in for touch images."""

import cv2
import numpy as np
import pytest

from palpate.estimators.flow.horn_schunck import flow


def scene(folder):
    """Two grey images, and the true flow [2 h w] with NaN where it is unknown."""
    if not folder.is_dir():
        pytest.skip(f"no photographs with known flow at {folder}")
    part = np.s_[..., 60:300, 60:380]  # smaller, and away from the edge
    first, second = (cv2.imread(str(folder / f"frame{n}.png"), cv2.IMREAD_GRAYSCALE) for n in (10, 11))
    words = np.fromfile(folder / "flow10.flo", np.float32)
    w, h = words[1:3].view(np.int32)
    truth = np.moveaxis(words[3:].reshape(h, w, 2), -1, 0).astype(float)
    return first[part], second[part], np.where(abs(truth) < 1e9, truth, np.nan)[part]


def end_point(found, truth) -> float:
    return float(np.nanmean(np.hypot(*(found - truth))))


@pytest.mark.parametrize("name", ["Dimetrodon", "RubberWhale", "Urban2"])
def test_one_scale_is_no_worse_than_another_code_at_the_same_settings(real_data, name) -> None:
    pyoptflow = pytest.importorskip("pyoptflow", reason="pyoptflow is not installed")
    first, second, truth = scene(real_data / "flow-ground-truth" / name)
    ours = end_point(flow(first, second), truth)
    theirs = end_point(np.stack(pyoptflow.HornSchunck(first / 255, second / 255, alpha=0.1, Niter=26)), truth)
    still = end_point(np.zeros_like(truth), truth)
    print(f"{name}: {ours:.4f} px, pyoptflow {theirs:.4f} px, no motion {still:.4f} px")
    assert ours <= theirs * 1.001
    assert ours < still
