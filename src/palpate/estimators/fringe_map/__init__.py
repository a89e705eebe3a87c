"""Fringe order at every pixel by its color, with its uncertainty."""

from palpate.estimators.fringe_map.colour_order import (
    ColourReader,
    ColourTable,
    disc_orders,
    flat_field,
    grey_order,
    line_orders,
    measured_table,
    nearest_colour,
    read_table,
    table_of,
)
from palpate.estimators.fringe_map.order_map import FrameNoise, OrderMap, Untold, measured_noise

__all__ = [
    "ColourReader",
    "ColourTable",
    "FrameNoise",
    "OrderMap",
    "Untold",
    "disc_orders",
    "flat_field",
    "grey_order",
    "line_orders",
    "measured_noise",
    "measured_table",
    "nearest_colour",
    "read_table",
    "table_of",
]
