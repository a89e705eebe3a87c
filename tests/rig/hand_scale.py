"""A kitchen scale beneath a virtual hand, on a pseudo-terminal: ten lines a second, late by its filter."""

from collections.abc import Callable

G0 = 9.80665
LATE_S = 0.4  # from a change of force until it is printed in full, as a scale is taken to be by default
LINES_HZ = 10.0


class HandScale:
    """Device that prints a force of a while ago, in a unit of so many newtons, and a load beside it."""

    def __init__(
        self, force_n: Callable[[float], float], newtons: float = 1e-3 * G0, tare_n: float = 0.0
    ) -> None:
        self._force_n, self._newtons, self._tare_n = force_n, newtons, tare_n
        self._next_s: float | None = None
        self._said = bytearray()
        self.lines = 0

    def receive(self, data: bytes) -> None:
        """Nothing is asked of it."""

    def take(self) -> bytes:
        said, self._said = bytes(self._said), bytearray()
        return said

    def run_to(self, now_s: float) -> None:
        if self._next_s is None:
            self._next_s = now_s
        while self._next_s <= now_s:
            weight = (self._force_n(self._next_s - LATE_S) + self._tare_n) / self._newtons
            self._said += f"{weight:.4f}\r\n".encode()
            self._next_s += 1 / LINES_HZ
            self.lines += 1
