"""How well poses of real taps are read, over how many known taps there are; beside regression without a tip.

From a clone, with the folder of taps that `palpate calibrate --method tip-pose` takes twice, to learn from
and to be judged by:

    python tools/tip_readings.py taps/train taps/val

Half an hour on one core. Errors are means of absolute differences to the labels, over all taps that were
read.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from sklearn.decomposition import PCA
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline

from palpate.sensors.tactip.taps import RegisteredTaps, TipReader, register_taps
from palpate.sensors.tactip.taps.tip_reader import fit_pins

PINS = 331
DRAWS = {10: (0, 1, 2), 50: (0, 1, 2), 100: (0,), 200: (0,), 400: (0,)}  # taps: seeds
POOL = 600  # taps from which they are drawn
DRAWN, DRAWN_PX = 1500, 0.3  # taps drawn by the tip, and by how much each of their pins is off


def by_tip(known: RegisteredTaps, some: np.ndarray, new: RegisteredTaps) -> list[str]:
    """Errors of a tip's readings and how many intervals hold the labels."""
    poses, places = known.poses[some], known.places_px[some]
    reader = TipReader.learnt(fit_pins(poses, places), poses, places)
    read = reader.read(new.places_px)
    off = np.abs(read.poses - new.poses)
    held = off <= read.half_widths
    lines = [f"tip: off {np.nanmean(off, axis=0).round(3)}, held {held.mean(axis=0).round(3)}"]
    share, off, held = read.valid.mean(), off[read.valid].mean(axis=0), held[read.valid].mean(axis=0)
    return [*lines, f"  valid {share:.2f}: off {off.round(3)}, held {held.round(3)}"]


def by_regression(known: RegisteredTaps, some: np.ndarray, new: RegisteredTaps) -> list[str]:
    """Errors of a kernel ridge on principal components of the pins' places, chosen by folds of these taps."""
    usual = np.nanmedian(known.places_px[some], axis=0)
    X, Y = (
        np.where(np.isnan(p), usual, p).reshape(len(p), -1) for p in (known.places_px[some], new.places_px)
    )
    middle, spread = known.poses[some].mean(axis=0), known.poses[some].std(axis=0)
    ways = {
        "pca__n_components": [c for c in (4, 8, 12, 20, 30) if c < 0.75 * len(some)],
        "kernelridge__gamma": [1e-7, 1e-6, 1e-5, 1e-4],
        "kernelridge__alpha": [1e-4, 1e-3, 1e-2, 0.1],
    }
    search = GridSearchCV(
        make_pipeline(PCA(4), KernelRidge(kernel="rbf")), ways, cv=5, scoring="neg_mean_absolute_error"
    )
    told = search.fit(X, (known.poses[some] - middle) / spread).predict(Y) * spread + middle
    return [f"regression: off {np.abs(told - new.poses).mean(axis=0).round(3)}"]


def by_drawn_taps(known: RegisteredTaps, some: np.ndarray, new: RegisteredTaps) -> list[str]:
    """Errors where no real tap was read before: a regression on taps drawn by the tip, and the tip alone.

    The tip's terms are fitted to real taps; what it is off by is not learnt.
    """
    poses, places = known.poses[some], known.places_px[some]
    fit = fit_pins(poses, places)
    rng = np.random.default_rng(0)
    drawn = rng.uniform(poses.min(axis=0), poses.max(axis=0), (DRAWN, poses.shape[1]))
    at = fit.tip.places_px(fit.terms, drawn) + rng.normal(0, DRAWN_PX, (DRAWN, *places.shape[1:]))
    taps = RegisteredTaps(drawn, at, 0, known.layout)
    lines = [f"drawn, {line}" for line in by_regression(taps, np.arange(DRAWN), new)]
    reader = TipReader.plain(fit, poses, places)
    told = replace(reader, error=replace(reader.error, off=np.zeros_like(reader.error.off)))
    off = np.abs(told.told(new.places_px)[0] - new.poses)
    return [*lines, f"tip alone: off {off.mean(axis=0).round(3)}"]


def main(folder: Path, judged_by: Path) -> None:
    """Print the table."""
    known, new = register_taps([folder, judged_by], PINS)
    pool = np.random.default_rng(0).permutation(len(known.poses))[:POOL]
    print(f"{len(new.poses)} taps judge, {new.lost} left out")
    for line in by_drawn_taps(known, pool[:400], new):
        print("0", line, flush=True)
    print("always the mean:", np.abs(known.poses.mean(axis=0) - new.poses).mean(axis=0).round(3))
    for taps, seeds in DRAWS.items():
        for seed in seeds:
            some = pool[np.random.default_rng(seed).permutation(len(pool))[:taps]]
            for line in (*by_tip(known, some, new), *by_regression(known, some, new)):
                print(taps, seed, line, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
