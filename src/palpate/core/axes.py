"""The legend of axis letters used in every shaped type, and the aliases built from them.

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

import numpy as np

from palpate.core.shapes import Bool, Float, Float32, Int, UInt8

Image = UInt8[np.ndarray, "h w *c"]
Images = UInt8[np.ndarray, "n h w c"]
Tensor = Float32[np.ndarray, "n c h w"]
Values = Float[np.ndarray, "n t"]
Field = Float[np.ndarray, "ny nx"]
Mask = Bool[np.ndarray, "ny nx"]
Indices = Int[np.ndarray, " _"]
