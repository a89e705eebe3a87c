"""Map of the pixels that decide a reading: growth of the error where a block is replaced by its mean over
many frames (occlusion: M. D. Zeiler and R. Fergus, ECCV 2014, doi:10.1007/978-3-319-10590-1_53).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.core import Float, Float32, Indices, Progress, new_file, silent
from palpate.core.array_files import MAX_ARRAY_BYTES, read_arrays
from palpate.core.errors import CertificateError
from palpate.core.parsing import parser
from palpate.estimators.networks.model_interface import Fitted, TrainingData

MAP_FILE = "deciding-pixels.npy"
BLOCKS = 12  # blocks along the picture's longer side
MAX_ROWS = 60  # held-out rows read again, over all folds
MEAN_ROWS = 200  # greatest number of rows in a block's mean


@dataclass(frozen=True)
class DecidingPixels:
    """Growth of the error by occluded block.

    Attributes:
        increase: growth of the mean absolute error in each target's unit ``[t y x]``.
        rows: number of held-out rows averaged.
    """

    increase: Float[np.ndarray, "t y x"]
    rows: int

    @classmethod
    def joined(cls, parts: list[DecidingPixels]) -> DecidingPixels | None:
        """The mean over folds, each by its rows; None where there are none."""
        rows = sum(part.rows for part in parts)
        if not rows:
            return None
        return cls(np.sum([part.increase * part.rows for part in parts], axis=0) / rows, rows)

    def save(self, path: Path) -> None:
        """Write the map as a NumPy array, float32."""
        with path.open("wb") as file:
            np.save(file, self.increase.astype(np.float32))

    def keep(self, path: Path) -> None:
        path.unlink(missing_ok=True)
        with new_file(path) as file_path, file_path.open("wb") as file:
            np.savez(file, increase=self.increase, rows=self.rows)

    @classmethod
    @parser("saliency map", CertificateError, max_bytes=MAX_ARRAY_BYTES)
    def kept(cls, path: Path) -> DecidingPixels | None:
        """A fold's map as an interrupted run kept it; None where it is missing or damaged."""
        try:
            arrays = read_arrays(path)
            return cls(np.asarray(arrays["increase"], np.float64), int(arrays["rows"]))
        except Exception:  # numpy raises many kinds over damaged bytes
            return None


def mean_input(data: TrainingData, rows: Indices) -> Float32[np.ndarray, "c h w"]:
    """Return the mean input over some of the rows ``[c h w]``."""
    chosen = rows[np.unique(np.linspace(0, len(rows) - 1, min(MEAN_ROWS, len(rows))).astype(np.int64))]
    total = np.zeros(data.shape, np.float64)
    for _, inputs in data.batches(chosen, 64):
        total += inputs.sum(axis=0, dtype=np.float64)
    return (total / len(chosen)).astype(np.float32)


def rows_of_fold(folds: int, k: int) -> int:
    """Return the rows of fold `k` to read again, so that all `folds` read `MAX_ROWS`."""
    return max(1, MAX_ROWS * (k + 1) // folds - MAX_ROWS * k // folds)


def block_edges(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the limits of the blocks down and across a picture [px]."""
    side = max(shape) / BLOCKS
    counts = [min(max(1, round(length / side)), length) for length in shape]
    return tuple(  # type: ignore[return-value]
        np.linspace(0, length, count + 1).round().astype(int)
        for length, count in zip(shape, counts, strict=True)
    )


def deciding_pixels(
    fitted: Fitted,
    data: TrainingData,
    held_out: Indices,
    nothing: Float32[np.ndarray, "c h w"],
    rows: int,
    progress: Progress = silent,
) -> DecidingPixels:
    """Read held-out rows again, each time with one block of the picture replaced.

    Args:
        fitted: model that has not seen these rows.
        nothing: replacement input ``[c h w]``, see `mean_input`.
        rows: number of rows read, evenly spaced.
    """
    chosen = held_out[np.unique(np.linspace(0, len(held_out) - 1, min(rows, len(held_out))).astype(np.int64))]
    inputs, true = data.fetch(chosen), data.values[chosen]
    down, across = block_edges(inputs.shape[2:])
    whole = np.abs(fitted.predict(inputs) - true).mean(axis=0)
    increase = np.empty((true.shape[1], len(down) - 1, len(across) - 1))
    for i in range(len(down) - 1):
        for j in range(len(across) - 1):
            block = (..., slice(down[i], down[i + 1]), slice(across[j], across[j + 1]))
            kept = inputs[block].copy()
            inputs[block] = nothing[block]
            increase[:, i, j] = np.abs(fitted.predict(inputs) - true).mean(axis=0) - whole
            inputs[block] = kept
        progress("which pixels decide", i + 1, len(down) - 1)
    return DecidingPixels(increase, len(chosen))
