"""Discriminator of sensor units along Fisher's axis: 0 is the unit adapted to, 1 the former."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.core import CertificateError, Float
from palpate.core.array_files import MAX_ARRAY_BYTES, read_arrays
from palpate.core.parsing import parser
from palpate.estimators.guard.novelty import Prepared, thumbnail


@dataclass(frozen=True, slots=True)
class CopyDiscriminator:
    """Discriminator of sensor units.

    Attributes:
        axis: Weights of flat thumbnails ``[k]`` [per gray level].
        limit: Position beyond which an image is assigned to the former unit.
    """

    axis: Float[np.ndarray, " k"]
    offset: float
    limit: float

    def place(self, prepared: Prepared) -> float:
        """Return an image's position on the axis: 0 for this unit's mean, 1 for the former's."""
        return float(np.dot(self.axis, thumbnail(prepared).ravel())) - self.offset

    def is_of_former(self, prepared: Prepared) -> bool:
        """Return whether the image resembles the former unit's."""
        return self.place(prepared) > self.limit

    def save(self, path: Path) -> None:
        np.savez_compressed(path, axis=self.axis, offset=self.offset, limit=self.limit)

    @classmethod
    @parser("copy discriminator", CertificateError, max_bytes=MAX_ARRAY_BYTES)
    def load(cls, path: Path, size: int) -> CopyDiscriminator:
        """Read what `save` wrote, for thumbnails of `size` values."""
        try:
            arrays = read_arrays(path)
            axis, offset, limit = (arrays[name] for name in ("axis", "offset", "limit"))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as e:
            raise CertificateError(
                f"{path} tells no copies apart ({e}); adapt again", code="file-damaged"
            ) from e
        numbers = np.concatenate([axis.ravel(), offset.ravel(), limit.ravel()])
        if axis.shape != (size,) or numbers.dtype != np.float64 or not np.isfinite(numbers).all():
            raise CertificateError(
                f"{path} does not fit the calibration's thumbnails; adapt again", code="file-misfit"
            )
        return cls(axis, float(offset), float(limit))
