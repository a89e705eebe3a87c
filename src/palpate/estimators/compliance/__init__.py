"""Compliance by touch: force of a press or a grasp, the contact's area and spread rate, the gel's bulge.

Each module is one way or one step of it, asked for by its path.
"""

__all__: list[str] = []
