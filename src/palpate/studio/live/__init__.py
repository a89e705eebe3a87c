"""Pages of what is measured now: the first steps with a sensor, and sensors that are read live."""

__all__: list[str] = []
