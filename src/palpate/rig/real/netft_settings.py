"""How to talk to a Net F/T box."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from palpate.core.errors import RangeError
from palpate.rig.real import rdt
from palpate.rig.real.netft_calibration import Calibration, Triple


@dataclass(frozen=True, slots=True)
class NetFTSettings:
    """How to talk to a box.

    Attributes:
        rdt_port, http_port: where it listens.
        silence_s: without a new measurement for longer, the stream has failed [s].
        recovery: "stop" ends for good at the first failure. "reconnect" goes on trying; calls raise
            meanwhile, and a box whose page has changed is refused for good. It also takes the stream back
            from another client.
        retry_s: least and greatest wait between tries to reconnect; it doubles in between [s].
        start_tries, start_wait_s: how often to ask for the first record, and how long to wait each time [s].
        http_timeout_s: for the box's page [s].
        keep: how many samples are kept between two calls of `drain`.
        rate_hz: records a second, where the box's page does not say [Hz].
        range_n: greatest force along x, y, z [N]; by default what the page says, in the page's unit.
        calibration: what the page has to say, such as when a run goes on; None for anything.
    """

    rdt_port: int = rdt.PORT
    http_port: int = 80
    silence_s: float = 0.1
    recovery: Literal["stop", "reconnect"] = "stop"
    retry_s: tuple[float, float] = (0.25, 5.0)
    start_tries: int = 10
    start_wait_s: float = 0.1
    http_timeout_s: float = 2.0
    keep: int = 65536
    rate_hz: float | None = None
    range_n: Triple | None = None
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        seconds = (self.silence_s, *self.retry_s, self.start_wait_s, self.http_timeout_s)
        rate_hz = 1.0 if self.rate_hz is None else self.rate_hz
        given = (*seconds, *(self.range_n or ()), self.start_tries, self.keep, rate_hz)
        if not all(value > 0 and math.isfinite(value) for value in given):
            raise RangeError(f"times [s], range [N], rate [Hz] and numbers have to be greater than 0: {self}")
        if self.recovery not in ("stop", "reconnect"):
            raise RangeError(f"recovery is {self.recovery!r}; give 'stop' or 'reconnect'")
