"""Bodies of revolution: shipped tables at finite strain, and linear finite elements by Fourier modes.

Each module is asked for by its path; `palpate.mechanics` offers the sphere's tables.
"""

__all__: list[str] = []
