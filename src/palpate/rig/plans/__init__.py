"""What is recorded, where and in which order, as presses, keyed shots and steps."""

from palpate.rig.plans.load import PLANS, Known, Size, plan_from, plan_of, size_of
from palpate.rig.plans.places import Around, Grid, Listed, Place, Scattered
from palpate.rig.plans.plan import Plan, Press
from palpate.rig.plans.stepped import Dwell, Lateral, Stepped
from palpate.rig.plans.steps import Shot
from palpate.rig.plans.swept import Swept
from palpate.rig.plans.touched import Touched

__all__ = [
    "PLANS",
    "Around",
    "Dwell",
    "Grid",
    "Known",
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
    "Touched",
    "plan_from",
    "plan_of",
    "size_of",
]
