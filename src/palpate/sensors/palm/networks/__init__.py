"""Networks for the photoelastic palm: four published ones, and one that learns from rendered presses too."""

__all__: list[str] = []
