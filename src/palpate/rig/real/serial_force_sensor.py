"""A force sensor that sends by itself over a serial port: bytes to samples in a thread of its own."""

from __future__ import annotations

from collections import deque
from threading import Event, Lock, Thread
from typing import Protocol, runtime_checkable

from palpate.core import NS_PER_S, Clock, Closing, DeviceError, MonotonicClock, Wrench
from palpate.rig.real.serial_port import HeardTail, SerialPort

MAX_READ_BYTES = 4096


@runtime_checkable
class SampleStream(Protocol):
    """Bytes in, samples out."""

    @property
    def failure(self) -> DeviceError | None:
        """Why the stream is worth nothing any more; None while it is."""

    def take(self, data: bytes, time_ns: int) -> list[Wrench]:
        """The samples that end in these bytes, which arrived at `time_ns` [ns]."""


class SerialForceSensor(Closing):
    """Reader of one port. Opening it waits for the first sample.

    Args:
        stream: makes samples of bytes; touched under this object's lock alone.
        port: an open serial port, which this object closes.
        what: it is called in messages, such as "the scale at /dev/ttyUSB0".
        silent_s: without a sample for longer, it has failed [s].
        begins_s: for so long the first sample is waited for [s]; left out, `silent_s`.
        keep: samples kept between two calls of `drain`.
        clock: stamps the samples.

    Raises:
        DeviceError: no sample came.
    """

    def __init__(
        self,
        stream: SampleStream,
        port: SerialPort,
        what: str,
        silent_s: float,
        keep: int,
        clock: Clock | None = None,
        begins_s: float | None = None,
    ) -> None:
        self._stream, self._port, self._clock = stream, port, clock or MonotonicClock()
        self._what, self._silent_s = what, silent_s
        self._begins_s = silent_s if begins_s is None else begins_s
        self._lock, self._closing = Lock(), Event()
        self._tail = HeardTail()
        self._kept: deque[Wrench] = deque(maxlen=keep)
        self._latest: Wrench | None = None
        self._overflowed, self._failure = 0, ""
        self._heard_ns = self._clock.now_ns()
        self._first = Event()
        self._thread = Thread(target=self._run, name=what, daemon=True)
        self._thread.start()
        try:
            self._await_first()
        except BaseException:
            self.close()
            raise

    def latest(self) -> Wrench:
        with self._lock:
            self._refuse_failed()
            if self._latest is None:
                raise DeviceError(f"{self._what} has sent nothing yet")
            return self._latest

    def drain(self) -> list[Wrench]:
        with self._lock:
            self._refuse_failed()
            if self._overflowed:
                lost, self._overflowed = self._overflowed, 0
                raise DeviceError(f"{lost} samples of {self._what} were overwritten; drain it more often")
            samples = list(self._kept)
            self._kept.clear()
            return samples

    def close(self) -> None:
        """Let go of the port. Closing again does nothing."""
        self._closing.set()
        self._thread.join(timeout=5.0)
        with self._lock:
            self._failure = self._failure or "it was closed; open it anew"
        self._port.close()

    def heard(self) -> str:
        """Say what came last, and who speaks so."""
        return self._tail.in_words()

    def in_silence(self) -> str:
        """Say that nothing comes, and what to check."""
        return (
            f"nothing that can be read came for {self._silent_s:g} s, {self.heard()}; check its "
            "cable, its power, and that this port is its own"
        )

    def speak(self, now_ns: int, *, first: bool = False) -> bytes:
        """Bytes to send now, to a device that is asked for its samples; most send by themselves."""
        return b""

    def _await_first(self) -> None:
        while not self._first.wait(0.01):
            with self._lock:
                self._refuse_failed()
        with self._lock:
            self._refuse_failed()

    def _refuse_failed(self) -> None:
        silent_s = (self._clock.now_ns() - self._heard_ns) / NS_PER_S
        patience_s = self._begins_s if self._latest is None else self._silent_s
        if not self._failure and silent_s > patience_s:
            self._failure = self.in_silence()
        if self._failure:
            raise DeviceError(f"{self._what}: {self._failure}", code="no-samples")

    def _run(self) -> None:
        try:
            self._send(first=True)
            while not self._closing.is_set() and not self._failure:
                data = self._port.read(min(max(self._port.in_waiting, 1), MAX_READ_BYTES))
                now_ns = self._clock.now_ns()
                self._tail.hear(data)
                with self._lock:
                    self._keep(self._stream.take(data, now_ns), now_ns)
                self._send()
        except Exception as error:  # each system and adapter has its own kinds; none is swallowed
            with self._lock:
                self._failure = (
                    self._failure or f"its port is gone ({error}); check its cable, then open it anew"
                )

    def _keep(self, samples: list[Wrench], now_ns: int) -> None:
        for sample in samples:
            self._overflowed += len(self._kept) == self._kept.maxlen
            self._kept.append(sample)
            self._latest, self._heard_ns = sample, now_ns
            self._first.set()
        if self._stream.failure:
            self._failure = self._failure or f"{self._stream.failure} ({self.heard()})"

    def _send(self, *, first: bool = False) -> None:
        words = self.speak(self._clock.now_ns(), first=first)
        if words:
            self._tail.send(words)
            self._port.write(words)
