"""Camera's view of the tiles, and position of tile corners in the image.

A tile at rest at X is seen by a ray that meets the resting pattern at P, where X + u(X) = P (1 - w(X) / D),
with motion u along the pad and w towards the camera at distance D. The inverse map P -> X is a fixed-point
iteration on every third pixel with cubic interpolation; tile edges are anti-aliased.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, no_type_check

import cv2
import numba
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from palpate.core import Float, Int, UInt8, ndarray
from palpate.optics.image_chain import normal_table, table_draws
from palpate.sensors.nusense.nusense_spec import NuSenseSpec
from palpate.sensors.nusense.pattern_motion import PatternMotion

NODE_PX = 3  # pixel step of the inverse map
ITERATIONS = 60
SETTLED_M = 1e-8
BORDER_PX = 6
BACKGROUND = 4.0  # grey level of the housing (assumed)

Places = Float[ndarray, "*n 2"]


def seen_px(
    spec: NuSenseSpec, skin_m: Float[ndarray, "n 3"], shift_px: tuple[float, float] = (0.0, 0.0)
) -> Places:
    """Return image positions of points (x, y, z), z from the resting pattern towards the camera [px]."""
    x, y, z = skin_m.T
    points = np.stack([x, -y, spec.camera_m - z], axis=-1)
    return np.asarray(spec.lens.project(points) + np.array(shift_px))


def on_pattern_m(spec: NuSenseSpec, places_px: Places, shift_px: tuple[float, float] = (0.0, 0.0)) -> Places:
    """Return where rays of image positions meet the resting pattern [m]; NaN for none."""
    rays = spec.lens.rays(places_px - np.array(shift_px))
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = spec.camera_m * rays[..., :2] / np.where(rays[..., 2:] > 0, rays[..., 2:], np.nan)
    return np.asarray(flat * np.array([1.0, -1.0]))


class NodeSpline(NamedTuple):
    """Cubic spline through nodes along one side of the window.

    Attributes:
        knots: B-spline coefficients per node value.
        first: First of the four B-splines of a pixel.
        weights: Their weights.
    """

    knots: Float[ndarray, "n n"]
    first: Int[ndarray, " m"]
    weights: Float[ndarray, "m 4"]


class PadWindow(NamedTuple):
    """Part of the image that shows the pad.

    Attributes:
        nodes_m: Points of the resting pattern on the rays of the inverse map's pixels [m].
        across, down: Splines from these nodes to all pixels.
        pixels_m: Points of the resting pattern on all rays [m].
        light: Relative illumination.
    """

    left: int
    top: int
    right: int
    bottom: int
    nodes_m: Float[ndarray, "rows columns 2"]
    across: NodeSpline
    down: NodeSpline
    pixels_m: Float[ndarray, "2 h w"]
    light: Float[ndarray, "h w"]


@lru_cache(maxsize=64)
def pad_window(spec: NuSenseSpec, shift_px: tuple[float, float]) -> PadWindow:
    """Return the part of the image that shows the pad (cached)."""
    half = np.array(spec.pad_m) / 2
    signs = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    corners = seen_px(spec, np.column_stack([signs * half, np.zeros(9)]), shift_px)
    height, width = spec.lens.size_px
    low = np.clip(np.floor(corners.min(axis=0)) - BORDER_PX, 0, (width - 8, height - 8)).astype(int)
    high = np.clip(np.ceil(corners.max(axis=0)) + BORDER_PX, low + 8, (width, height)).astype(int)
    (left, top), (right, bottom) = low.tolist(), high.tolist()
    columns = np.append(np.arange(left, right - 1, NODE_PX), right - 1).astype(float)
    rows = np.append(np.arange(top, bottom - 1, NODE_PX), bottom - 1).astype(float)
    nodes = on_pattern_m(spec, np.stack(np.meshgrid(columns, rows), axis=-1), shift_px)
    across = _node_spline(columns, np.arange(left, right))
    down = _node_spline(rows, np.arange(top, bottom))
    grid = np.stack(np.meshgrid(np.arange(left, right), np.arange(top, bottom)), axis=-1).astype(float)
    pixels = np.moveaxis(on_pattern_m(spec, grid, shift_px), -1, 0)
    return PadWindow(
        left, top, right, bottom, nodes, across, down, pixels, _light(spec, pixels).astype(np.float32)
    )


def _node_spline(nodes: Float[ndarray, " n"], at: ndarray) -> NodeSpline:
    spline = make_interp_spline(nodes, np.eye(len(nodes)), k=3)
    design = BSpline.design_matrix(at, spline.t, 3)
    first = design.indices.reshape(-1, 4)[:, 0].astype(np.int64)
    return NodeSpline(np.ascontiguousarray(spline.c), first, design.data.reshape(-1, 4))


def _light(spec: NuSenseSpec, at_m: Float[ndarray, "2 h w"]) -> Float[ndarray, "h w"]:
    """Illumination over that in the middle, from four edges and the lens's fall-off."""
    lamp, (half_x, half_y) = spec.light, np.array(spec.pad_m) / 2
    x, y = at_m
    distances = (half_x - x, half_x + x, half_y - y, half_y + y)
    edges = sum(
        side * np.exp(-np.maximum(d, 0.0) / lamp.edge_m)
        for side, d in zip(lamp.sides, distances, strict=True)
    )
    fall = 1 / (1 + (x**2 + y**2) / spec.camera_m**2)
    return np.asarray((1 + lamp.edge_share * edges) * fall)


def rest_places(
    spec: NuSenseSpec, motion: PatternMotion | None, shift_px: tuple[float, float] = (0.0, 0.0)
) -> Float[ndarray, "2 h w"]:
    """Return the resting positions of the tiles that each pixel shows [m]."""
    window = pad_window(spec, shift_px)
    if motion is None:
        return window.pixels_m
    lag = _inverse(
        window.nodes_m, motion.knots, *motion.centre_m, motion.cell_m, spec.camera_m, ITERATIONS, SETTLED_M
    )
    return places_by_lag(window, lag)


def places_by_lag(window: PadWindow, lag: Float[ndarray, "2 rows columns"]) -> Float[ndarray, "2 h w"]:
    """Return the resting positions of pixels from the nodes' displacements [m]."""
    across, down = window.across, window.down
    knots = down.knots @ lag @ across.knots.T
    places: Float[ndarray, "2 h w"] = _laid_through(
        knots, across.first, across.weights, down.first, down.weights, window.pixels_m
    )
    return places


@numba.njit(cache=True, nogil=True)
@no_type_check
def _laid_through(knots, left, across, top, down, pixels):
    places = np.empty(pixels.shape)
    rows, height, width = knots.shape[1], pixels.shape[1], pixels.shape[2]
    along = np.empty((rows, width))
    for k in range(2):
        for row in range(rows):
            for x in range(width):
                i = left[x]
                along[row, x] = (
                    across[x, 0] * knots[k, row, i]
                    + across[x, 1] * knots[k, row, i + 1]
                    + across[x, 2] * knots[k, row, i + 2]
                    + across[x, 3] * knots[k, row, i + 3]
                )
        for y in range(height):
            j = top[y]
            for x in range(width):
                places[k, y, x] = pixels[k, y, x] + (
                    down[y, 0] * along[j, x]
                    + down[y, 1] * along[j + 1, x]
                    + down[y, 2] * along[j + 2, x]
                    + down[y, 3] * along[j + 3, x]
                )
    return places


@numba.njit(cache=True, nogil=True)
@no_type_check
def _inverse(nodes, knots, x0, y0, cell, camera, iterations, settled):
    """X - P of each node."""
    rows, columns = nodes.shape[0], nodes.shape[1]
    side = knots.shape[1]
    lag = np.zeros((2, rows, columns))
    weight_x, weight_y = np.empty(4), np.empty(4)
    for row in range(rows):
        for column in range(columns):
            px, py = nodes[row, column, 0], nodes[row, column, 1]
            x, y = px, py
            for _ in range(iterations):
                place_x, place_y = (x - x0) / cell + side / 2 - 0.5, (y - y0) / cell + side / 2 - 0.5
                i, j = int(np.floor(place_x)), int(np.floor(place_y))
                if not (1 <= i < side - 2 and 1 <= j < side - 2):
                    x, y = px, py
                    break
                for t, w in ((place_x - i, weight_x), (place_y - j, weight_y)):
                    w[0] = (1 - t) ** 3 / 6
                    w[1] = (4 - 6 * t * t + 3 * t**3) / 6
                    w[3] = t**3 / 6
                    w[2] = 1 - w[0] - w[1] - w[3]
                moved_x = moved_y = moved_z = 0.0
                for b in range(4):
                    for a in range(4):
                        share = weight_y[b] * weight_x[a]
                        moved_x += share * knots[0, j - 1 + b, i - 1 + a]
                        moved_y += share * knots[1, j - 1 + b, i - 1 + a]
                        moved_z += share * knots[2, j - 1 + b, i - 1 + a]
                near = 1 - moved_z / camera
                new_x, new_y = px * near - moved_x, py * near - moved_y
                step = abs(new_x - x) + abs(new_y - y)
                x, y = new_x, new_y
                if step < settled:
                    break
            lag[0, row, column], lag[1, row, column] = x - px, y - py
    return lag


class TornRest(NamedTuple):
    """What the pixels of a torn pad show.

    Attributes:
        rest_m: Resting positions of the tiles [m].
        open_share: Fraction of each pixel that shows the opening.
        behind: Reflectance through the opening.
    """

    rest_m: Float[ndarray, "2 h w"]
    open_share: Float[ndarray, "h w"]
    behind: float


def clean_view(
    spec: NuSenseSpec,
    motion: PatternMotion | None,
    shift_px: tuple[float, float] = (0.0, 0.0),
    torn: TornRest | None = None,
) -> Float[ndarray, "h w 3"]:
    """Return the frame without noise [grey levels]; `torn` replaces the motion."""
    if motion is None and torn is None:
        return _resting_view(spec, shift_px)
    return _drawn(spec, motion, shift_px, torn)


@lru_cache(maxsize=8)
def _resting_view(spec: NuSenseSpec, shift_px: tuple[float, float]) -> Float[ndarray, "h w 3"]:
    view = _drawn(spec, None, shift_px, None)
    view.flags.writeable = False
    return view


def _drawn(
    spec: NuSenseSpec, motion: PatternMotion | None, shift_px: tuple[float, float], torn: TornRest | None
) -> Float[ndarray, "h w 3"]:
    window, pattern = pad_window(spec, shift_px), spec.pattern
    rest = rest_places(spec, motion, shift_px) if torn is None else torn.rest_m
    half = (pattern.columns * pattern.cast_pitch_m / 2, pattern.rows * pattern.cast_pitch_m / 2)
    colours = np.array([pattern.yellow, pattern.red, pattern.border], np.float32)
    view = _tiles(
        rest, window.light, colours, pattern.cast_pitch_m, *pattern.offset_m, *half, *np.array(spec.pad_m) / 2
    )
    if torn is not None:
        view += torn.open_share[..., None] * (torn.behind * window.light[..., None] - view)
    height, width = spec.lens.size_px
    frame = np.full((height, width, 3), BACKGROUND, np.float32)
    frame[window.top : window.bottom, window.left : window.right] = view * np.float32(spec.light.level)
    if spec.light.blur_px > 0:
        reach = (
            slice(max(window.top - 8, 0), window.bottom + 8),
            slice(max(window.left - 8, 0), window.right + 8),
        )
        frame[reach] = cv2.GaussianBlur(frame[reach], (0, 0), spec.light.blur_px)
    return frame


@numba.njit(cache=True, nogil=True)
@no_type_check
def _tiles(rest, light, colours, pitch, offset_x, offset_y, half_x, half_y, pad_x, pad_y):
    """Color of every pixel, anti-aliased at tile edges."""
    height, width = light.shape
    view = np.empty((height, width, 3), np.float32)
    for row in range(height):
        for column in range(width):
            x, y = rest[0, row, column], rest[1, row, column]
            left, right = max(column - 1, 0), min(column + 1, width - 1)
            up, down = max(row - 1, 0), min(row + 1, height - 1)
            wide_x = _pixel(rest[0], row, column, left, right, up, down)
            wide_y = _pixel(rest[1], row, column, left, right, up, down)
            wave_x = _square_wave(x - offset_x + half_x, wide_x, pitch)
            wave_y = _square_wave(y - offset_y + half_y, wide_y, pitch)
            yellow = 0.5 * (1 + wave_x * wave_y)
            inside = _share(half_x - abs(x - offset_x), wide_x) * _share(half_y - abs(y - offset_y), wide_y)
            pad = _share(pad_x - abs(x), wide_x) * _share(pad_y - abs(y), wide_y)
            for k in range(3):
                tile = yellow * colours[0, k] + (1 - yellow) * colours[1, k]
                value = inside * tile + (1 - inside) * colours[2, k]
                view[row, column, k] = light[row, column] * (pad * value + (1 - pad) * 0.02)
    return view


@numba.njit(cache=True, nogil=True)
@no_type_check
def _pixel(places, row, column, left, right, up, down):
    """Extent of a pixel on one axis of the pattern."""
    along = (places[row, right] - places[row, left]) / (right - left)
    across = (places[down, column] - places[up, column]) / (down - up)
    return abs(along) + abs(across)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _share(inside, wide):
    if abs(inside) >= wide:  # avoids the division
        return 1.0 if inside > 0 else 0.0
    return min(max(inside / wide + 0.5, 0.0), 1.0)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _square_wave(at, wide, pitch):
    """Mean over a pixel of a wave of 1 on the first tile, -1 on the second."""
    nearest = np.floor(at / pitch + 0.5)
    beyond = at - nearest * pitch
    sign = 1.0 if int(nearest) % 2 == 0 else -1.0
    if abs(beyond) >= wide:
        return sign if beyond > 0 else -sign
    return sign * min(max(2 * beyond / wide, -1.0), 1.0)


def exposed(
    spec: NuSenseSpec, view: Float[ndarray, "h w 3"], rng: np.random.Generator, light: float
) -> UInt8[ndarray, "h w 3"]:
    """Return a frame of a view under a light, with read and shot noise."""
    image = np.empty(view.shape, np.uint8)
    noise = rng.standard_normal(view.size, dtype=np.float32)
    camera = spec.light
    _expose(view.ravel(), noise, light, camera.read_noise**2, camera.shot_noise, image.ravel())
    return image


def exposed_by_table(
    spec: NuSenseSpec, view: Float[ndarray, "h w 3"], rng: np.random.Generator, light: float
) -> UInt8[ndarray, "h w 3"]:
    """Return a frame with noise from a table, four times as fast."""
    image = np.empty(view.shape, np.uint8)
    camera, numbers = spec.light, (table_draws(rng, view.size), normal_table())
    _expose_by_table(view.ravel(), *numbers, light, camera.read_noise**2, camera.shot_noise, image.ravel())
    return image


@numba.njit(cache=True, nogil=True)
@no_type_check
def _expose(view, noise, light, read, shot, image):
    for i in range(view.size):
        image[i] = _grey(view[i], noise[i], np.float32(light), np.float32(read), np.float32(shot))


@numba.njit(cache=True, nogil=True)
@no_type_check
def _expose_by_table(view, draws, table, light, read, shot, image):
    for i in range(view.size):
        image[i] = _grey(view[i], table[draws[i]], np.float32(light), np.float32(read), np.float32(shot))


@numba.njit(cache=True, nogil=True)
@no_type_check
def _grey(level, noise, light, read, shot):
    grey = level * light
    grey += np.sqrt(read + shot * grey) * noise
    return np.uint8(min(max(grey + np.float32(0.5), np.float32(0)), np.float32(255)))
