"""Fringe order at every pixel, with its uncertainty: from colour, or from phase-stepped frames."""

from palpate.estimators.fringe_map.colour_order import (
    ColourReader,
    flat_field,
    grey_order,
    nearest_colour,
    order_from_colour,
)
from palpate.estimators.fringe_map.colour_table import (
    ColourTable,
    disc_orders,
    line_orders,
    measured_table,
    read_table,
    table_of,
)
from palpate.estimators.fringe_map.frame_noise import FrameNoise, measured_noise
from palpate.estimators.fringe_map.order_map import OrderMap, Untold
from palpate.estimators.fringe_map.phase_order import (
    CAMERA,
    SIX_STEPS,
    CameraReader,
    best_place,
    order_from_phases,
    split_mosaic,
)

__all__ = [
    "CAMERA",
    "SIX_STEPS",
    "CameraReader",
    "ColourReader",
    "ColourTable",
    "FrameNoise",
    "OrderMap",
    "Untold",
    "best_place",
    "disc_orders",
    "flat_field",
    "grey_order",
    "line_orders",
    "measured_noise",
    "measured_table",
    "nearest_colour",
    "order_from_colour",
    "order_from_phases",
    "read_table",
    "split_mosaic",
    "table_of",
]
