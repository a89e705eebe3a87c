"""Image features for kernels: blurred pixels and pin moments, of operations that ONNX has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from scipy.spatial import cKDTree

from palpate.core import Float, Float32, ImageError, Int, Tensor
from palpate.estimators.networks.onnx_graph import OnnxGraph
from palpate.estimators.pins import FLOOR, REACH, PinTracks, find_pins

GREY = 255.0
TAIL = 3.0  # standard deviations at which a Gaussian window ends


@runtime_checkable
class ImageFeatures(Protocol):
    """Map from images to rows of features."""

    @property
    def name(self) -> str: ...

    def compute(self, inputs: Tensor) -> Float32[np.ndarray, "n f"]: ...

    def add_to(self, graph: OnnxGraph) -> str:
        """Add the map to a graph after its image; return the name of its output ``[n f]``."""


def gaussian_window(sigma_px: float) -> Float[np.ndarray, " k"]:
    """Return a Gaussian window of unit sum and odd length, at least three pixels."""
    reach = max(1, round(TAIL * sigma_px))
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    return np.asarray(window / window.sum())


@dataclass(frozen=True, slots=True)
class BlurredPixels:
    """Pixels after a Gaussian blur, subsampled by its width; beyond the image is black."""

    channels: int
    blur_px: float

    @property
    def name(self) -> str:
        return f"pixels, blurred by {self.blur_px:g} px" if self.blur_px else "pixels"

    @property
    def step(self) -> int:
        """Pixels between samples: a blur's width."""
        return max(1, int(self.blur_px))

    def compute(self, inputs: Tensor) -> Float32[np.ndarray, "n f"]:
        if not self.blur_px:
            return inputs.reshape(len(inputs), -1) / np.float32(GREY)
        window = gaussian_window(self.blur_px)
        blurred = [[filtered(plane, window, window)[:: self.step, :: self.step] for plane in image]
                   for image in inputs]  # fmt: skip
        return np.asarray(blurred, np.float32).reshape(len(inputs), -1) / np.float32(GREY)

    def add_to(self, graph: OnnxGraph) -> str:
        at = "image"
        if self.blur_px:
            window = gaussian_window(self.blur_px)
            square = np.outer(window, window).astype(np.float32)
            weights = {"blur": np.repeat(square[None, None], self.channels, axis=0)}
            pads, strides = [len(window) // 2] * 4, [self.step] * 2
            at = graph.add("Conv", [at], weights, group=self.channels, pads=pads, strides=strides)
        return graph.add("Div", [graph.add("Flatten", [at])], {"grey": np.array([GREY], np.float32)})


def filtered(
    plane: Float32[np.ndarray, "h w"], across: Float[np.ndarray, " k"], down: Float[np.ndarray, " k"]
) -> Float32[np.ndarray, "h w"]:
    """Return the correlation of a plane with the outer product of two windows, black beyond edges."""
    return cv2.sepFilter2D(plane, cv2.CV_32F, across, down, borderType=cv2.BORDER_CONSTANT)


def band(window: Float32[np.ndarray, " k"], size: int) -> Float32[np.ndarray, "n n"]:
    """Return the matrix that correlates a row of pixels with a window, black beyond its ends."""
    reach, places = len(window) // 2, np.arange(size)
    apart = places[:, None] - places
    within = np.abs(apart) <= reach
    return np.where(within, window[np.where(within, apart + reach, 0)], 0).astype(np.float32)


@dataclass(frozen=True, slots=True)
class PinMoments:
    """Brightness and its centroid in a Gaussian window about each mean pin position.

    Attributes:
        columns, rows: Mean positions of the pins, rounded [px].
        window_px: Standard deviation of the window [px].
        pitches: The same in nearest-neighbor distances.
        sign: 1 for bright pins, -1 for dark ones.
        floor: Gray level that counts nothing.
        typical: Mean brightness in a window; the divisor is at least a fifth of it.
    """

    height: int
    width: int
    columns: Int[np.ndarray, " p"]
    rows: Int[np.ndarray, " p"]
    window_px: float
    pitches: float
    sign: int
    floor: float
    typical: float = 1.0

    SOFT = 0.2

    @property
    def name(self) -> str:
        return f"moments at {len(self.rows)} pins, windows of {self.pitches:g} pitches"

    @property
    def _windows(self) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """Window, and window times position in units of its width."""
        window = gaussian_window(self.window_px)
        reach = len(window) // 2
        return window, window * np.arange(-reach, reach + 1) / self.window_px

    def _places(self) -> Int[np.ndarray, "3 p"]:
        """Indices of each pin's moments in the flat maps of the graph."""
        line = 2 * self.height  # of one column of the image: both windows down, after one window across
        zeroth = self.columns * line + self.rows
        return np.stack([zeroth, zeroth + self.width * line, zeroth + self.height])

    def moments(self, inputs: Tensor) -> Float32[np.ndarray, "n 3 p"]:
        """Zeroth moment, and first moments along x and y, about each position."""
        flat, sloped = self._windows
        found = []
        for (image,) in inputs:
            bright = np.maximum(self.sign * (image - np.float32(self.floor)), 0) / np.float32(GREY)
            maps = (filtered(bright, *pair) for pair in ((flat, flat), (sloped, flat), (flat, sloped)))
            found.append([one[self.rows, self.columns] for one in maps])
        return np.asarray(found, np.float32).reshape(len(inputs), 3, len(self.rows))

    def compute(self, inputs: Tensor) -> Float32[np.ndarray, "n f"]:
        moments = self.moments(inputs)
        weight, typical = moments[:, :1], np.float32(self.typical)
        centroids = moments[:, 1:] / (weight + np.float32(self.SOFT) * typical)
        return np.concatenate([weight / typical, centroids], axis=1).reshape(len(inputs), -1)

    def add_to(self, graph: OnnxGraph) -> str:
        flat, sloped = (window.astype(np.float32) for window in self._windows)
        above = graph.add("Sub", ["image"], {"floor": np.array([self.floor], np.float32)})
        bright = graph.add(
            "Relu", [graph.add("Mul", [above], {"sign": np.array([self.sign / GREY], np.float32)})]
        )
        reach = len(flat) // 2
        across = {"across": np.stack([flat, sloped])[:, None, None]}
        lines = graph.add("Conv", [bright], across, pads=[0, reach, 0, reach])
        columns = graph.add("Transpose", [lines], perm=[0, 1, 3, 2])
        down = {"down": np.hstack([band(one, self.height) for one in (flat, sloped)])}
        maps = graph.add("Reshape", [graph.add("MatMul", [columns], down)], {"shape": np.array([0, -1])})
        at_pins = graph.add("Gather", [maps], {"at": self._places()}, axis=1)
        weight = graph.add("Gather", [at_pins], {"zeroth": np.array([0])}, axis=1)
        first = graph.add("Gather", [at_pins], {"first": np.array([1, 2])}, axis=1)
        soft = graph.add("Add", [weight], {"soft": np.array([self.SOFT * self.typical], np.float32)})
        share = graph.add("Div", [weight], {"typical": np.array([self.typical], np.float32)})
        return graph.add("Flatten", [graph.add("Concat", [share, graph.add("Div", [first, soft])], axis=1)])


MAX_FRAMES = 40  # in which pins are looked for
SAME_COUNT = 0.15  # by which the number of pins may differ from frame to frame


def usual_pins(images: Tensor) -> tuple[PinTracks, int] | None:
    """Return the pins of images at their mean positions, and 1 if bright or -1 if dark.

    Args:
        images: Gray levels ``[n c h w]``; at most `MAX_FRAMES` are used.

    Returns:
        None for several channels, differences, or images without consistent pins.
    """
    if images.shape[1] != 1 or not len(images) or images.min() < 0 or images.max() > GREY:
        return None
    planes = images[:, 0]
    typical = int(np.argmin(((planes - planes.mean(axis=0)) ** 2).sum(axis=(1, 2))))
    planes = planes[[typical, *range(0, len(planes), -(-len(planes) // MAX_FRAMES))]]
    for sign in (1, -1):
        frames = np.round(planes if sign > 0 else GREY - planes).astype(np.uint8)
        try:
            pins = [find_pins(frame, on_lattice=False) for frame in frames]
        except ImageError:
            continue
        counts = np.array([len(one.xy_px) for one in pins])
        if np.ptp(counts) <= 2 * SAME_COUNT * np.median(counts):
            return _at_mean_places(pins), sign
    return None


def _at_mean_places(pins: list[PinTracks]) -> PinTracks:
    first, sums, counts = pins[0], pins[0].xy_px.copy(), np.ones(len(pins[0].xy_px))
    for one in pins[1:]:
        apart, nearest = cKDTree(one.xy_px).query(first.xy_px)
        near = apart < first.reach_px
        sums[near] += one.xy_px[nearest[near]]
        counts += near
    xy = sums / counts[:, None]
    return PinTracks(xy, first.ground, first.bright, first.reach_px, first.weight)


def pin_moments(images: Tensor, windows: tuple[float, ...]) -> list[PinMoments]:
    """Return moments about the pins of images for windows in pin distances; none without pins."""
    found = usual_pins(images)
    if found is None:
        return []
    (pins, sign), (height, width) = found, images.shape[2:]
    pitch = float(np.median(pins.reach_px)) / REACH
    floor = pins.ground + FLOOR * (pins.bright - pins.ground)
    columns, rows = np.round(pins.xy_px).astype(np.int64).T
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    level = floor if sign > 0 else GREY - floor
    made = []
    for window in windows:
        one = PinMoments(
            height, width, columns[inside], rows[inside], window * pitch, window, sign, float(level)
        )
        typical = float(one.moments(images)[:, 0].mean())
        if typical > 0:
            made.append(
                PinMoments(
                    height, width, one.columns, one.rows, one.window_px, window, sign, one.floor, typical
                )
            )
    return made
