"""Contacts on an elastic half-space in closed form: spheres, cones and punches, and the stress below them."""

__all__: list[str] = []
