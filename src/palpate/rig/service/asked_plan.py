"""A plan that somebody asks for from outside: refused where to lay it out would take too long."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from palpate.core.errors import InputError
from palpate.rig.plans import PLANS, Known, Stepped, plan_from

MOST_SCATTERED = 1000  # random places, each of which is compared with all the others
MOST_SHOTS = 500_000
SHOWN = 100  # characters of a name


def asked_plan(what: str | Mapping[str, Any]) -> Known:
    """A plan by its name or its fields.

    Raises:
        InputError: no such plan; a field that is not one, or out of range; or more than is planned this way.
    """
    if isinstance(what, str):
        if what not in PLANS:
            raise InputError(f"there is no plan {what[:SHOWN]!r}; there are {', '.join(PLANS)}")
        return PLANS[what]
    places = what.get("places")
    count = places.get("count") if isinstance(places, Mapping) else None
    if isinstance(count, int | float) and count > MOST_SCATTERED:
        raise InputError(f"{count:g} random places; up to {MOST_SCATTERED} can be asked for here")
    plan = plan_from(what)
    depths = plan.depth_mm / plan.step_mm if isinstance(plan, Stepped) else 1.0
    shots = len(plan.places.places()) * plan.cycles * len(plan.indenters) * max(depths, 1.0)
    if not shots <= MOST_SHOTS:
        raise InputError(
            f"about {shots:.3g} shots; up to {MOST_SHOTS} can be asked for here: take fewer presses, or a "
            "larger step"
        )
    return plan
