"""Containers that one thread changes while others read them; each test fails if the lock is removed."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.sensing.live_stand_ins import HandedFrames, MeanReader, numbered

from palpate.core import Drift, Frame
from palpate.core.shared_history import SharedHistory
from palpate.sensing.live_loop import LiveLoop
from palpate.sensing.streaming import live_statistics
from palpate.sensing.streaming.live_statistics import DriftWatch
from palpate.studio.live.live_desk import LiveSensor

STRESS_S = 0.3


@pytest.fixture(autouse=True)
def _switch_often() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def errors_of(changes: Callable[[], object], *reads: Callable[[], object]) -> list[BaseException]:
    """Errors of one thread that changes and others that read for `STRESS_S`."""
    found: list[BaseException] = []
    end_s = time.monotonic() + STRESS_S

    def repeat(work: Callable[[], object]) -> None:
        try:
            while time.monotonic() < end_s and not found:
                work()
        except BaseException as e:
            found.append(e)

    threads = [threading.Thread(target=repeat, args=(one,)) for one in (changes, *reads)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


def drift_watch(monkeypatch: pytest.MonkeyPatch) -> tuple[DriftWatch, Callable[[], None]]:
    """A watch of every frame, and a function that gives it one more."""
    reader, frame = MeanReader(), numbered(0)
    reader.drifts = Drift(0.5, 1.0)
    watch, readings = DriftWatch(reader), reader.read(frame)
    monkeypatch.setattr(live_statistics, "LOOK_S", 0.0)
    return watch, lambda: watch.frame(frame.image, readings)


def test_drift_is_read_while_frames_arrive_and_the_reference_is_reset(monkeypatch) -> None:
    watch, arrive = drift_watch(monkeypatch)
    assert not errors_of(arrive, watch.to_dict, lambda: watch.advice, watch.zeroed)


def test_a_plain_deque_fails_the_same_stress(monkeypatch) -> None:
    watch, arrive = drift_watch(monkeypatch)
    plain = deque[Any](maxlen=241)
    watch._looks = SimpleNamespace(append=plain.append, items=lambda: plain)  # type: ignore[assignment]
    found = errors_of(arrive, watch.to_dict, watch.to_dict)
    assert [type(one) for one in found][:1] == [RuntimeError]


def test_a_history_keeps_the_newest_items_under_concurrent_use() -> None:
    history, numbers = SharedHistory[int](100), iter(range(10**9))

    def change() -> None:
        history.extend([next(numbers) for _ in range(7)])
        history.discard_while(lambda one: one % 5 == 0)

    def read() -> None:
        items = history.items()
        assert items == sorted(items)
        assert len(items) <= 100

    assert not errors_of(change, read, read)


class NumberedConnection:
    """Connection whose status has a new serial number at each look."""

    picture, told_s, _serial = None, 0.0, 0

    @property
    def status(self) -> dict[str, Any]:
        self._serial += 1
        return {"serial": self._serial, "reading": None, "force_N": 1.0}

    def ask(self, do: str, **fields: Any) -> Any: ...
    def close(self) -> None: ...


def test_a_page_reads_samples_of_a_sensor_while_they_arrive() -> None:
    sensor = LiveSensor("one", NumberedConnection())
    assert not errors_of(lambda: sensor.listen(1.0), lambda: [one.at_s for one in sensor.samples])
    assert sensor.samples


def test_the_untouched_image_is_taken_while_another_thread_restarts_it() -> None:
    loop = LiveLoop(lambda: HandedFrames(), zero_frames=3)
    loop._forces.extend([(n, 1.0) for n in range(1000)])
    frame = Frame(np.zeros((4, 4), np.uint8), 0.0)

    def collect() -> None:
        loop._forces.append((0, 1.0))
        if loop.zeroing:
            loop._collect_zero(frame)

    assert not errors_of(collect, loop.zero, lambda: loop.zero(frame.image), loop.status)
