"""Devices that speak the real protocols over real sockets and wires, and fail on request."""

__all__: list[str] = []
