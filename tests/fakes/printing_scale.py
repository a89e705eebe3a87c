"""A fake load cell or balance that prints lines, on request or by itself. It fails as it is told to.

Made from public interface descriptions, not from a device: the lines of an HX711 behind a microcontroller are
bare numbers (data sheet: 24 bits, 10 or 80 samples a second); those of balances follow A&D's Standard Format
(GX/GH series manuals), Mettler-Toledo's MT-SICS ("SI" answers "S S" or "S D") and Sartorius' SBI (the unit is
left out while it is unstable). Baud and frame of the port are not simulated.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

G0 = 9.80665
Layout = Literal["counts", "grams", "a&d", "sics", "sbi"]


@dataclass(frozen=True, slots=True)
class ScaleFaults:
    """Faults; none by default.

    Attributes:
        mute: it prints nothing.
        stuck: it prints the last number again and again.
        garbled_every: one line in so many is damaged; 0 for none.
        nonsense: it prints bytes that are no text.
        cut: every line lacks its first half.
        overloaded: it is pressed beyond its range.
    """

    mute: bool = False
    stuck: bool = False
    garbled_every: int = 0
    nonsense: bool = False
    cut: bool = False
    overloaded: bool = False


class PrintingScale:
    """Device at the other end of a serial line; times in seconds.

    Args:
        force: along the cell's axis, at a time [N].
        layout: of its lines.
        rate_hz: lines a second where it is not asked [Hz].
        delay_s: of its filter, as a pure delay [s].
        count_n: of one count [N].
        noise_n: standard deviation of one sample [N].
        on_request: it answers "SI" and "Q" alone, and prints nothing by itself.
        faults: may be changed at any time.
    """

    def __init__(
        self,
        force: Callable[[float], float] = lambda t: 0.0,
        *,
        layout: Layout = "grams",
        rate_hz: float = 10.0,
        delay_s: float = 0.4,
        count_n: float = 1e-5,
        noise_n: float = 1e-3,
        on_request: bool = False,
        faults: ScaleFaults | None = None,
        now_s: float = 0.0,
    ) -> None:
        self._force, self._layout, self._rate_hz = force, layout, rate_hz
        self._delay_s, self._count_n, self._noise_n = delay_s, count_n, noise_n
        self._on_request, self.faults = on_request, faults or ScaleFaults()
        self._now_s, self._next_s = now_s, now_s
        self._out, self._heard = bytearray(), bytearray()
        self._draw = np.random.default_rng(0)
        self._stood_n: float | None = None
        self.printed = 0

    def receive(self, data: bytes) -> None:
        """Bytes from the host, now."""
        self._heard += data
        while b"\n" in self._heard:
            line, _, rest = bytes(self._heard).partition(b"\n")
            self._heard = bytearray(rest)
            if line.strip() in (b"SI", b"Q") and self._on_request:
                self._print()

    def take(self) -> bytes:
        """Bytes for the host."""
        sent = bytes(self._out)
        self._out.clear()
        return sent

    def run_to(self, now_s: float) -> None:
        """Let time go by until then [s]."""
        while not self._on_request and self._next_s <= now_s:
            self._now_s = self._next_s
            self._print()
            self._next_s += 1.0 / self._rate_hz
        self._now_s = max(self._now_s, now_s)

    def _print(self) -> None:
        faults = self.faults
        if faults.mute:
            return
        self.printed += 1
        if faults.nonsense:
            self._out += self._draw.integers(128, 256, 12, dtype=np.uint8).tobytes() + b"\r\n"
            return
        line = self._line().encode()
        if faults.garbled_every and self.printed % faults.garbled_every == 0:
            line = line[: len(line) // 2] + b"\xf0" + line[len(line) // 2 :]
        self._out += (line[len(line) // 2 :] if faults.cut else line) + b"\r\n"

    def _line(self) -> str:
        if self.faults.overloaded:
            return {"counts": str(2**23 - 1), "sics": "S +", "sbi": "      H", "a&d": "OL,+999999E+19"}.get(
                self._layout, "OL"
            )
        stood = self._stood_n is not None and self.faults.stuck
        at_s = self._now_s - self._delay_s
        newtons = self._stood_n if stood else self._force(at_s) + self._draw.normal(0.0, self._noise_n)
        assert newtons is not None
        self._stood_n = newtons
        steady = math.isclose(self._force(at_s), self._force(at_s - 0.5), abs_tol=5 * self._noise_n)
        return self._shown(newtons, newtons / G0 * 1e3, steady)

    def _shown(self, newtons: float, grams: float, steady: bool) -> str:
        match self._layout:
            case "counts":
                return f"{round(newtons / self._count_n)}"
            case "grams":
                return f"{grams:.2f} g"
            case "a&d":
                return f"{'ST' if steady else 'US'},{grams:+010.3f}  g"
            case "sics":
                return f"S {'S' if steady else 'D'} {grams:10.2f} g"
            case "sbi":
                return f"{'-' if grams < 0 else '+'} {abs(grams):8.2f} {'g  ' if steady else '   '}"
