"""Recording plans: what is recorded, where and in which order, as presses, keyed shots and steps."""

from palpate.rig.plans.plan_files import (
    PLANS,
    Dwell,
    Known,
    Lateral,
    Ramp,
    Size,
    StepHold,
    SurfaceSearch,
    plan_from,
    plan_of,
    plan_of_sensor,
    size_of,
)
from palpate.rig.plans.press_places import Around, Grid, Listed, Place, Scattered
from palpate.rig.plans.recording_plan import PlannedPress, RecordingPlan, Shot

__all__ = [
    "PLANS",
    "Around",
    "Dwell",
    "Grid",
    "Known",
    "Lateral",
    "Listed",
    "Place",
    "PlannedPress",
    "Ramp",
    "RecordingPlan",
    "Scattered",
    "Shot",
    "Size",
    "StepHold",
    "SurfaceSearch",
    "plan_from",
    "plan_of",
    "plan_of_sensor",
    "size_of",
]
