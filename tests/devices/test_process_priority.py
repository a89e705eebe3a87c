"""A guarding process requests real-time scheduling, and reports what it was granted and what to do."""

import os
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from palpate.devices.supervisor.owning_process import (
    FIFO,
    NICE,
    NORMAL,
    REALTIME_PRIORITY,
    probe_realtime,
    request_priority,
)
from palpate.devices.supervisor.supervised_guard import SupervisorLink
from palpate.rig.rig_check import scheduling_result


@dataclass
class System:
    """The system's calls, each of which is permitted or not."""

    realtime: bool
    nice: bool
    asked: list[tuple[Any, ...]] = field(default_factory=list)
    SCHED_FIFO = 1
    PRIO_PROCESS = 0

    def sched_param(self, priority: int) -> int:
        return priority

    def sched_setscheduler(self, pid: int, policy: int, param: int) -> None:
        self.asked.append((pid, policy, param))
        if not self.realtime:
            raise PermissionError

    def setpriority(self, which: int, who: int, priority: int) -> None:
        self.asked.append(("nice", priority))
        if not self.nice:
            raise PermissionError


def test_real_time_scheduling_that_is_permitted_is_granted_without_a_remedy() -> None:
    system = System(realtime=True, nice=True)
    assert request_priority(system) == {"scheduling": FIFO, "remedy": ""}
    assert system.asked == [(0, system.SCHED_FIFO, REALTIME_PRIORITY)]


@pytest.mark.parametrize(("nice", "scheduling"), [(True, NICE), (False, NORMAL)])
def test_real_time_scheduling_that_is_not_permitted_is_reported_with_its_remedy(
    nice: bool, scheduling: str
) -> None:
    granted = request_priority(System(realtime=False, nice=nice), user=lambda: "ada")
    assert granted["scheduling"] == scheduling
    assert all(part in granted["remedy"] for part in ("ada", "rtprio", "limits.d"))


def test_a_system_without_real_time_scheduling_has_no_remedy() -> None:
    assert request_priority(SimpleNamespace()) == {"scheduling": NORMAL, "remedy": ""}


@pytest.mark.parametrize("permitted", [True, False])
def test_a_probe_finds_what_is_permitted_and_changes_no_niceness(permitted: bool) -> None:
    system = System(realtime=permitted, nice=True)
    found = probe_realtime(system, user=lambda: "ada")
    assert found["scheduling"] == (FIFO if permitted else NORMAL)
    assert bool(found["remedy"]) is not permitted
    assert not [one for one in system.asked if one[0] == "nice"]


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="the system has no such calls")
def test_a_probe_leaves_this_process_as_it_was() -> None:
    before = os.sched_getscheduler(0)
    probe_realtime()
    assert os.sched_getscheduler(0) == before


def test_a_rig_without_real_time_scheduling_passes_its_check_with_a_note() -> None:
    granted = {"scheduling": FIFO, "remedy": ""}
    refused = {"scheduling": NICE, "remedy": "edit limits.conf"}
    assert [scheduling_result(one).measured for one in (granted, refused)] == [1.0, 0.0]
    assert [scheduling_result(one).message for one in (granted, refused)] == ["", "edit limits.conf"]
    assert all(scheduling_result(one).ok for one in (granted, refused))


OWNER = """
import sys
from palpate.devices.supervisor import owning_process
from palpate.devices.supervisor.owning_process import request_priority

class Owner:
    def __init__(self, sends): ...
    def read(self, messages):
        for _ in messages: ...
        self.gone = True
    def serve(self):
        import time
        while not hasattr(self, "gone"): time.sleep(0.01)
    def leave(self): self.gone = True
    def stop(self): return {}
    def status(self): return {}

if sys.argv[1:] == ["refused"]:
    from types import SimpleNamespace
    def refuse(*_): raise PermissionError
    system = SimpleNamespace(sched_setscheduler=refuse, SCHED_FIFO=1, sched_param=int)
    owning_process.request_priority = lambda: request_priority(system, lambda: "ada")
sys.exit(owning_process.run_owner(lambda first, clock, send, opened: (Owner(send), {"travel": []})))
"""


@pytest.mark.parametrize("words", [(), ("refused",)], ids=["as permitted", "refused"])
def test_a_process_tells_its_client_the_scheduling_it_has(words: tuple[str, ...]) -> None:
    link = SupervisorLink(("-c", OWNER, *words), {"name": f"scheduling {os.getpid()} {len(words)}"})
    try:
        granted = link.scheduling
        policy = os.sched_getscheduler(link.pid) if hasattr(os, "sched_getscheduler") else None
    finally:
        link.close()
    if words:
        assert granted["scheduling"] == NORMAL
        assert "rtprio" in granted["remedy"]
    elif policy is not None:
        assert (granted["scheduling"] == FIFO) is (policy == os.SCHED_FIFO)
        assert bool(granted["remedy"]) is (policy != os.SCHED_FIFO)
