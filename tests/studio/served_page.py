"""The studio's server before a rig's process that is made up: ``python served_page.py PORT``.

What is written to its standard input, a line of JSON, is told by the made-up process from then on; `null` is
a process that cannot be reached. Each emergency stop is a line of its standard output.
"""

import json
import sys
import threading
import time
from pathlib import Path

from palpate.rig.plans import PLANS, size_of
from palpate.studio.page_server import serve_pages

PLAN = PLANS["palm-reduced"]
JPEG = bytes.fromhex(
    "ffd8ffe000104a46494600010100000100010000ffdb004300" + "03" * 64 + "ffc0000b080001000101011100"
    "ffc4001f0000010501010101010100000000000000000102030405060708090a0b"
    "ffc400b5100002010303020403050504040000017d01020300041105122131410613516107227114328191a1082342b1c115"
    "52d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455565758595a636465666768"
    "696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6"
    "c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9faffda0008010100003f00fbffd9"
)


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
            {"name": "camera", "state": "ok", "detail": "1 × 1 px, 30 a second"},
        ],
        **changed,
    }  # fmt: skip


class MadeUpClient:
    """Stands for `RigClient`."""

    def __init__(self):
        self.status, self.picture, self.told_s = status_now(), (1, JPEG, (1, 1)), time.monotonic()
        self._silent = False
        threading.Thread(target=self._listen, daemon=True).start()
        threading.Thread(target=self._tell, daemon=True).start()

    def send_estop(self):
        print("estop", flush=True)
        return lambda: {"asked_ns": 0, "stood_ns": 0}

    def _listen(self):
        for line in sys.stdin:
            said = json.loads(line)
            if said is None:
                self.status = None
            elif said == "picture fails":
                del self.picture
            elif said == "silent":
                self._silent = True
            else:
                self.status = status_now(**said)
                self._silent = False

    def _tell(self):
        while True:
            time.sleep(0.1)
            if self.status is not None and not self._silent:
                self.status = {**self.status, "serial": self.status["serial"] + 1}
                self.told_s = time.monotonic()


if __name__ == "__main__":
    serve_pages(MadeUpClient(), int(sys.argv[1]), Path("runs"))
