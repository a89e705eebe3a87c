"""Verbs that make and check: demo, renderings, mechanics."""

__all__: list[str] = []
