"""Devices that speak the real protocols over real sockets and terminals, and fail on request."""

__all__: list[str] = []
