"""Draw the picture of docs/how-to/find-control-points.md: the published chain's stages, and both results.

    python tools/control_points.py        # some seconds of one core

The frame is rendered by tests/rendered_boards.py: a pressed checkerboard with a tile painted over and a tear.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.rendered_boards import View, board, noisy  # noqa: E402

from palpate.estimators.lattice import find_checkerboard  # noqa: E402
from palpate_reproductions.nusense.quadrilaterals import QuadSettings, published_stages  # noqa: E402

PICTURE = ROOT / "docs" / "images" / "control-points.png"
SCALE, EDGE, TITLE = 2, 6, 22
WHITE, INK = (255, 255, 255), (40, 40, 40)
QUAD, MIDPOINT, ROBUST = (0, 230, 255), (255, 255, 255), (20, 20, 255)


def captioned(picture: np.ndarray, title: str) -> np.ndarray:
    """A picture in RGB with its title above."""
    colour = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB)
    framed = cv2.copyMakeBorder(colour, TITLE, EDGE, EDGE, EDGE, cv2.BORDER_CONSTANT, value=WHITE)
    cv2.putText(framed, title, (EDGE, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.46, INK, 1, cv2.LINE_AA)
    return framed


def main() -> None:
    """The command line."""
    view = View(pitch=22, turn=0.06, size=(300, 220), bulge=6, at=(130.0, 110.0), reach=45, barrel=0.06)
    clean = board(view, extent=(10, 7), painted=((2, -2),), torn=(3.0, 4.2, 1.0), uneven=0.3)
    frame = noisy(clean, np.random.default_rng(0))
    stages = published_stages(frame, QuadSettings(pitch_px=22))
    shown = [captioned(p, f"{i}. {name}") for i, (name, p) in enumerate(stages.pictures.items(), 1)]
    large = cv2.resize(frame, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
    published, robust = large.copy(), large.copy()

    def pixel(place: np.ndarray) -> np.ndarray:
        return np.rint((place + 0.5) * SCALE - 0.5).astype(np.int32)

    cv2.polylines(published, list(pixel(stages.quads)), True, QUAD, 1, cv2.LINE_AA)
    for at in pixel(stages.midpoints):
        cv2.circle(published, at.tolist(), 2, MIDPOINT, -1, cv2.LINE_AA)
    points = find_checkerboard(frame, 22).points
    for cell, at in zip(points.cells.tolist(), pixel(points.places), strict=True):
        cv2.circle(robust, at.tolist(), 2, ROBUST, -1, cv2.LINE_AA)
        name, where = f"{cell[0]},{cell[1]}", (int(at[0]) + 3, int(at[1]) - 3)
        cv2.putText(robust, name, where, cv2.FONT_HERSHEY_SIMPLEX, 0.3, WHITE, 1, cv2.LINE_AA)
    rows = [np.hstack(shown[:4]), np.hstack(shown[4:])]
    last = np.hstack(
        [
            captioned(published, "9. quadrilaterals, and midpoints of their nearest corners"),
            captioned(robust, "the robust detector: corners by their cell"),
        ]
    )
    pad = rows[0].shape[1] - last.shape[1]
    rows.append(cv2.copyMakeBorder(last, 0, 0, 0, max(pad, 0), cv2.BORDER_CONSTANT, value=WHITE))
    width = min(row.shape[1] for row in rows)
    whole = np.vstack([row[:, :width] for row in rows])
    palette = whole // 8 * 8  # less noise to pack
    cv2.imwrite(str(PICTURE), palette[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{PICTURE.stat().st_size} bytes, {len(points)} corners, {len(stages.midpoints)} midpoints")


if __name__ == "__main__":
    main()
