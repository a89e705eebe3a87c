"""Types that carry a shape: jaxtyping's, where types are checked.

Static checkers read jaxtyping itself. At run time its types are taken where it is loaded already, as by the
import hook of the tests, which check every shape; anywhere else an array's type stands for itself, and
jaxtyping, which takes longer to import than NumPy, is neither imported nor needed.

The legend of axis letters used in every shaped type, and the aliases built from them.

| letter | axis |
|---|---|
| `n` | frames, in the order of the run |
| `h`, `w` | image rows (downwards) and columns (to the right) |
| `c` | colour channels, RGB order, 1 or 3 |
| `t` | targets, in the order they were asked for |
| `k` | wavelengths or features |
| `ny`, `nx` | surface grid, rows along y and columns along x |
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

__all__ = [
    "Bool",
    "Complex",
    "Complex64",
    "Field",
    "Float",
    "Float16",
    "Float32",
    "Image",
    "Images",
    "Indices",
    "Int",
    "Mask",
    "Shaped",
    "Tensor",
    "UInt8",
    "UInt16",
    "Values",
    "ndarray",
]

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Complex, Complex64, Float, Float16, Float32, Int, Shaped, UInt8, UInt16
else:

    class Unchecked:
        """Stands for a shaped type: ``Unchecked[ndarray, "h w"]`` is ``ndarray``."""

        def __class_getitem__(cls, array_and_shape: tuple[Any, str]) -> Any:
            return array_and_shape[0]

    Bool = Complex = Complex64 = Float = Float16 = Float32 = Int = Shaped = UInt8 = UInt16 = Unchecked


Image = UInt8[np.ndarray, "h w *c"]
Images = UInt8[np.ndarray, "n h w c"]
Tensor = Float32[np.ndarray, "n c h w"]
Values = Float[np.ndarray, "n t"]
Field = Float[np.ndarray, "ny nx"]
Mask = Bool[np.ndarray, "ny nx"]
Indices = Int[np.ndarray, " _"]
