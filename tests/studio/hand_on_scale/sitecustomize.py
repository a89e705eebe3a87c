"""Loaded by Python itself where this folder is on its path: a virtual hand presses on a scale.

The force that the hand gives, as it was a scale's delay ago, is written to the file that HAND_FORCE names,
from where a scale on a pseudo-terminal prints it. Other processes than a first session's are left alone.
"""

import os
import struct
import sys
import threading
import time

LATE_S, STEP_S = 0.4, 0.02


def lay_on_scale(path):
    """Have every virtual hand write its force."""
    from palpate.rig.virtual import virtual_hand

    made = virtual_hand.VirtualHand.__init__

    def make(hand, *words, **options):
        made(hand, *words, **options)
        begun_s = hand.world.now_s
        file = os.open(path, os.O_WRONLY | os.O_CREAT)

        def write():
            while True:
                at_s = hand.world.now_s - LATE_S
                force_n = hand.force_at(at_s) if at_s > begun_s else 0.0
                os.pwrite(file, struct.pack("<d", force_n), 0)
                time.sleep(STEP_S)

        threading.Thread(target=write, daemon=True).start()

    virtual_hand.VirtualHand.__init__ = make


if os.environ.get("HAND_FORCE") and "palpate.studio.live.start_process" in sys.orig_argv:
    lay_on_scale(os.environ["HAND_FORCE"])
