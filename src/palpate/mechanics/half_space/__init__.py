"""Contacts on an elastic half-space in closed form: spheres, cones and punches, and the stress below them.

Each module is one family of laws, asked for by its path; `palpate.mechanics` offers those used most.
"""

__all__: list[str] = []
