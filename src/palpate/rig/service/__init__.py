"""The hardware loop as a process of its own: whoever watches it may come and go.

`RigService` holds the rig and records; `Server` lets others on this machine ask it over a loopback socket;
`RigClient` is how they ask; `launch` starts the process.
"""

from palpate.rig.service.address import Address, find
from palpate.rig.service.client import RigClient
from palpate.rig.service.host import RigService
from palpate.rig.service.launching import launch
from palpate.rig.service.opening import Opened, open_rig, rig_name
from palpate.rig.service.server import Server

__all__ = [
    "Address",
    "Opened",
    "RigClient",
    "RigService",
    "Server",
    "find",
    "launch",
    "open_rig",
    "rig_name",
]
