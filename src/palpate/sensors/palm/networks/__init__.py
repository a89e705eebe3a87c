"""Networks for the photoelastic palm: four published ones, a moment baseline, and one trained with rendered
presses.
"""

from palpate.estimators.networks import Kind

FORCES = ("force_x_N", "force_y_N", "force_N")
PLACE = ("x_mm", "y_mm")
"""Targets: force components, the normal one positive in compression, and position."""
REGIONS = ("fringes", "mirror")


def _kind(
    where: str, side_px: int, channels: int, delta: bool, targets: tuple[str, ...], *, costly: bool = True
) -> Kind:
    path = f"{__name__}.{where}"
    return Kind(
        path, side_px, costly=costly, channels=channels, delta=delta, targets=targets, regions=REGIONS
    )


_DEPTH_TARGETS = ("depth_mm", *PLACE, "force_N")
_STAGES = ("depth_mm", *PLACE, *FORCES, "force_magnitude_N")
MODELS: dict[str, Kind] = {
    "palm-joint-raw": _kind("palm_report_networks:PalmJointRaw", 128, 3, False, (*FORCES, *PLACE)),
    "palm-force-conditioned": _kind(
        "palm_report_networks:PalmForceConditioned", 128, 3, True, ("force_N", *PLACE)
    ),
    "palm-mlp-delta": _kind("palm_report_networks:PalmMlpDelta", 128, 1, True, FORCES, costly=False),
    "palm-two-stage": _kind("palm_report_networks:PalmTwoStage", 128, 1, True, _STAGES),
    "palm-moments": _kind("palm_moments:PalmMoments", 96, 1, True, _DEPTH_TARGETS, costly=False),
    "palm-compact": _kind("palm_compact:PalmCompact", 96, 3, True, _DEPTH_TARGETS),
}

__all__ = ["FORCES", "MODELS", "PLACE", "REGIONS"]
