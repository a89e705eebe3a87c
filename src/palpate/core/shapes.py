"""Types that carry a shape: jaxtyping's, where types are checked.

Static checkers read jaxtyping itself. At run time its types are taken where it is loaded already, as by the
import hook of the tests, which check every shape; anywhere else an array's type stands for itself, and
jaxtyping, which takes longer to import than NumPy, is neither imported nor needed.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

__all__ = [
    "Bool",
    "Complex",
    "Complex64",
    "Float",
    "Float16",
    "Float32",
    "Int",
    "Shaped",
    "UInt8",
    "UInt16",
]

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Complex, Complex64, Float, Float16, Float32, Int, Shaped, UInt8, UInt16
else:

    class Unchecked:
        """Stands for a shaped type: ``Unchecked[ndarray, "h w"]`` is ``ndarray``."""

        def __class_getitem__(cls, array_and_shape: tuple[Any, str]) -> Any:
            return array_and_shape[0]

    Bool = Complex = Complex64 = Float = Float16 = Float32 = Int = Shaped = UInt8 = UInt16 = Unchecked
