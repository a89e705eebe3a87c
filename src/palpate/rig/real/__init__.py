"""Drivers of real devices, one a file; each needs its own library only when it is opened."""

__all__: list[str] = []
