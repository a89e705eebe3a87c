"""Layers with a cut from the surface: finite elements across the cut, waves along it."""

__all__: list[str] = []
