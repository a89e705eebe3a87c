"""What is recorded, where and in which order, as presses, keyed shots and steps."""

from palpate.rig.plans.load import PLANS, Size, plan_from, plan_of, size_of
from palpate.rig.plans.places import Grid, Listed, Place, Scattered
from palpate.rig.plans.plan import Plan, Press
from palpate.rig.plans.stepped import Dwell, Lateral, Stepped
from palpate.rig.plans.steps import Shot
from palpate.rig.plans.swept import Swept

__all__ = [
    "PLANS",
    "Dwell",
    "Grid",
    "Lateral",
    "Listed",
    "Place",
    "Plan",
    "Press",
    "Scattered",
    "Shot",
    "Size",
    "Stepped",
    "Swept",
    "plan_from",
    "plan_of",
    "size_of",
]
