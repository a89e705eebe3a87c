"""What the source prints, to stand beside what is found here.

Source: "Photoelastic Tactile Sensor for a Robotic Palm" (2026), tables 2 to 4 and section 6.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Printed(NamedTuple):
    """One number of the source, and where it stands."""

    value: float
    where: str


class Training(NamedTuple):
    """A row of its Table 2."""

    optimiser: str
    batch: int
    epochs: int
    split: str


NAMES: Mapping[str, str] = MappingProxyType(
    {
        "palm-joint-raw": "Joint multi-task (raw RGB)",
        "palm-force-conditioned": "Force-conditioned (differential RGB)",
        "palm-mlp-delta": "MLP (flattened fringe delta, grey)",
        "palm-two-stage": "Two-stage (differential grey)",
        "palm-compact": "palm-compact (ours, differential RGB)",
    }
)

TABLE_2: Mapping[str, Training] = MappingProxyType(
    {
        "palm-joint-raw": Training("Adam", 32, 30, "location-disjoint"),
        "palm-force-conditioned": Training("Adam", 32, 30, "location-disjoint"),
        "palm-mlp-delta": Training("Adam", 200, 2000, "location-disjoint"),
        "palm-two-stage": Training("Adam", 32, 50, "location-disjoint"),
    }
)

FORCE, PLACE, DEPTH = "force_N", "place_mm", "depth_mm"

MAE: Mapping[tuple[str, str], Printed] = MappingProxyType(
    {
        ("palm-joint-raw", FORCE): Printed(0.443, "Table 3"),
        ("palm-joint-raw", PLACE): Printed(2.321, "Table 3"),
        ("palm-joint-raw", "x_mm"): Printed(1.718, "sec. 6.2.2"),
        ("palm-joint-raw", "y_mm"): Printed(1.243, "sec. 6.2.2"),
        ("palm-force-conditioned", FORCE): Printed(0.244, "Table 3"),
        ("palm-force-conditioned", PLACE): Printed(3.205, "Table 3"),
        ("palm-force-conditioned", "x_mm"): Printed(1.247, "sec. 6.2.2"),
        ("palm-force-conditioned", "y_mm"): Printed(2.757, "sec. 6.2.2"),
        ("palm-mlp-delta", FORCE): Printed(0.330, "Table 3"),
        ("palm-mlp-delta", "force_x_N"): Printed(0.036, "sec. 6.2.1"),
        ("palm-mlp-delta", "force_y_N"): Printed(0.045, "sec. 6.2.1"),
        ("palm-two-stage", FORCE): Printed(0.486, "Table 3"),
        ("palm-two-stage", PLACE): Printed(0.204, "Table 3"),
        ("palm-two-stage", DEPTH): Printed(0.165, "sec. 6.2.3"),
        ("palm-two-stage", "x_mm"): Printed(0.131, "Table 4"),
        ("palm-two-stage", "y_mm"): Printed(0.147, "Table 4"),
        ("palm-two-stage", "force_x_N"): Printed(0.035, "sec. 6.2.1"),
        ("palm-two-stage", "force_y_N"): Printed(0.037, "sec. 6.2.1"),
        ("palm-two-stage", "force_magnitude_N"): Printed(0.457, "sec. 6.2.1"),
    }
)
"""Mean absolute errors; a place's is the mean distance."""

R2: Mapping[tuple[str, str], Printed] = MappingProxyType(
    {
        ("palm-two-stage", FORCE): Printed(0.990, "sec. 6.2.1"),
        ("palm-two-stage", "force_x_N"): Printed(0.600, "sec. 6.2.1"),
        ("palm-two-stage", "force_y_N"): Printed(0.975, "sec. 6.2.1"),
        ("palm-two-stage", "force_magnitude_N"): Printed(0.990, "sec. 6.2.1"),
        ("palm-two-stage", DEPTH): Printed(0.978, "sec. 6.2.3"),
        ("palm-two-stage", "x_mm"): Printed(0.9997, "sec. 6.2.2"),
        ("palm-two-stage", "y_mm"): Printed(0.9998, "sec. 6.2.2"),
    }
)


class Peer(NamedTuple):
    """A row of its Table 4."""

    sensor: str
    force: str
    place: str
    principle: str


PEERS = (
    Peer("Insight", "about 0.03 N, normal and shear", "about 0.4 mm", "photometric stereo, deep network"),
    Peer("Kakani et al.", "0.022 N average", "x 1.396, y 0.973 mm", "stereo camera, VGG16"),
    Peer("Soft-bubble", "not as MAE", "not as MAE", "depth camera inside, ICP"),
    Peer("ROMEO palm", "not as MAE", "not as MAE", "camera inside, LED array"),
)
"""The other sensors of Table 4, as the source gives them."""
