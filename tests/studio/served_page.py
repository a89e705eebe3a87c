"""The studio's server before a rig's process that is made up: ``python served_page.py PORT``.

What is written to its standard input, a line of JSON, is told by the made-up process from then on; `null` is
a process that cannot be reached. Each emergency stop is a line of its standard output.

Variables: WORKSPACE and OBJECTS, folders; ADDRESSES, of address files; TOKEN; RIG=none for no process;
REQUEST_S, time within which a request is complete.
"""

import base64
import json
import os
import sys
import threading
import time
from pathlib import Path

import numpy as np

from palpate.devices.device_status import jpeg_of
from palpate.devices.rpc import Address, path_of, publish
from palpate.devices.rpc_server import RpcServer
from palpate.rig.plans import PLANS, size_of
from palpate.softness.process import read_bench
from palpate.studio import page_limits
from palpate.studio.library.workspace import Workspace
from palpate.studio.page_server import StudioParts, serve_pages
from palpate.studio.softness_page import RenderingDesk

TOKEN = "test-token"
PLAN = PLANS["palm-reduced"]
SIZE_PX = (256, 128)
JPEG = base64.b64decode(jpeg_of(np.full((*SIZE_PX[::-1], 3), (60, 120, 140), np.uint8))["jpeg"])


def status_now(**changed):
    """What a rig at rest tells, as `RigService.status` does."""
    ages = [0.1 * i for i in range(200, -1, -1)]
    return {
        "serial": 1, "rig": "made up", "real_time": True, "recording": False, "state": "ready",
        "asked": None, "held": False, "estop": None, "message": "ready to begin", "run": "", "shots": 0,
        "left_s": None, "place": "", "log_count": 1,
        "log": [{"utc": "2026-11-23T01:00:00+00:00", "kind": "rig", "text": "made up opened"}],
        "plan": PLAN.model_dump(mode="json"), "size": size_of(PLAN, 30.0)._asdict(), "planned": 100,
        "force_n": [0.01, -0.02, 1.25], "tared": True, "position_mm": [1.0, 2.0, 0.5],
        "limits": {"force_n": 20.0}, "regions": [], "now_ns": 0,
        "series": {"age_s": ages, "x": [0.01] * 201, "y": [-0.02] * 201,
                   "z": [0.006 * i for i in range(201)]},
        "devices": [
            {"name": "stage", "state": "ok", "detail": "x 1.00, y 2.00, z 0.50 mm"},
            {"name": "force sensor", "state": "ok", "detail": "500 of 500 samples a second"},
            {"name": "camera", "state": "ok", "detail": "256 × 128 px, 30 a second"},
        ],
        **changed,
    }  # fmt: skip


class MadeUpClient:
    """Stands for `RigClient`, and for the rig's process as the emergency stop listener reaches it."""

    name = "made up"

    def __init__(self, folder):
        self.status, self._picture, self.told_s = None, (1, JPEG, SIZE_PX), None
        self._silent, self._folder, self._server = False, folder, None
        self._blocks_s = 0.0
        threading.Thread(target=self._listen, daemon=True).start()
        threading.Thread(target=self._tell, daemon=True).start()

    @property
    def picture(self):
        time.sleep(self._blocks_s)  # in the event loop of the pages
        return self._picture

    def launch(self):
        if self._server is None:
            quick = {"estop": lambda _: self._estop(), "status": lambda _: self.status}
            self._server = RpcServer(self.name, lambda: self.status or {}, lambda after: None, quick, {})
            address = Address(self.name, self._server.port, self._server.token, os.getpid())
            publish(address, self._folder)
        self.status = status_now()

    def send_estop(self):
        self._estop()
        return lambda: {"asked_ns": 0, "stood_ns": 0}

    def _estop(self):
        print("estop", flush=True)
        return {"asked_ns": 0, "stood_ns": 0}

    def _end(self):
        self.status = None
        path_of(self.name, self._folder).unlink(missing_ok=True)
        if self._server is not None:
            self._server.close()
            self._server = None

    def _listen(self):
        for line in sys.stdin:
            said = json.loads(line)
            if said is None:
                self._end()
            elif said == "picture fails":
                del self._picture
            elif isinstance(said, float):
                self._blocks_s = said
            elif said == "silent":
                self._silent = True
            else:
                self.launch()
                self.status = status_now(**said)
                self._silent = False

    def _tell(self):
        while True:
            time.sleep(0.1)
            if self.status is not None and not self._silent:
                self.status = {**self.status, "serial": self.status["serial"] + 1}
                self.told_s = time.monotonic()


if __name__ == "__main__":
    page_limits.REQUEST_S = float(os.environ.get("REQUEST_S", page_limits.REQUEST_S))
    folder = Path(os.environ.get("WORKSPACE", "."))
    desk = RenderingDesk(Path(os.environ.get("OBJECTS", ".")), read_bench(None))
    addresses = Path(os.environ["ADDRESSES"])
    client = MadeUpClient(addresses)
    if os.environ.get("RIG") != "none":
        client.launch()
    parts = StudioParts(client, Path("runs"), desk, Workspace(folder), client.launch, addresses)
    serve_pages(parts, int(sys.argv[1]), os.environ.get("TOKEN", TOKEN))
