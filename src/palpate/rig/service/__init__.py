"""The hardware loop as a process of its own: whoever watches it may come and go.

`RigService` holds the rig and records; `RigServer` lets others on this machine ask it over a loopback socket;
`RigClient` is how they ask; `launch` starts the process.
"""

from palpate.rig.service.rig_client import RigClient, ServedRig, launch, open_served_rig, rig_name
from palpate.rig.service.rig_service import RigServer, RigService

__all__ = ["RigClient", "RigServer", "RigService", "ServedRig", "launch", "open_served_rig", "rig_name"]
