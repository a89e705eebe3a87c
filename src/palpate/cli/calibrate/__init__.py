"""Verbs that calibrate: estimators, lenses, force of a patterned skin."""

__all__: list[str] = []
