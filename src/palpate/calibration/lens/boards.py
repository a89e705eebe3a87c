"""Boards in photographs: the corners of a chessboard or ChArUco board, ordered and to a part of a pixel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray

from palpate.core import Float, ImageError, InputError, PathText, Progress, UInt8, is_hidden, silent
from palpate.recordings.exchange.image_files import opencv_image

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
MIN_CORNERS = 3  # along either side
MAX_CORNERS = 200
MIN_SEEN = 12  # corners of a ChArUco board that make a view
MAX_IMAGE_PX = 200_000_000
MARKER_SHARE = 0.75  # of a square's side
SECTORS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
MAX_MARGIN_CONTRAST = 0.5  # of a board's own: beyond, there are more squares
NOT_FOUND = "the board was not found: cut off, blurred, dark, glaring, or of another size"
MAX_SEARCH_PX = 8  # half a side of the window in which a corner is refined


@dataclass(frozen=True, slots=True)
class Board:
    """Flat board: a chessboard, or one with ArUco markers in its white squares.

    Attributes:
        columns, rows: inner corners along the two sides.
        square_m: side of a square [m].
        dictionary: OpenCV's marker dictionary without DICT_, e.g. "4X4_50"; None for a chessboard.
    """

    columns: int
    rows: int
    square_m: float = 0.025
    dictionary: str | None = None

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < MIN_CORNERS or max(self.columns, self.rows) > MAX_CORNERS:
            raise InputError(
                f"a board of {self.columns}x{self.rows} inner corners; give {MIN_CORNERS} to {MAX_CORNERS} "
                "along either side: one less than there are squares"
            )
        if not 0 < self.square_m < 10:
            raise InputError(f"squares of {self.square_m * 1e3:g} mm; give a side above 0 mm, below 10 m")
        if self.dictionary is not None:
            _charuco(self)

    @property
    def text(self) -> str:
        kind = "chessboard" if self.dictionary is None else f"ChArUco board ({self.dictionary})"
        return f"{kind} of {self.columns}x{self.rows} inner corners, squares of {self.square_m * 1e3:g} mm"

    @property
    def corners_m(self) -> Float[ndarray, "n 3"]:
        """Places of the inner corners on the board, row by row [m]."""
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return np.stack([column.ravel(), row.ravel(), 0 * row.ravel()], axis=1) * self.square_m

    def picture(self, square_px: int = 60) -> UInt8[ndarray, "h w"]:
        """An image to print: the board with a white margin of one square."""
        if self.dictionary is None:
            row, column = np.mgrid[: self.rows + 1, : self.columns + 1]
            squares = np.kron((row + column) % 2, np.ones((square_px, square_px))).astype(np.uint8) * 255
            return np.pad(squares, square_px, constant_values=255)
        size = ((self.columns + 3) * square_px, (self.rows + 3) * square_px)
        return _charuco(self).generateImage(size, marginSize=square_px)


@lru_cache(maxsize=8)
def _charuco(board: Board) -> cv2.aruco.CharucoBoard:
    number = getattr(cv2.aruco, f"DICT_{board.dictionary}", None)
    if number is None:
        names = ", ".join(sorted(name[5:] for name in dir(cv2.aruco) if name.startswith("DICT_")))
        raise InputError(f"there is no marker dictionary {board.dictionary}; there are {names}")
    squares = (board.columns + 1, board.rows + 1)
    markers = cv2.aruco.getPredefinedDictionary(number)
    if squares[0] * squares[1] // 2 > len(markers.bytesList):
        raise InputError(
            f"{board.dictionary} has {len(markers.bytesList)} markers, and a board of "
            f"{squares[0]}x{squares[1]} squares needs {squares[0] * squares[1] // 2}; name a larger one"
        )
    return cv2.aruco.CharucoBoard(squares, board.square_m, MARKER_SHARE * board.square_m, markers)


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Board in one photograph.

    Attributes:
        corners_m: positions of the seen corners on the board ``[n 3]`` [m].
        places_px: their positions (x, y) in the image [px].
        size_px: (height, width) of the image [px].
    """

    name: str
    corners_m: Float[ndarray, "n 3"]
    places_px: Float[ndarray, "n 2"]
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True)
class MissedView:
    """A photograph that is not used, and why."""

    name: str
    reason: str


def read_views(
    folder: PathText, board: Board, progress: Progress = silent
) -> tuple[list[BoardView], list[MissedView]]:
    """Find the board in each photograph of a folder."""
    views: list[BoardView] = []
    missed: list[MissedView] = []
    sizes: dict[tuple[int, int], list[str]] = {}
    others: Counter[tuple[int, int]] = Counter()
    paths = _photographs(Path(folder))
    for done, (path, image) in enumerate(_images(paths), start=1):
        sizes.setdefault(image.shape[:2], []).append(path.name)
        found = find_board(image, board, path.name)
        if isinstance(found, BoardView):
            views.append(found)
        else:
            missed.append(MissedView(path.name, NOT_FOUND))
            if found is not None:
                others[found] += 1
                missed[-1] = MissedView(path.name, f"it shows a board of {found[0]}x{found[1]} inner corners")
        progress("looking for the board", done, len(paths))
    _refuse_mixed(sizes)
    if others and others.most_common(1)[0][1] > len(views):
        (columns, rows), count = others.most_common(1)[0]
        raise InputError(
            f"{count} of {len(paths)} photographs show a board of {columns}x{rows} inner corners, and "
            f"{board.columns}x{board.rows} was asked for; give --board {columns}x{rows} if that is the board"
        )
    return views, missed


def find_board(image: UInt8[ndarray, "h w"], board: Board, name: str) -> BoardView | tuple[int, int] | None:
    """Find the board in a grey image; (columns, rows) for one of another size, None without one."""
    if board.dictionary is not None:
        return _find_charuco(image, board, name)
    found = _by_sectors(image, board)
    if found is None:
        found = _by_quadrilaterals(image, board)
    if found is None:
        return _larger_size(image, board)
    places = _right_handed(found.astype(float), board)
    if not _is_lattice(places, board):
        return None
    if _continues(image, places.reshape(board.rows, board.columns, 2)):
        sides = max(board.columns, board.rows), min(board.columns, board.rows)
        return _larger_size(image, board) or (sides[0] + 1, sides[1])
    return BoardView(name, board.corners_m, places, image.shape[:2])


def _photographs(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give the one that holds the photographs of the board")
    named = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES]
    paths = [path for path in named if not is_hidden(path, folder)]
    if not paths:
        raise InputError(f"{folder} holds no photographs ({', '.join(SUFFIXES)})")
    return paths


def _images(paths: list[Path]) -> Iterator[tuple[Path, np.ndarray]]:
    for path in paths:
        try:
            # Not turned by EXIF: a lens belongs to the sensor's own rows and columns.
            flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
            image = opencv_image(np.fromfile(path, np.uint8), flags)
        except OSError as error:
            raise ImageError(f"{path} cannot be read as an image: {error}") from error
        if image is None or image.size > MAX_IMAGE_PX:
            raise ImageError(f"{path} cannot be read as an image; repair it or take it out of the folder")
        yield path, image


def _refuse_mixed(sizes: dict[tuple[int, int], list[str]]) -> None:
    if len(sizes) > 1:
        told = "; ".join(
            f"{width}x{height} px: {len(names)}, as {names[0]}" for (height, width), names in sizes.items()
        )
        raise InputError(
            f"photographs of several sizes ({told}); a lens is calibrated on those of one camera at one "
            "size: keep one size in the folder"
        )


def _by_sectors(image: np.ndarray, board: Board) -> np.ndarray | None:
    """Duda and Frese's corners (BMVC 2018), which reach far towards the rim of a wide lens."""
    found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=SECTORS)
    return corners.reshape(-1, 2) if found else None


def _continues(image: np.ndarray, lattice: np.ndarray) -> bool:
    """Whether squares alternate beyond the board's rim: OpenCV finds a smaller board within a larger one."""
    for turn in range(4):
        side = np.rot90(lattice, turn)
        edge, step = (side[0, :-1] + side[0, 1:]) / 2, (side[0] - side[1])[:-1]
        own, beyond = (_alternation(image, edge + cells * step) for cells in (0.5, 1.5))
        if own and beyond > MAX_MARGIN_CONTRAST * own:
            return True
    return False


def _alternation(image: np.ndarray, places: np.ndarray) -> float:
    """Mean difference of every second grey from those between; 0 where a place lies outside the image."""
    column, row = np.round(places).astype(int).T
    if min(column.min(), row.min()) < 0 or column.max() >= image.shape[1] or row.max() >= image.shape[0]:
        return 0.0
    grey = image[row, column].astype(float)
    return abs(float(grey[::2].mean() - grey[1::2].mean()))


def _larger_size(image: np.ndarray, board: Board) -> tuple[int, int] | None:
    """Longer and shorter side of a board larger than asked for; None where there is none."""
    size = (board.columns, board.rows)
    found, _, marks = cv2.findChessboardCornersSBWithMeta(image, size, flags=SECTORS | cv2.CALIB_CB_LARGER)
    larger = bool(found) and sorted(marks.shape) != sorted(size)
    return (max(marks.shape), min(marks.shape)) if larger else None


def _by_quadrilaterals(image: np.ndarray, board: Board) -> np.ndarray | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(image, (board.columns, board.rows), flags=flags)
    if not found or len(corners) != board.columns * board.rows:
        return None
    lattice = corners.reshape(board.rows, board.columns, 2)
    closest = min(np.linalg.norm(np.diff(lattice, axis=axis), axis=-1).min() for axis in (0, 1))
    window = int(np.clip(closest / 2 - 1, 2, MAX_SEARCH_PX))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    return cv2.cornerSubPix(image, corners, (window, window), (-1, -1), stop).reshape(-1, 2)


def _right_handed(places: np.ndarray, board: Board) -> np.ndarray:
    """Corners in an order in which the board is seen from its front, so that tilts can be compared."""
    lattice = places.reshape(board.rows, board.columns, 2)
    along, down = np.diff(lattice, axis=1)[:-1], np.diff(lattice, axis=0)[:, :-1]
    turn = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
    return (lattice if turn.mean() > 0 else lattice[:, ::-1]).reshape(-1, 2)


def _is_lattice(places: np.ndarray, board: Board) -> bool:
    """False where rows cross, or two corners fell together: every square must turn the same way."""
    lattice = places.reshape(board.rows, board.columns, 2)
    along, down = np.diff(lattice, axis=1), np.diff(lattice, axis=0)
    turn = along[:-1, :, 0] * down[:, :-1, 1] - along[:-1, :, 1] * down[:, :-1, 0]
    return bool(np.isfinite(places).all() and (turn > 0).all())


def _find_charuco(image: np.ndarray, board: Board, name: str) -> BoardView | None:
    corners, ids, _, _ = cv2.aruco.CharucoDetector(_charuco(board)).detectBoard(image)
    if ids is None or len(ids) < MIN_SEEN:
        return None
    number, places = ids.ravel(), corners.reshape(-1, 2).astype(float)
    on_board = board.corners_m[number]
    if np.linalg.matrix_rank(on_board[:, :2] - on_board[:, :2].mean(axis=0), tol=board.square_m) < 2:
        return None  # on one line
    return BoardView(name, on_board, places, image.shape[:2])
