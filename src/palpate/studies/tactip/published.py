"""What the compliance report prints.

Source: Pagnanelli et al., Model-Based Compliance Discrimination via Soft Tactile Optical Sensing and Optical
Flow Computation: A Biomimetic Approach, IEEE Robotics and Automation Letters.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Printed:
    """A number, and where it is printed."""

    value: float
    where: str


NAMES = ("S1", "new", "S2", "S3")
"""Stiffest first."""

KAPPA = {
    "S1": Printed(7.6, "section V"),
    "new": Printed(5.3, "section V"),
    "S2": Printed(3.1, "section V"),
    "S3": Printed(1.1, "section V"),
}
"""By a rigid plate [N/mm]."""

KAPPA_NEW = {
    0: Printed(4.99, "section V, Fig. 7"),
    30: Printed(3.95, "section V, Fig. 9"),
    45: Printed(6.8, "section V, Fig. 9"),
}
"""Of the new specimen by touch, at each tilt in degrees [N/mm]."""

ADJUSTED_R2 = Printed(0.882, "section V, the worst of Fig. 5(a)")
RANK_SUM_P = Printed(9.91e-55, "section V, the worst pair of Fig. 5(b), pooled samples")
KRUSKAL_P = Printed(6.3e-5, "section V, Fig. 6(b)")
DUNN_P = {
    0: Printed(0.01, "section V, Fig. 6(b), worst pair, 'LSD'"),
    30: Printed(0.01, "section V, Fig. 9(b), worst pair, 'LSD'"),
    45: Printed(0.005, "section V, Fig. 9(d), worst pair, 'LSD'"),
}
