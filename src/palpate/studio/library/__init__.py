"""Pages of what is kept: recordings, calibrations, trials; and the folder that they are found in."""

__all__: list[str] = []
