"""Verbs that make and check: demo, renderings, reproductions, mechanics."""

__all__: list[str] = []
