"""What the figures share: the palm in millimetres, its pictures without noise, axes laid out alike."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray

from palpate.core import Pose
from palpate.optics.colour import encode_srgb
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec, View

DPI = 110
SPEC = palm.palm()
R, H, RIM = (1e3 * length for length in (SPEC.indenter_radius_m, SPEC.thickness_m, SPEC.radius_m))  # mm
AS_SEEN = "column [mm from the axis, as the camera sees it]"


def light(x: float, y: float, depth: float, spec: PalmSpec = SPEC) -> tuple[ndarray, ndarray]:
    """Both regions of a press of the spec's ball, exact and without noise, as 8-bit sRGB; mm."""
    contact = palm.press(spec, Pose(x * 1e-3, y * 1e-3, depth * 1e-3))
    edge_on, below = palm.render_clean(contact, spec, exact=True)
    return encode_srgb(edge_on), encode_srgb(below)


def show(axes: Axes, picture: ndarray, view: View, across: tuple[float, float]) -> None:
    """The fringe view with its scale: columns and heights in mm."""
    x, z = view.x_m * 1e3, view.down_m * 1e3
    axes.imshow(picture, extent=(x[0], x[-1], z[-1], z[0]), interpolation="antialiased")
    axes.set(xlim=across, ylim=(H + 1.5, -4.5), yticks=(0, 5, 10))


def sheet(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, ndarray]:
    """An empty figure, size in inches."""
    figure = Figure(figsize=size, layout="constrained", dpi=DPI)
    return figure, np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).reshape(rows, columns)


def outer_labels(grid: ndarray, below: str) -> None:
    """Heights on the left, `below` under the last row."""
    for axes in grid[:, 0]:
        axes.set_ylabel("z [mm]")
    for axes in grid[-1]:
        axes.set_xlabel(below)
