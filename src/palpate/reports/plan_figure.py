"""A plan's places, drawn: the layer, the probe at each place, and the order."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import Circle

from palpate.core import new_file
from palpate.rig.plans.recording_plan import RecordingPlan

LAYER, PROBE, INK = "#cfe8e6", "#0b7a75", "#1b2a33"
MARGIN_MM = 3.0


def draw_places(plan: RecordingPlan, path: Path) -> None:
    """Write a PNG of the positions to press."""
    places = plan.places.places()
    layer, probe = (diameter / 2 for diameter in plan.places.sizes_mm())
    figure = Figure(figsize=(6, 6.4), layout="constrained")
    axes = figure.add_subplot()
    axes.add_patch(Circle((0, 0), layer, facecolor=LAYER, edgecolor=INK, lw=1.2))
    for i, place in enumerate(places):
        at = (place.x_mm, place.y_mm)
        axes.add_patch(Circle(at, probe, facecolor="none", edgecolor=PROBE, lw=0.6, alpha=0.45))
        axes.text(*at, str(i + 1), ha="center", va="center", fontsize=7, color=INK)
    furthest = max(max(abs(place.x_mm), abs(place.y_mm)) for place in places)
    reach = max(layer, furthest + probe) + MARGIN_MM
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach), xlabel="x [mm]", ylabel="y [mm], towards the viewer")
    axes.set_aspect("equal")
    presses = f"{len(places)} places × {plan.cycles} {'cycle' if plan.cycles == 1 else 'cycles'}"
    axes.set_title(
        f"{plan.name}: {presses}, probe of {2 * probe:g} mm on {2 * layer:g} mm", fontsize=10, loc="left"
    )
    axes.spines[["top", "right"]].set_visible(False)
    with new_file(path) as file:
        figure.savefig(file, format="png", dpi=120)
