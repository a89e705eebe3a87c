"""Closed-form contacts on an elastic half-space: spheres, cones, and punches, and the stress below them."""

__all__: list[str] = []
