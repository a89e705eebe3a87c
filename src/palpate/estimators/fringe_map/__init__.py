"""Fringe order at every pixel, with its uncertainty: from colour, or from phase-stepped frames."""

from palpate.estimators.fringe_map.colour_order import (
    ColourReader,
    ColourTable,
    disc_orders,
    flat_field,
    grey_order,
    line_orders,
    measured_table,
    nearest_colour,
    order_from_colour,
    read_table,
    table_of,
)
from palpate.estimators.fringe_map.order_map import FrameNoise, OrderMap, Untold, measured_noise
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
