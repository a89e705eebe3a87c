"""Compliance by touch: force of a press or grasp, contact area and its spread rate, bulge of the gel."""

__all__: list[str] = []
