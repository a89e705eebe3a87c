"""Fakes of softness devices, which tests talk to."""

__all__: list[str] = []
