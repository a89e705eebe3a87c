"""Bodies of revolution: shipped tables at finite strain, and linear finite elements by Fourier modes."""

__all__: list[str] = []
