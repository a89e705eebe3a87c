"""Shapes are checked in tests and only there; fixtures that every room's tests share."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import jaxtyping
import numpy as np
import pytest

# Before any test imports palpate: what was imported earlier would go unchecked. The numeric tower lets an int
# stand where a float is asked for, as static checkers do.
jaxtyping.install_import_hook(
    "palpate", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
)

# No deadline: how long one example takes says more about the machine's other work than about palpate.
hypothesis.settings.register_profile("palpate", deadline=None)
hypothesis.settings.load_profile("palpate")

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers at every run."""
    return np.random.default_rng(20240607)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings, which is not part of the repository."""
    named = os.environ.get("PALPATE_REAL_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; name their folder in PALPATE_REAL_DATA")
    return folder


def spots(n: int, rng: np.random.Generator, lamp: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A bright spot on a patterned ground: images ``[n 48 64]``, its place [mm] and its height [mm]."""
    rows, columns = np.mgrid[0:48, 0:64]
    ground = 40 + 20 * np.cos(rows / 5) * np.cos(columns / 7) + lamp
    place, height = rng.uniform(-2, 2, n), rng.uniform(0.5, 2.0, n)
    spot = np.exp(-((columns - 32 - 8 * place[:, None, None]) ** 2 + (rows - 24) ** 2) / 30)
    noisy = ground + 70 * height[:, None, None] * spot + rng.normal(0, 1.5, (n, 48, 64))
    return np.clip(noisy, 0, 255).astype(np.uint8), place, height


@pytest.fixture
def record_spots(tmp_path):
    """Record spots as a run: five frames a press, and a no-contact frame before each press."""
    from palpate.core import ManualClock
    from palpate.recordings import Manifest, Run, RunWriter

    labels = {
        "press": "text",
        "x_mm": "number",
        "height_mm": "number",
        "flat_mm": "number",
        "reference": "flag",
    }

    def record(name: str, presses: int, *, seed: int = 0, lamp: float = 0.0, colour: bool = False) -> Run:
        rng, clock = np.random.default_rng(seed), ManualClock()
        rows, columns = np.mgrid[0:48, 0:64]
        ground = 40 + 20 * np.cos(rows / 5) * np.cos(columns / 7) + lamp
        with RunWriter.create(
            tmp_path / name, Manifest.new(sensor="spots", labels=labels), clock=clock, overflow="wait"
        ) as writer:
            for press in range(presses):
                images, place, height = spots(5, rng, lamp)
                empty = np.clip(ground + rng.normal(0, 1.5, ground.shape), 0, 255).astype(np.uint8)
                for i, image in enumerate([empty, *images]):
                    clock.sleep(0.1)
                    shown = np.repeat(image[..., None], 3, axis=2) if colour else image
                    held = {
                        "press": f"press-{press:03d}",
                        "x_mm": 0.0 if i == 0 else float(place[i - 1]),
                        "height_mm": 0.0 if i == 0 else float(height[i - 1]),
                        "flat_mm": 1.0,
                        "reference": i == 0,
                    }
                    writer.frame(shown, labels=held)
        return Run.open(tmp_path / name)

    return record
