"""Real-time scheduling of a process that guards a motion, where the system permits it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

REALTIME_PRIORITY = 10  # of 1 to 99; the kernel's own threads for devices have 50
NICENESS = -10
FIFO, NICE, NORMAL = "fifo", "nice", "normal"
REMEDY = (
    "allow it with '{user} - rtprio 20' in /etc/security/limits.d/palpate.conf and log in again, or run "
    "the process with the capability CAP_SYS_NICE"
)
Facts = dict[str, str]


def request_priority(system: Any = os, user: Callable[[], str] | None = None) -> Facts:
    """Request SCHED_FIFO for this process, or else a higher priority, and return what was granted.

    To be called before other threads are started: they inherit the policy of the thread that starts them.

    Args:
        system: module with the system's calls, such as `os`.
        user: returns the name of the user, for the remedy; that of the process where left out.

    Returns:
        ``scheduling``: "fifo", "nice" or "normal"; and ``remedy``: what to do where it is not "fifo",
        empty where the system has no such scheduling.
    """
    if not hasattr(system, "sched_setscheduler"):
        return {"scheduling": raise_priority(system), "remedy": ""}
    try:
        system.sched_setscheduler(0, system.SCHED_FIFO, system.sched_param(REALTIME_PRIORITY))
    except OSError:
        return {"scheduling": raise_priority(system), "remedy": REMEDY.format(user=(user or _user)())}
    return {"scheduling": FIFO, "remedy": ""}


def probe_realtime(system: Any = os, user: Callable[[], str] | None = None) -> Facts:
    """Return what `request_priority` would be granted, without a change of this process.

    The request is made in a thread of its own, whose policy ends with it.
    """
    found: Facts = {}
    calls = ("sched_setscheduler", "SCHED_FIFO", "sched_param")  # niceness may be of the whole process
    bare = SimpleNamespace(**{name: getattr(system, name) for name in calls if hasattr(system, name)})
    thread = threading.Thread(target=lambda: found.update(request_priority(bare, user)), daemon=True)
    thread.start()
    thread.join()
    return found


def raise_priority(system: Any = os) -> str:
    """Request a higher priority, not real-time scheduling, and return "nice" if granted, or else "normal"."""
    if hasattr(system, "setpriority"):
        with suppress(OSError):
            system.setpriority(system.PRIO_PROCESS, 0, NICENESS)
            return NICE
    return NORMAL


def _user() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a user without a name, as in a container
        return f"#{os.getuid()}" if hasattr(os, "getuid") else "*"
