"""Networks for the photoelastic palm: four published ones, a moment baseline, and one trained with rendered
presses.
"""

from palpate.estimators.networks import Kind

FORCES = ("force_x_N", "force_y_N", "force_N")
PLACE = ("x_mm", "y_mm")
"""Targets: force components, the normal one positive in compression, and position."""
REGIONS = ("fringes", "mirror")

MODELS: dict[str, Kind] = {
    "palm-joint-raw": Kind(
        f"{__name__}.palm_report_networks:PalmJointRaw",
        128,
        costly=True,
        channels=3,
        delta=False,
        targets=(*FORCES, *PLACE),
        regions=REGIONS,
    ),
    "palm-force-conditioned": Kind(
        f"{__name__}.palm_report_networks:PalmForceConditioned",
        128,
        costly=True,
        channels=3,
        delta=True,
        targets=("force_N", *PLACE),
        regions=REGIONS,
    ),
    "palm-mlp-delta": Kind(
        f"{__name__}.palm_report_networks:PalmMlpDelta",
        128,
        channels=1,
        delta=True,
        targets=FORCES,
        regions=REGIONS,
    ),
    "palm-two-stage": Kind(
        f"{__name__}.palm_report_networks:PalmTwoStage",
        128,
        costly=True,
        channels=1,
        delta=True,
        targets=("depth_mm", *PLACE, *FORCES, "force_magnitude_N"),
        regions=REGIONS,
    ),
    "palm-moments": Kind(
        f"{__name__}.palm_moments:PalmMoments",
        96,
        channels=1,
        delta=True,
        targets=("depth_mm", *PLACE, "force_N"),
        regions=REGIONS,
    ),
    "palm-compact": Kind(
        f"{__name__}.palm_compact:PalmCompact",
        96,
        costly=True,
        channels=3,
        delta=True,
        targets=("depth_mm", *PLACE, "force_N"),
        regions=REGIONS,
    ),
}

__all__ = ["FORCES", "MODELS", "PLACE", "REGIONS"]
